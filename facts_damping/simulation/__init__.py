"""The closed loop in process: build a case, step it, run it, and replay recordings."""
