"""Supervisors: each decides from data, controller and grid whether its controller's setpoints may act."""
