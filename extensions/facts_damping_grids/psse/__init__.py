"""Import of PSS/E cases: RAW and DYR files as content of a system."""
