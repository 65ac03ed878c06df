"""Studies: many closed loops in process, to choose parameters and to compare controllers."""
