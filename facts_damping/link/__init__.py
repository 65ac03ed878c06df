"""Wide-area communication: chains of stages that delay, lose or change entries, in simulated time."""
