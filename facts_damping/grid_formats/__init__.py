"""Systems from the files of other programs."""
