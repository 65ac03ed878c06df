"""A policy that was trained in the Gymnasium environment, as a class: examples/train_damper.py."""

import numpy as np

from facts_damping.environment import Window

WINDOW = 8  # frames


def action(weights, seen):
    """A weighted sum of the signals in the window, -1 to 1: (..., 1), of weights (..., WINDOW)."""
    return np.clip((weights * seen[..., 0, 0]).sum(axis=-1, keepdims=True), -1.0, 1.0)


class TrainedDamper:
    """The weights of a file, `parameters: {weights: damper.npz}`."""

    once_a_tick = True  # as the environment

    def __init__(self, spec):
        self.weights = np.load(spec.parameters["weights"])["weights"]
        self.window, self.limits = Window(spec, WINDOW), spec.limits

    def reset(self):
        self.window.reset()

    def step(self, t_s, y, age_s, fresh):
        return action(self.weights, self.window.push(t_s, y, age_s, fresh)) * self.limits
