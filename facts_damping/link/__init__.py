"""Wide-area communication: chains of stages that delay what passes, in simulated time."""
