"""Search of controller parameters: the same procedure and budget for every controller, on one training scenario.

Differential evolution (Storn and Price 1997, as implemented in SciPy) minimises

    objective = int t (sum_i |dw_i| + rho |u| / u_max) dt                                       p.u. s^2

the ITAE (4.108) plus a cost of control effort, which also penalises limit cycles and offsets. A run that loses
synchronism has the objective 1000 minus the time that it lasted.
"""

from __future__ import annotations

import os
from pathlib import Path
from tempfile import TemporaryDirectory
from threading import Event, Thread
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar

import numpy as np

from facts_damping.analysis.indices import performance_indices
from facts_damping.analysis.measures import columns, speed_differences
from facts_damping.case.loading import changed_case, make_case
from facts_damping.control.table import CONTROLLERS, kind
from facts_damping.errors import InputError
from facts_damping.parameters.profile import DEFAULT_PROFILE
from facts_damping.parameters.run import Controller, Tuned, TunedController
from facts_damping.plant.build import build
from facts_damping.simulation import loop
from facts_damping.simulation.assembly import build_control, plant_residues
from facts_damping.small_signal import residues as small_signal
from facts_damping_studies.search.optimisers import differential_evolution
from facts_damping_studies.search.space import Space, space_of
from facts_damping_studies.sweeps.enumerated_axes import SCENARIO, Scheme, every_scheme
from facts_damping_studies.sweeps.pool import run_all

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from numpy.typing import NDArray

    from facts_damping.case.model import Case
    from facts_damping.control.parameter_tables import Value
    from facts_damping.small_signal.residues import Residues

POPULATION = 24
POLL_S = 0.5  # between two looks at what is done
RHO = 1e-4  # p.u. of speed, the cost of the device at its limit
LOST = 1000.0  # objective of a run that loses synchronism at once


class TuningTask(NamedTuple):
    """Conditions of tuning: system, devices installed and commanded, signals, profile, measurement."""

    system: str
    devices: list[str]
    signals: list[str]
    budget: int
    seed: int
    measurement: str | None = None  # None: the profile's
    profile: str = DEFAULT_PROFILE
    scenario: str = SCENARIO  # name of one of the system's scenarios, or a file


