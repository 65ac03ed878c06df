"""Observation of a tick by an agent, and true speed differences for its reward; compiled."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from facts_damping.compiling import compiled
from facts_damping.compiling.structs import Struct
from facts_damping.control.called import Sensed, sense
from facts_damping.control.inputs import Inputs, LatestSamples

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

SIGNAL, AGE, MISSING = range(3)  # indices of a window's last axis
MAX_SIGNAL, MAX_AGE = 100.0, 10.0  # in scales, and s: values are clipped to these


class AgentInputs(Struct):
    """Received signals of an agent's controller."""

    inputs: Inputs
    held: LatestSamples
    sensed: Sensed


@compiled
def append_to_window(
    window: NDArray[Any], y: NDArray[Any], age: NDArray[Any], fresh: NDArray[Any], scale: NDArray[Any]
) -> None:
    """Append the signals of a tick, (signals,), to a window, (ticks, signals, 3)."""
    for k in range(window.shape[0] - 1):
        for i in range(window.shape[1]):
            for part in range(window.shape[2]):
                window[k, i, part] = window[k + 1, i, part]
    last = window.shape[0] - 1
    for i in range(window.shape[1]):
        value = y[i] / scale[i]
        window[last, i, SIGNAL] = min(max(value, -MAX_SIGNAL), MAX_SIGNAL) if math.isfinite(value) else 0.0
        window[last, i, AGE] = min(age[i], MAX_AGE)
        window[last, i, MISSING] = 0.0 if fresh[i] else 1.0


@compiled
def observe(
    eyes: AgentInputs,
    delivered: NDArray[Any],
    count: int,
    end_ns: int,
    window: NDArray[np.float32],
    scale: NDArray[np.float64],
    weights: NDArray[np.float64],
    machines: NDArray[Any],
    deviations: NDArray[np.float64],
) -> None:
    """Write a tick's delivered signals into the window, and true speed differences into `deviations`, p.u.

    `weights`: (differences, machines); `machines`: (machines,) of MACHINE_TRUTH.
    """
    sense(eyes.inputs, eyes.held, eyes.sensed, 0, delivered, count, end_ns)
    append_to_window(window, eyes.held.signal[0], eyes.sensed.age[0], eyes.sensed.fresh[0], scale)
    for d in range(weights.shape[0]):
        deviations[d] = 0.0
        for m in range(weights.shape[1]):
            deviations[d] += weights[d, m] * machines[m].speed_deviation
