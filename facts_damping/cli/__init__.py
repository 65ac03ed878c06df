"""The command line: each command takes the parsed arguments, calls other packages, and prints the results."""
