"""Everything that linearises the plant: its state matrices, modes, residues, sampling with hold, and LQG design."""
