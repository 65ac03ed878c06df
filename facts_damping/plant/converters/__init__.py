"""FACTS devices and HVDC: states, references, losses, dead times."""
