"""The thesis's printed results, and ours beside them."""