class Job(NamedTuple):
    """One search: training cases without control, a controller's row without its parameters, budget and seed."""

    cases: Sequence[Case]
    controller: dict[str, Any]
    budget: int  # runs
    seed: int
    population: int = POPULATION
    weights: Sequence[float] = (1.0,)  # of the cases' objectives
    mode_hz: float | None = None  # of the mode whose residue gives scale and sign of gains; None: the least damped
    start: Mapping[str, Value] = {}  # parameters of one of the first points
    done: str = ""  # file whose size is the number of runs done; empty: none

    @property
    def generations(self) -> int:
        """Generations that the budget allows, at least one."""
        return max(1, self.budget // (self.population * len(self.cases)))

    @property
    def runs(self) -> int:
        """Runs of the first points and all generations."""
        return self.generations * self.population * len(self.cases)


def job(task: TuningTask, name: str, scheme: Scheme) -> Job:
    """The search of a task for a controller and its scheme."""
    fields = {"system": task.system, "scenario": task.scenario, "devices": task.devices, "controllers": []}
    fields |= {} if task.measurement is None else {"measurement": task.measurement}
    case = changed_case({}, f"tune {task.system}", {"profile": task.profile, **fields})
    signals = task.signals[: kind(name).signals]
    controller = {"name": name, "scheme": scheme, "devices": task.devices, "signals": signals}
    return Job([case], controller, task.budget, task.seed, POPULATION)


def rows(names: Sequence[str]) -> list[tuple[str, Scheme]]:
    """Controllers and schemes to be tuned; without names, all that have tunable parameters."""
    tunable = [name for name, row in CONTROLLERS.items() if row.tuned]
    for name in names:
        if not kind(name, "CONTROLLER").tuned:
            raise InputError(f"CONTROLLER: '{name}' given; allowed: {', '.join(tunable)}, or antecedent+consequent")
    return every_scheme(list(names) or tunable)


class Trainer:
    """The training cases, evaluated for a controller at any point of its search space."""

    def __init__(self, job: Job) -> None:
        """Linearise the plant once."""
        self.job = job
        self.case = case = job.cases[0]
        residues = plant_residues(case)
        if residues is None:
            allowed = "a system whose machines swing"
            raise InputError(f"SYSTEM: {case.system.name} has no electromechanical mode; allowed: {allowed}")
        self.residues: Residues = residues
        self.scaling: Residues = residues
        if job.mode_hz is not None:
            system, devices, rate = case.designed_on, case.run.devices, case.run.frame_rate
            at_mode = small_signal.residues(build(system, devices, []), system, devices, rate, case.filter, job.mode_hz)
            self.scaling = at_mode or residues
        self.space = space_of(job.controller)
        self.limit = float(case.system.device(job.controller["devices"][0]).setpoint_max)

    def parameters(self, at: NDArray[np.float64]) -> dict[str, Value]:
        """Parameters at a point of the search space, coordinates from 0 to 1."""
        return self.space.parameters(at, self.scaling, self.limit)

    def with_parameters(self, values: dict[str, Value], case: Case | None = None) -> Case:
        """A training case, by default the first, of the controller with these parameters."""
        controller = {**self.job.controller, "parameters": values}
        content = {**(case or self.case).document(), "controllers": [controller], "asked": None}
        return make_case(content, f"tune {self.case.system.name}")

    def check(self) -> None:
        """Raise `InputError` if the controller does not fit these signals and devices."""
        build_control(self.with_parameters(self.parameters(np.full(len(self.space.ranges), 0.5))), self.residues)

    def objective(self, at: NDArray[np.float64]) -> float:
        """The weighted sum of the cases' objectives at a point of the search space."""
        values, total = self.parameters(at), 0.0
        for weight, case in zip(self.job.weights, self.job.cases, strict=True):
            total += weight * objective(self.with_parameters(values, case), self.residues)
            if self.job.done:
                os.truncate(self.job.done, Path(self.job.done).stat().st_size + 1)
        return total


def objective(case: Case, plant: Residues | None) -> float:
    """ITAE plus cost of effort; for a run that loses synchronism, 1000 minus its duration."""
    record = loop.finish(case, loop.build_loop(case, plant))
    t = record.time_s
    if not record.in_synchronism.all():
        return LOST - float(t[-1])
    limits = [case.system.device(name).setpoint_max for name in record.device_names]
    effort = RHO * record.devices["setpoint"] / np.array(limits)
    judged = np.hstack([columns(speed_differences(record)), effort])
    return performance_indices(t, judged)["ITAE"]


def uncontrolled(case: Case) -> float:
    """The objective without control."""
    alone = {**case.document(), "supervision": None, "arm_at": None, "asked": None}
    return objective(make_case(alone, f"tune {case.system.name}"), None)


def best(job: Job) -> tuple[dict[str, Value], float]:
    """The best parameters within the budget of runs, and their objective.

    Differential evolution from a Latin hypercube.
    """
    trainer = Trainer(job)
    start = _population(len(trainer.space.ranges), job.seed, job.population)
    if job.start and isinstance(trainer.space, Space):
        start[0] = trainer.space.place(job.start, trainer.scaling, trainer.limit)
    optimum = differential_evolution(trainer.objective, start, job.generations, np.random.default_rng(job.seed))
    return trainer.parameters(optimum.best), float(f"{optimum.value:.5g}")


T = TypeVar("T")


def in_parallel(
    function: Callable[[Job], T], searches: Sequence[Job], jobs: int, progress: Callable[[int, int], None]
) -> list[T]:
    """Results of searches, several in parallel. The progress counts their runs, by the sizes of a file for each."""
    total, over = sum(each.runs for each in searches), Event()
    with TemporaryDirectory() as folder:
        files = [Path(folder) / str(i) for i in range(len(searches))]
        for file in files:
            file.touch()

        def tell() -> None:
            progress(min(total, sum(file.stat().st_size for file in files)), total)

        def watch() -> None:
            while not over.wait(POLL_S):
                tell()

        watching = Thread(target=watch, daemon=True)
        watching.start()
        try:
            counted = [each._replace(done=str(file)) for each, file in zip(searches, files, strict=True)]
            return run_all(function, counted, jobs, lambda *_: None)
        finally:
            over.set()
            watching.join()
            tell()


def search(job: Job) -> TunedController:
    """The best parameters of a shipped controller within the budget of runs."""
    values, reached = best(job)
    name, scheme = job.controller["name"], job.controller["scheme"]
    return TunedController(name=name, scheme=scheme, objective=reached, parameters=values)


def _population(size: int, seed: int, points: int) -> NDArray[np.float64]:
    """A Latin hypercube of points."""
    random = np.random.default_rng(seed)
    places = np.array([random.permutation(points) for _ in range(size)]).T
    return np.asarray((places + random.random((points, size))) / points)


def tune(task: TuningTask, names: Sequence[str], jobs: int, progress: Callable[[int, int], None]) -> Tuned:
    """Search the parameters of every controller, several controllers in parallel."""
    asked = [job(task, name, scheme) for name, scheme in rows(names)]
    trainers = [Trainer(each) for each in asked]
    for trainer in trainers:
        trainer.check()
    tuned_controllers = in_parallel(search, asked, jobs, progress)
    default = Controller()
    more = [f"--devices {','.join(task.devices)}"] if task.devices != default.devices else []
    more += [f"--signals {','.join(task.signals)}"] if task.signals != default.signals else []
    more += [f"--measurement {task.measurement}"] if task.measurement is not None else []
    more += [f"--profile {task.profile}"] if task.profile != DEFAULT_PROFILE else []
    more += [f"--scenario {task.scenario}"] if task.scenario != SCENARIO else []
    words = ["facts-damping tune", task.system, *names, *more, f"--budget {task.budget} --seed {task.seed}"]
    return Tuned(
        system=trainers[0].case.system.name,
        profile=task.profile,
        scenario=Path(task.scenario).stem,
        signals=task.signals,
        devices=task.devices,
        measurement=trainers[0].case.measurement.filter,
        command=" ".join(words),
        controllers=tuned_controllers,
    )


def document(tuned: Tuned) -> dict[str, Any]:
    """The content of the file under config/controllers."""
    return tuned.model_dump(exclude_defaults=True)
