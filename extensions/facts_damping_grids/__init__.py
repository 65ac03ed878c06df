"""Import of systems from the files of other programs."""
