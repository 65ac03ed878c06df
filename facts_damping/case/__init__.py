"""From what the user wrote (YAML files, `--set`) to a checked case that everything else is built from."""
