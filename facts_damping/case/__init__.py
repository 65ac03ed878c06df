"""Turns the user's input (YAML files, `--set`) into a checked case, from which everything else is built."""
