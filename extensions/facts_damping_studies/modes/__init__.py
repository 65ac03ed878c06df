"""Pictures of a small-signal analysis: one-line diagram, mode shapes, transfer functions."""
