"""Supervisors: each decides whether its controller's setpoints may act, from data, controller and grid."""
