"""The closed loop in process: a case built, one compiled step, whole runs of it, replay of what was recorded."""
