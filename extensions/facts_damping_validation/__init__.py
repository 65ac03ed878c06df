"""The plant against published figures, other programs, analytic solutions and finer steps: `facts-damping validate`."""
