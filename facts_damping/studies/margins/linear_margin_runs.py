"""The delay margin by runs of the nonlinear loop: a small pulse about the equilibrium, and the run's own scenario."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from scipy.optimize import brentq

from facts_damping.analysis.measures import columns, event_times, speed_differences
from facts_damping.analysis.modes.oscillation import WINDOW, envelope
from facts_damping.analysis.modes.ringdown import ringdown_modes
from facts_damping.analysis.verdict import DAMPED, judge
from facts_damping.parameters.run import Scenario
from facts_damping.simulation import loop
from facts_damping.studies.margins.linear_closed_loop import with_delay
from facts_damping.studies.margins.margins import edge

if TYPE_CHECKING:
    from collections.abc import Callable

    from facts_damping.analysis.modes.ringdown import RingdownMode
    from facts_damping.case.model import Case
    from facts_damping.signals import Record
    from facts_damping.studies.margins.linear_margin import Margin

PULSE = 1e-4  # of a load, or of a mechanical power
BEGIN, END = 1.0, 1.5  # s, of the pulse
LENGTH = 40.0  # s, of a run after the pulse
REACH = 0.04  # s, to both sides of the linear margin: where that of the pulse is looked for
FINE = 5e-4  # s, of the margin of the pulse
HORIZONS = (20.0, 40.0)  # s, from the start of a run of a scenario
CRITERIA = ("in synchronism", "damped")
LOOKS = 6  # delays at which a ringdown is looked at
RUNS = 90  # about so many, for the line of progress
COARSE, CLOSE = 0.005, 1e-3  # s, of the search over a scenario: steps, then halved; a narrower pocket may be missed


class Bound(NamedTuple):
    """The smallest delay that a run does not bear over a horizon, s: it bears `low` and does not bear `high`.

    Either is none where no delay looked at is like that.
    """

    criterion: str  # in synchronism, or damped
    horizon: float
    low: float | None
    high: float | None


class Beside(NamedTuple):
    """What runs of the nonlinear loop say of delay."""

    ringdown: list[tuple[float, list[RingdownMode]]]  # delay, s, and the modes after a pulse, the strongest first
    pulse: float | None  # s, the margin for a pulse; none: not near the linear one
    scenario: list[Bound]  # of the run's own scenario


def pulsed(case: Case, delay: float, length: float = LENGTH) -> Case:
    """The run with a delay (s) and nothing but a pulse: 0.01 % more of its first load for half a second.

    Of the first machine's mechanical power where there is no load.
    """
    if case.system.loads:
        kind = {"kind": "load_step", "load": case.system.loads[0].name}
    else:
        kind = {"kind": "mechanical_power_step", "machine": case.system.machines[0].name}
    rows = [{**kind, "time": BEGIN, "change": PULSE}, {**kind, "time": END, "change": 0.0}]
    scenario = Scenario.model_validate({"name": "pulse", "events": rows})
    return replace(with_delay(_lasting(case, length), delay), scenario=scenario)


def _lasting(case: Case, duration: float) -> Case:
    return replace(case, run=case.run.model_copy(update={"duration": duration, "asked": None}))


def ringdown(case: Case, delay: float) -> list[RingdownMode]:
    """Modes of the nonlinear run after a pulse, the strongest first."""
    record = loop.run(pulsed(case, delay))
    return ringdown_modes(record.time_s, columns(speed_differences(record)), END)


def growth(record: Record) -> float:
    """Rate at which the oscillation grows over the second half of a run, 1/s: slope of the envelope's logarithm.

    That of the speed difference that swings most at the end, over windows of 5 s.
    """
    signals, t = columns(speed_differences(record)), record.time_s
    starts = np.arange(t[-1] / 2.0, t[-1] - WINDOW + 1e-6, WINDOW)
    sizes = np.array([envelope(t, signals, start, start + WINDOW) for start in starts])
    return float(np.polyfit(starts, np.log(sizes[:, int(np.argmax(sizes[-1]))]), 1)[0])


def pulse_margin(case: Case, linear: float, looked: Callable[[], None] = lambda: None) -> float | None:
    """The delay at which a pulse neither grows nor dies, near the linear margin (s); none where it is not near."""

    def rate(delay: float) -> float:
        found = growth(loop.run(pulsed(case, delay)))
        looked()
        return found

    low, high = max(0.0, linear - REACH), linear + REACH
    if rate(low) >= 0.0 or rate(high) <= 0.0:
        return None
    return float(brentq(rate, low, high, xtol=FINE))


def bears(case: Case, delay: float) -> dict[tuple[str, float], bool]:
    """What a run of the case's scenario meets with a delay (s), by criterion and horizon (s)."""
    record = loop.run(with_delay(_lasting(case, max(HORIZONS)), delay))
    t, signals, last = record.time_s, columns(speed_differences(record)), (event_times(record) or [0.0])[-1]
    lost = np.inf if record.in_synchronism.all() else t[-1]
    found = {}
    for horizon in HORIZONS:
        kept = t < horizon
        found["in synchronism", horizon] = bool(lost >= horizon)
        sound = found["in synchronism", horizon]
        found["damped", horizon] = sound and judge(t[kept], signals[kept], last).verdict == DAMPED
    return found


def bounds(case: Case, longest: float, looked: Callable[[], None]) -> list[Bound]:
    """Where the run's scenario no longer meets each criterion over each horizon: in steps, then halved.

    `looked` is called after each run.
    """

    @cache
    def met(delay: float) -> dict[tuple[str, float], bool]:
        found = bears(case, delay)
        looked()
        return found

    made, steps = [], np.arange(0.0, longest + 1e-9, COARSE).tolist()
    for criterion in CRITERIA:
        for horizon in HORIZONS:
            low, high = edge(met, (criterion, horizon), steps, CLOSE)
            made.append(Bound(criterion, horizon, low, high))
    return made


def beside(found: Margin, progress: Callable[[int, int], None]) -> Beside:
    """Runs beside a linear margin: ringdown at some delays, the margin of a pulse, and that of the run's scenario."""
    done = 0

    def looked() -> None:
        nonlocal done
        done += 1
        progress(min(done, RUNS), RUNS)

    case, longest = found.case, float(found.delays[-1])
    end = min(longest, 1.25 * (longest if not found.margin else found.margin))
    rung = []
    for delay in np.unique(np.round(np.linspace(0.0, end, LOOKS), 2)).tolist():
        rung.append((delay, ringdown(case, delay)))
        looked()
    pulse = pulse_margin(case, found.margin, looked) if found.margin else None
    return Beside(rung, pulse, bounds(case, longest, looked) if case.scenario.events else [])
