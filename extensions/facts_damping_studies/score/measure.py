"""What is measured of a controller in a case.

The index is ITAE (4.108) of the response to the events (analysis/response.py) from the first event to some seconds
after the last. Without an event it is the root mean square of the speed differences. Both are compared with those of
the same case without control.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from facts_damping.analysis.effort import saturation_duty
from facts_damping.analysis.indices import performance_indices
from facts_damping.analysis.measures import device_limits
from facts_damping.analysis.response import MIRROR, WITHOUT_EVENTS, swings_of
from facts_damping.analysis.supervision import supervision, trips
from facts_damping.simulation import loop
from facts_damping.simulation.twins import grids, twin
from facts_damping_studies.score.isolation.isolated import breach_of, isolated
from facts_damping_studies.score.statistics import rounded
from facts_damping_studies.search.scoring import mean_effort

if TYPE_CHECKING:
    from collections.abc import Sequence

    from facts_damping.analysis.response import Swings, Twin
    from facts_damping.case.model import Case
    from facts_damping.record import Record
    from facts_damping_studies.score.isolation.isolated import Child

SETTLED_S = 5.0  # of noise that do not count
CLEARED_S = 0.1  # after the last event, from which voltages and frequencies count


class Measured(NamedTuple):
    """Figures of a controller in a case."""

    measure: float | None  # ITAE of the response, p.u. s^2, or rms, p.u.; None: synchronism is lost, or a breach
    peak: float | None = None  # p.u., largest speed difference of the response after the event
    lost_s: float | None = None  # s, when synchronism is lost
    effort: float = 0.0  # mean of the setpoints relative to their limits
    saturated: float = 0.0  # fraction of the time at a limit, of the device that is longest
    travel: float = 0.0  # 1/s, way of the setpoint relative to its limit, of the device that moves most
    frequency_hz: float | None = None  # largest deviation of a machine's speed after the events
    lowest: float | None = None  # p.u., voltage at a machine's terminals after the events
    highest: float | None = None
    tripped: bool = False  # whether a supervisor took it off
    computing: float = 0.0  # time of the processor of a user's program, relative to that simulated
    breach: str = ""  # what a user's program did that is not allowed


class Seen(NamedTuple):
    """What users' programs looked at in a case."""

    files: frozenset[str] = frozenset()  # beside their own
    plant: bool = False  # the linearised plant


def measure(case: Case, after: float, seed: int) -> tuple[Measured, Seen]:
    """Simulate a case with its twin, and measure the response until `after` (s) the last event.

    Users' programs run in processes of their own; `seed` is what they get for random numbers. Also returns what they
    looked at. Raises `RunError` if a program fails.
    """
    with isolated(case, seed) as (apart, children):
        try:
            measured = _measured(apart, after)
        except Exception as error:
            breach = breach_of(error)
            if not breach:
                raise
            measured = Measured(None, breach=breach)
    seen = Seen(frozenset(name for child in children for name in child.read), any(child.plant for child in children))
    breach = measured.breach or next((child.breach for child in children if child.breach), "")
    return as_on_card(measured._replace(computing=_computing(children), breach=breach)), seen


def _computing(children: Sequence[Child]) -> float:
    """Of all programs of a run together, of the run or twin where it is largest."""
    return max((child.computing for child in children), default=0.0)


def _measured(case: Case, after: float) -> Measured:
    record = loop.run(case)
    pair = None
    if case.scenario.events and record.in_synchronism.all():
        first, last = grids(case)
        pair = twin(case, record, MIRROR if first != last else WITHOUT_EVENTS)  # the same for all controllers
    return measured_from(case, record, pair, after)


def measured_from(case: Case, record: Record, pair: Twin | None, after: float) -> Measured:
    """The figures of a run; `pair`: its twin, without which the noise is in the response."""
    index, peak, lost_s = None, None, None
    if record.in_synchronism.all():
        index, peak = index_of(case, swings_of(record, pair), after)
    else:
        lost_s = float(record.time_s[-1])
    return measured_of(case, record, index, peak)._replace(lost_s=lost_s)


def measured_of(case: Case, record: Record, index: float | None, peak: float | None) -> Measured:
    """The figures of a run with its index and peak."""
    counted = record.time_s >= max([SETTLED_S, *(event.time + CLEARED_S for event in case.scenario.events)][-1:])
    machines = record.machines[counted]
    worst: tuple[float | None, ...] = (None, None, None)
    if machines.size and index is not None:
        speed, voltage = machines["speed_deviation"], machines["terminal_voltage"]
        worst = float(np.abs(speed).max()) * case.system.frequency, float(voltage.min()), float(voltage.max())
    return Measured(
        index,
        peak,
        effort=mean_effort(record) if record.device_names else 0.0,
        saturated=max(saturation_duty(record).values(), default=0.0),
        travel=_travel(record),
        frequency_hz=worst[0],
        lowest=worst[1],
        highest=worst[2],
        tripped=bool(trips(supervision(record, None))),
    )


def _travel(record: Record) -> float:
    """Sum of the setpoint's changes over its limit and the time, 1/s, of the device where it is largest."""
    limits, setpoints = device_limits(record.configuration), record.devices["setpoint"]
    ways = np.abs(np.diff(setpoints, axis=0)).sum(axis=0) / (float(record.time_s[-1] - record.time_s[0]) or 1.0)
    moved = [float(ways[i]) / limits[name] for i, name in enumerate(record.device_names) if name in limits]
    return max(moved, default=0.0)


def index_of(case: Case, swings: Swings, after: float) -> tuple[float, float]:
    """Index and peak of a response."""
    times, response = [event.time for event in case.scenario.events], swings.judged
    t = swings.time_s[: len(response)]
    if not times:
        calm = response[t >= SETTLED_S]
        return float(np.sqrt(np.mean(np.square(calm)))), float(np.abs(calm).max())
    inside = (t >= min(times)) & (t <= max(times) + after)
    response = response[inside]
    return performance_indices(t[inside], response, min(times))["ITAE"], float(np.abs(response).max())


def as_on_card(measured: Measured) -> Measured:
    """With as many digits as a card has, so that a card that is read is the one that was written."""
    floats: dict[str, Any] = {
        name: rounded(value) for name, value in measured._asdict().items() if isinstance(value, float)
    }
    return measured._replace(**floats)
