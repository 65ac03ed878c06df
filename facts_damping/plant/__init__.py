"""The power system: network, power flow, machines, excitation, converters, events; one compiled step."""
