"""Whose messages a node lets in: senders, what was refused, who comes later or comes back."""
