"""What PMUs make of the voltages and currents at their places."""
