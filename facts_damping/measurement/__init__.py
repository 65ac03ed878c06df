"""PMU measurement of voltages and currents at stations."""
