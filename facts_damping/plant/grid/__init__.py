"""The network: admittances, power flow, reduction, ports, loads."""
