"""The delay margin by simulation of the nonlinear loop: after a small pulse at the equilibrium, and in a scenario."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from scipy.optimize import brentq

from facts_damping.analysis.judging import judge_run
from facts_damping.analysis.measures import columns, speed_differences
from facts_damping.analysis.modes.oscillation import WINDOW, envelope
from facts_damping.analysis.modes.ringdown import fit_ringdown, ringdown_modes
from facts_damping.analysis.response import PULSE_END, shortened, swings_of
from facts_damping.analysis.verdict import LOST
from facts_damping.simulation import loop
from facts_damping.simulation.twins import twin_of, with_pulse
from facts_damping_studies.margins import margins
from facts_damping_studies.margins.criteria import CriterionFigures, fails, lowest_damping_ratio
from facts_damping_studies.margins.linear_closed_loop import with_delay
from facts_damping_studies.parameters import Margin

if TYPE_CHECKING:
    from collections.abc import Callable

    from facts_damping.analysis.modes.ringdown import RingdownMode
    from facts_damping.analysis.response import Swings, Twin
    from facts_damping.case.model import Case
    from facts_damping.record import Record
    from facts_damping_studies.margins.delay_margin import Margin as LinearMargin

PULSE = 1e-4  # p.u. of a load or of a mechanical power
LENGTH = 40.0  # s, duration of a run after the pulse
REACH = 0.04  # s, search range for the pulse's margin on both sides of the linear margin
FINE = 5e-4  # s, resolution of the pulse's margin
HORIZONS = (20.0, 40.0)  # s, from the start of a run of a scenario
CRITERIA = ("unstable", "not_damped", "damping")
LOOKS = 6  # number of delays at which the ringdown is analysed
RUNS = 60  # approximate number of runs, for the progress line
COARSE, CLOSE = 0.02, 1e-3  # s, steps, then bisection in a scenario; narrower intervals may be missed


class Holds(NamedTuple):
    """The delays at which a run meets a criterion over a horizon."""

    criterion: str  # one of CRITERIA
    horizon: float  # s
    holds: list[list[float]]  # s, intervals


class Beside(NamedTuple):
    """Results of nonlinear simulations with delay."""

    ringdown: list[tuple[float, list[RingdownMode]]]  # delay, s, and the modes after a pulse, the strongest first
    pulse: float | None  # s, the margin for a pulse; None: not near the linear margin
    scenario: list[Holds]  # of the run's own scenario


def pulsed(case: Case, delay: float, length: float = LENGTH) -> Case:
    """The run with a delay (s) and one event: a pulse of 0.01 % of the first load for half a second."""
    return with_pulse(with_delay(_lasting(case, length), delay), PULSE)


def _lasting(case: Case, duration: float) -> Case:
    return replace(case, run=case.run.model_copy(update={"duration": duration, "asked": None}))


def ringdown(case: Case, delay: float) -> list[RingdownMode]:
    """Modes of the nonlinear run after a pulse, the strongest first."""
    record = loop.run(pulsed(case, delay))
    return ringdown_modes(record.time_s, columns(speed_differences(record)), PULSE_END)


def growth(record: Record) -> float:
    """Growth rate of the oscillation over the second half of a run, 1/s: slope of the logarithm of the envelope.

    It uses the speed difference with the largest swing at the end, in windows of 5 s.
    """
    signals, t = columns(speed_differences(record)), record.time_s
    starts = np.arange(t[-1] / 2.0, t[-1] - WINDOW + 1e-6, WINDOW)
    sizes = np.array([envelope(t, signals, start, start + WINDOW) for start in starts])
    return float(np.polyfit(starts, np.log(sizes[:, int(np.argmax(sizes[-1]))]), 1)[0])


def pulse_margin(case: Case, linear: float, looked: Callable[[], None] = lambda: None) -> float | None:
    """The delay (s) at which a pulse neither grows nor decays; None if it is not near the linear margin."""

    def rate(delay: float) -> float:
        growth_rate = growth(loop.run(pulsed(case, delay)))
        looked()
        return growth_rate

    low, high = max(0.0, linear - REACH), linear + REACH
    if rate(low) >= 0.0 or rate(high) <= 0.0:
        return None
    return float(brentq(rate, low, high, xtol=FINE))


def bears(case: Case, delay: float) -> dict[tuple[str, float], bool]:
    """Whether a run of the scenario with a delay (s) meets each criterion over each horizon (s)."""
    record = loop.run(with_delay(_lasting(case, max(HORIZONS)), delay))
    lost = np.inf if record.in_synchronism.all() else record.time_s[-1]
    twin = twin_of(record)
    swings, holds_by_criterion = swings_of(record, twin), dict[tuple[str, float], bool]()
    for horizon in HORIZONS:
        run = _judged(record, twin, shortened(swings, horizon)) if lost >= horizon else CriterionFigures(LOST)
        holds_by_criterion |= {(criterion, horizon): not fails(criterion, run) for criterion in CRITERIA}
    return holds_by_criterion


def _judged(record: Record, twin: Twin | None, swings: Swings) -> CriterionFigures:
    """What the criteria need of a run."""
    fit = fit_ringdown(swings.time_s[: swings.ringing], swings.judged[: swings.ringing], swings.last)
    verdict = judge_run(record, twin, swings, lambda: fit).judgement.verdict
    return CriterionFigures(verdict, lowest_damping_ratio(fit.modes if fit else []))


def holding(case: Case, longest: float, looked: Callable[[], None]) -> list[Holds]:
    """The delays up to the longest (s) at which the run's scenario meets each criterion over each horizon.

    By steps, then by bisection of each change. `looked` is called after each run.
    """
    search = Margin(field="delay", high=longest, coarse=round(longest / COARSE) + 1, tolerance=CLOSE)
    seen: dict[float, dict[tuple[str, float], bool]] = {}
    pairs = [(criterion, horizon) for criterion in CRITERIA for horizon in HORIZONS]

    def failed(pair: tuple[str, float]) -> dict[float, bool | None]:
        return {delay: not met[pair] for delay, met in seen.items()}

    while wanted := {delay for pair in pairs for delay in margins.wanted(search, failed(pair))}:
        for delay in sorted(wanted):
            seen[delay] = bears(case, delay)
            looked()
    return [Holds(*pair, margins.holding([failed(pair)])) for pair in pairs]


def beside(linear_margin: LinearMargin, progress: Callable[[int, int], None]) -> Beside:
    """Simulations to compare with a linear margin: ringdowns at some delays, margins of a pulse and of the scenario."""
    done = 0

    def looked() -> None:
        nonlocal done
        done += 1
        progress(min(done, RUNS), RUNS)

    case, longest = linear_margin.case, float(linear_margin.delays[-1])
    end = min(longest, 1.25 * (longest if not linear_margin.margin else linear_margin.margin))
    rung = []
    for delay in np.unique(np.round(np.linspace(0.0, end, LOOKS), 2)).tolist():
        rung.append((delay, ringdown(case, delay)))
        looked()
    pulse = pulse_margin(case, linear_margin.margin, looked) if linear_margin.margin else None
    return Beside(rung, pulse, holding(case, longest, looked) if case.scenario.events else [])
