"""Design of a controller from a system alone: places, signals, a lead-lag and its cases."""
