"""PMUs: measurement of voltages and currents."""
