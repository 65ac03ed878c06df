"""Our plant by PSS/E's integration, which its traces show: what then remains of a deviation is not PSS/E's step.

Adams and Bashforth's method of second order, x(n+1) = x(n) + h (1.5 f(n) - 0.5 f(n-1)). At the switching time f is the
mean of before and after the event, so that speeds begin with three quarters of a step. Lags that are not much longer
than a step are integrated otherwise by PSS/E, in a way that its traces do not show.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from facts_damping.parameters.events import Scenario
from facts_damping.plant.build import build
from facts_damping.plant.dynamics import derivatives
from facts_damping.plant.measurement import measure
from facts_damping.plant.model import begin_interval, copy, workspace
from facts_damping.signals import to_ns
from facts_damping_validation.time_domain import unwritten

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from facts_damping.parameters.plant.system import System
    from facts_damping_validation.time_domain import Followed


def follow_in_steps(
    system: System, times: NDArray[np.float64], event: dict[str, Any] | None, at: float, setpoint: float = 0.0
) -> Followed:
    """What happens at instants (s), which are multiples of the shortest step between them.

    At the time `at` (s) there is an `event`, or the setpoint (p.u.) of the system's only device begins.
    """
    events = [] if event is None else [event | {"time": at}]
    scenario = Scenario.model_validate({"name": "inline", "events": events})
    built = build(system, [device.name for device in system.devices], scenario.events)
    state, rate = copy(built.state), round(1.0 / float(np.diff(times).min()))
    work, size = workspace(built.plant, state), len(state.x)
    followed = unwritten(system, len(system.devices), len(times))
    sampled = {round(time * rate): k for k, time in enumerate(times)}
    switching, slope, before = round(at * rate), np.zeros(size), np.zeros(size)
    for n in range(max(sampled) + 1):
        now, mean = to_ns(n / rate), np.zeros(size)
        sides = (False, True) if n == switching else (n > switching,)  # whether it is after the event
        for after in sides:
            state.reference[:] = setpoint * after
            interval = begin_interval(built.plant, state, now - (not after))
            derivatives(built.plant, state.x, state.reference, state.source, interval, slope, work)
            mean += slope / len(sides)
        if n in sampled:
            k = sampled[n]
            measure(built.plant, state, now, followed.frames[k], followed.machines[k], followed.devices[k], work)
        state.x[:] += (1.5 * mean - 0.5 * before if n else mean) / rate
        before = mean
    return followed
