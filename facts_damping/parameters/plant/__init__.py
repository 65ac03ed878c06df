"""Models of a system's file: grid, machines, devices, PMUs."""
