"""From a run's devices and signals to a law with a certificate: scenarios, tuning of all structures, margins."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from scipy.linalg import qr

from facts_damping.control.linear_law import Matrices
from facts_damping.errors import InputError
from facts_damping.measurement.build import wrong_at
from facts_damping_studies.design.places import merged
from facts_damping_studies.robust import certificate, trials
from facts_damping_studies.robust.certificate import Law
from facts_damping_studies.robust.laws import Setting, TuningTask, again, problem, sizes, starts, tune
from facts_damping_studies.robust.objective import ENOUGH, LOST, NOISE
from facts_damping_studies.robust.scenarios import INTACT, scenarios
from facts_damping_studies.robust.tuning import best
from facts_damping_studies.score.reference import mean_loop_delay
from facts_damping_studies.sweeps.pool import run_all

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from numpy.typing import NDArray

    from facts_damping.case.model import Case
    from facts_damping_studies.robust.certificate import Row
    from facts_damping_studies.robust.scenarios import Scenario, Scenarios
    from facts_damping_studies.robust.tuning import Tuned

    Array = NDArray[np.float64]
    Tell = Callable[[str, str], Callable[[int, int], None]]

NAME = "designed"  # of the controller
DRIFTS = 6
EVALUATIONS = 100  # of the objective, in each round of a tuning
TUNED_AT, CHECKED_AT = 3, 5  # delays for which laws are tuned, and of the certificate
CHECKS, LOAD_STEP = 2, 0.1  # worst scenarios that are run, and the step of the largest load
SLOWLY, WEAKER = 0.8, 12  # of the gain of a law with which a sampled loop grows, and how often at most
MARGINS_AT = 3  # worst scenarios of which margins are computed
LEAST_NOISE = 5e-6  # p.u., for which laws are designed if the PMUs have less
SIGNALS = 6  # most signals of a law
EXACT = 0.001  # damping ratio by which sampled loops may differ from those that laws are tuned for
INDEPENDENT = 1e-2  # of the largest: what a signal shows of the modes beside the others
CHANNELS = "speed_deviation", "frequency"


class RobustTask(NamedTuple):
    """Specification: a case whose devices act, its signals, and what the law has to bear."""

    case: Case
    signals: Sequence[str]  # that may be used
    further_delay: float  # s, beyond the link's mean
    outages: int
    laws: Sequence[str]
    jobs: int


class Margins(NamedTuple):
    """Margins of a loop in a scenario."""

    scenario: str
    delay: float  # s, to which the loop is stable
    gain: tuple[float, float]  # factors of all setpoints between which it is
    disc: float  # alpha


@dataclass(frozen=True)
class RobustDesign:
    """A law and its certificate."""

    task: RobustTask
    signals: list[str]  # used
    delays: list[float]  # s, of the certificate
    scenarios: Scenarios
    size: Array  # of the signals
    results: list[Tuned]  # of all structures
    chosen: Tuned
    law: Law
    rows: list[Row]  # all scenarios at all delays, and lost signals and devices
    margins: list[Margins]  # of the intact grid and of the worst scenarios
    checks: list[TimeCheck]  # nonlinear

    @property
    def worst(self) -> Row:
        """The row with the least damping ratio, of scenarios that count as they are."""
        return min(self.counted, key=lambda row: row.damping)

    @property
    def counted(self) -> list[Row]:
        """The rows of scenarios in which no device acts the other way round."""
        return [row for row in self.rows if row.scenario not in self.chosen.inverted]

    @property
    def row(self) -> dict[str, Any]:
        """The law as a row of `controllers`."""
        return law_row(self.law, self.signals, self.task.case.run.devices)

    @property
    def effort(self) -> float:
        """Rms of a setpoint for the noise of the signals, of its limit."""
        return self.chosen.judged.effort


def designed(task: RobustTask, tell: Tell) -> RobustDesign:
    """The best law of all structures. Raises `InputError` if no signal can be used."""
    case, devices = task.case, task.case.run.devices
    usable = _usable(case, task.signals)
    lumped = replace(case, system=merged(case.system))  # equal machines have equal modes, without vectors of their own
    grids = scenarios(lumped, usable, task.outages, DRIFTS, task.jobs, tell)
    rows = independent(grids.all[0], len(usable))
    signals = [usable[i] for i in rows]
    grids = grids.of_signals(rows)
    setting = _setting(case, signals)
    delay = mean_loop_delay(case)
    checked_at = np.linspace(delay, delay + task.further_delay, CHECKED_AT).tolist()
    size = sizes(grids.all[0])
    of = problem(grids.all, setting, np.linspace(delay, delay + task.further_delay, TUNED_AT).tolist(), size)
    structures = starts(of, grids.all[0], setting, delay, size, task.laws)
    tasks = [TuningTask(of, structure, EVALUATIONS, case.run.seed) for structure in structures]
    results: list[Tuned] = run_all(tune, tasks, task.jobs, tell("design", "laws"))
    first = best(results)
    more = again(of.inverted(first.inverted), first, EVALUATIONS, case.run.seed)
    others: list[Tuned] = run_all(tune, more, task.jobs, tell("design", "laws with other weights"))
    others = [each._replace(inverted=first.inverted) for each in others]
    results += others
    rivals = [first, *(each for each in others if each.kept)]
    laws = [sound(law_of(each, setting, size, len(devices)), grids, each.inverted, checked_at) for each in rivals]
    compared = trials.compared(
        trials.drawn(case, _lines(grids), task.jobs, tell("design", "events")),
        [law_row(law, signals, devices) for law in laws],
        task.jobs,
        tell("design", "runs"),
    )
    i = int(np.argmin(compared))
    chosen, law = rivals[i], laws[i]
    listed = certificate.rows(grids.all, law, checked_at)
    listed += certificate.lost(grids.all[0].modal, law, (signals, devices), checked_at)
    whole = RobustDesign(task, signals, checked_at, grids, size, results, chosen, law, listed, [], [])
    margins = _margins(whole, delay, tell("design", "margins"))
    return replace(whole, margins=margins, checks=checked(whole, tell("design", "checks")))


def _usable(case: Case, names: Sequence[str]) -> list[str]:
    signals = case.system.signals
    usable = [name for name in names if signals[name].channel in CHANNELS and signals[name].washout == 0.0]
    if not usable:
        listed = ", ".join(f"{name} ({signals[name].channel})" for name in names) or "none"
        raise InputError(f"signals: {listed} given; allowed: {' or '.join(CHANNELS)}, without washout")
    return usable


def independent(scenario: Scenario, many: int) -> list[int]:
    """Signals that show the modes beside each other, the most telling first, in their order; at most SIGNALS."""
    plant = scenario.modal
    weight = np.abs(plant.B).max(axis=1) / np.maximum(np.abs(plant.values.real), 0.05)
    shown = plant.C * weight
    shown = shown / np.maximum(np.abs(shown).max(axis=1, keepdims=True), 1e-300)
    _, R, order = qr(np.hstack([shown.real, shown.imag]).T, mode="economic", pivoting=True)
    size = np.abs(np.diag(R))
    count = min(int((size > INDEPENDENT * size[0]).sum()), SIGNALS, many)
    return sorted(int(i) for i in order[:count])


def _setting(case: Case, signals: Sequence[str]) -> Setting:
    """What a law of a case acts by."""
    devices = [case.system.device(name) for name in case.run.devices]
    nominal = case.system.frequency
    noise = []
    for name in signals:
        weights = case.system.signals[name].weights
        parts = [w * wrong_at(case.measurement, pmu)[0].frequency / nominal for pmu, w in weights.items()]
        noise.append(max(float(np.linalg.norm(parts)), LEAST_NOISE))
    rate = case.run.frame_rate
    latency = case.filter.delay / rate + 1.0 / rate + np.array([device.dead_time for device in devices])
    limits = np.array([device.setpoint_max for device in devices], float)
    return Setting(limits, latency, np.array(noise), rate)


def law_of(result: Tuned, setting: Setting, size: Array, devices: int) -> Law:
    """A tuned law in p.u."""
    K, n = result.K, result.structure.states
    of_devices = setting.limits[:, None]
    parts = K[:n, :n], K[:n, n:] / size, of_devices * K[n:, :n], of_devices * K[n:, n:] / size
    return Law(Matrices(*parts), list(range(len(size))), list(range(devices)), setting.frame_rate)


def law_row(law: Law, signals: Sequence[str], devices: Sequence[str]) -> dict[str, Any]:
    """A law as a row of `controllers`."""
    matrices = {name: matrix.tolist() for name, matrix in law.matrices._asdict().items()}
    return {"name": NAME, "linear": matrices, "devices": list(devices), "signals": list(signals)}


class TimeCheck(NamedTuple):
    """The worst scenario in a nonlinear run without noise: index over that without control; None: synchronism lost."""

    scenario: str
    event: str
    ratio: float | None
    lost_without: bool


def checked(design: RobustDesign, progress: Callable[[int, int], None]) -> list[TimeCheck]:
    """Nonlinear runs of the outages among the worst scenarios, as events, and of a step of the largest load."""
    case = design.task.case
    order = [row.scenario for row in sorted(design.counted, key=lambda row: row.damping)]
    scenarios = {each.name: each for each in design.scenarios.all}
    names = list(dict.fromkeys(name for name in order if name in scenarios))[:CHECKS]
    checks = []
    for i, name in enumerate([INTACT, *(other for other in names if other != INTACT)]):
        progress(i, len(names) + 1)
        scenario = scenarios[name]
        load = max(case.system.loads, key=lambda each: each.P, default=None)
        step = [] if load is None else [{"time": 1.0, "kind": "load_step", "load": load.name, "change": LOAD_STEP}]
        out = [{"time": 1.0, "kind": "line_out", "line": scenario.line}]
        events, system = (step, scenario.system) if scenario.line is None else (out, case.system)
        changed = replace(case, system=system)
        with_law, none = (trials.index(trials.Trial(changed, row, events)) for row in (design.row, None))
        ratio = None if with_law is None or none is None else with_law / none
        text = f"outage of {scenario.line}" if scenario.line else f"step of {load.name if load else 'no load'}"
        checks.append(TimeCheck(name, text, ratio, none is None))
    progress(1, 1)
    return checks


def _lines(grids: Scenarios) -> list[str]:
    """Lines whose outages are scenarios; without such, all lines."""
    out = [each.line for each in grids.all if each.line is not None]
    return out or [line.name for line in grids.all[0].system.lines]


def sound(law: Law, grids: Scenarios, inverted: Mapping[str, Sequence[int]], delays: Sequence[float]) -> Law:
    """The law with the largest gain, at most its own, with which no sampled loop grows that does not without it."""
    counted = [each for each in grids.all if each.name not in inverted]
    for _ in range(WEAKER):
        listed = certificate.rows(counted, law, [delays[0], delays[-1]])
        if all(row.stable for row in listed):
            break
        law = law.scaled(SLOWLY)
    return law


def _margins(design: RobustDesign, delay: float, progress: Callable[[int, int], None]) -> list[Margins]:
    """Margins of the intact grid and of the scenarios with the least damping."""
    plants = {scenario.name: scenario.modal for scenario in design.scenarios.all}
    order = sorted((row for row in design.counted if row.scenario in plants), key=lambda row: row.damping)
    names = list(dict.fromkeys([design.scenarios.all[0].name, *(row.scenario for row in order)]))[: MARGINS_AT + 1]
    margins = []
    for i, name in enumerate(names):
        progress(i, len(names))
        of = plants[name], design.law, delay
        margins.append(
            Margins(name, certificate.delay_margin(*of), certificate.gain_margin(*of), certificate.disc_margin(*of))
        )
    progress(1, 1)
    return margins


def violations(design: RobustDesign) -> list[str]:
    """What of the demands the certificate does not confirm, as sentences; empty: nothing."""
    sentences = [
        f"{row.scenario}, {1e3 * row.delay:.0f} ms: damping ratio {row.damping:.4f}, without control {row.without:.4f}"
        for row in design.counted
        if row.damping < min(row.without, ENOUGH) - LOST - EXACT or not row.stable
    ]
    if design.effort > NOISE:
        sentences.append(f"noise moves setpoints by {100 * design.effort:.1f} % of their limits")
    return sentences
