"""The supervisor beside a controller: whether its setpoints may act, by what it sees of data, controller and grid."""
