"""Search of controller parameters: the same procedure and budget for every controller, on one training scenario.

Differential evolution (Storn and Price 1997, as implemented in SciPy) minimises

    objective = int t (sum_i |dw_i| + rho |u| / u_max) dt                                       p.u. s^2

the ITAE (4.108) plus a cost of control effort, which also penalises limit cycles and offsets. A run that loses
synchronism has the objective 1000 minus the time that it lasted.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from facts_damping.analysis.indices import performance_indices
from facts_damping.analysis.measures import columns, speed_differences
from facts_damping.case.loading import changed_case, make_case
from facts_damping.control.table import CONTROLLERS, kind
from facts_damping.errors import InputError
from facts_damping.parameters.profile import DEFAULT_PROFILE
from facts_damping.parameters.run import Controller, Tuned, TunedController
from facts_damping.simulation import loop
from facts_damping.simulation.assembly import build_control, plant_residues
from facts_damping_studies.search.optimisers import differential_evolution
from facts_damping_studies.search.space import Space
from facts_damping_studies.sweeps.enumerated_axes import SCENARIO, Scheme, every_scheme
from facts_damping_studies.sweeps.pool import run_all

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

    from facts_damping.case.model import Case
    from facts_damping.control.parameter_tables import Value
    from facts_damping.small_signal.residues import Residues

POPULATION = 24
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
    """One search: a controller and its scheme."""

    task: TuningTask
    name: str
    scheme: Scheme


def rows(names: Sequence[str]) -> list[tuple[str, Scheme]]:
    """Controllers and schemes to be tuned; without names, all that have tunable parameters."""
    tunable = [name for name, row in CONTROLLERS.items() if row.tuned]
    for name in names:
        if not kind(name, "CONTROLLER").tuned:
            raise InputError(f"CONTROLLER: '{name}' given; allowed: {', '.join(tunable)}, or antecedent+consequent")
    return every_scheme(list(names) or tunable)


class Trainer:
    """The training scenario of a task, evaluated for a controller at any point of the search space."""

    def __init__(self, job: Job) -> None:
        """Build the plant once."""
        task, self.name, self.scheme, self.row = job.task, job.name, job.scheme, kind(job.name)
        self.signals = task.signals[: self.row.signals]
        fields = {"system": task.system, "scenario": task.scenario, "devices": task.devices, "controllers": []}
        fields |= {} if task.measurement is None else {"measurement": task.measurement}
        self.case = case = changed_case({}, f"tune {task.system}", {"profile": task.profile, **fields})
        residues = plant_residues(case)
        if residues is None:
            allowed = "a system whose machines swing"
            raise InputError(f"SYSTEM: {task.system} has no electromechanical mode; allowed: {allowed}")
        self.residues: Residues = residues
        self.space = Space(self.row, self.scheme, self.signals, task.devices)

    def parameters(self, at: NDArray[np.float64]) -> dict[str, Value]:
        """Parameters at a point of the search space, coordinates from 0 to 1."""
        limit = self.case.system.device(self.space.devices[0]).setpoint_max
        return self.space.parameters(at, self.residues, limit)

    def with_parameters(self, values: dict[str, Value]) -> Case:
        """The training case of the controller with these parameters."""
        ports = {"devices": self.case.run.devices, "signals": self.signals}
        controller = {"name": self.name, "scheme": self.scheme, **ports, "parameters": values}
        content = {**self.case.document(), "controllers": [controller], "asked": None}
        return make_case(content, f"tune {self.case.system.name}")

    def check(self) -> None:
        """Raise `InputError` if the controller does not fit these signals and devices."""
        build_control(self.with_parameters(self.parameters(np.full(len(self.space.ranges), 0.5))), self.residues)

    def objective(self, at: NDArray[np.float64]) -> float:
        """The objective at a point of the search space."""
        return objective(self.with_parameters(self.parameters(at)), self.residues)


def objective(case: Case, plant: Residues) -> float:
    """ITAE plus cost of effort; for a run that loses synchronism, 1000 minus its duration."""
    record = loop.finish(case, loop.build_loop(case, plant))
    t = record.time_s
    if not record.in_synchronism.all():
        return LOST - float(t[-1])
    limits = [case.system.device(name).setpoint_max for name in record.device_names]
    effort = RHO * record.devices["setpoint"] / np.array(limits)
    judged = np.hstack([columns(speed_differences(record)), effort])
    return performance_indices(t, judged)["ITAE"]


def search(job: Job) -> TunedController:
    """The best parameters within the budget of runs, by differential evolution from a Latin hypercube."""
    trainer = Trainer(job)
    start = _population(len(trainer.space.ranges), job.task.seed)
    generations = max(1, job.task.budget // POPULATION)
    optimum = differential_evolution(trainer.objective, start, generations, np.random.default_rng(job.task.seed))
    reached = float(f"{optimum.value:.5g}")
    values = trainer.parameters(optimum.best)
    return TunedController(name=job.name, scheme=job.scheme, objective=reached, parameters=values)


def _population(size: int, seed: int) -> NDArray[np.float64]:
    """A Latin hypercube of points."""
    random = np.random.default_rng(seed)
    places = np.array([random.permutation(POPULATION) for _ in range(size)]).T
    return np.asarray((places + random.random((POPULATION, size))) / POPULATION)


def tune(task: TuningTask, names: Sequence[str], jobs: int, progress: Callable[[int, int], None]) -> Tuned:
    """Search the parameters of every controller, several controllers in parallel."""
    asked = [Job(task, name, scheme) for name, scheme in rows(names)]
    trainers = [Trainer(job) for job in asked]
    for trainer in trainers:
        trainer.check()
    tuned_controllers = run_all(search, asked, jobs, progress)
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
