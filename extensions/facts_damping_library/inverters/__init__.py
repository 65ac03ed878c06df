"""Inverters and their controls of the PSS/E library, a file per model."""
