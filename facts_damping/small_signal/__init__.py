"""Linearisation of the plant: state matrices, modes, residues, sampling with hold, and LQG design."""
