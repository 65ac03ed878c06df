"""A recorded run computed again, node by node, and compared."""
