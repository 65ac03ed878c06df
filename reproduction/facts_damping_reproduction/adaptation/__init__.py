"""Does online learning damp better than the best fixed controller? An experiment with its rule of decision."""
