"""The search of parameters: one procedure and one budget for every controller, on a training scenario alone.

Differential evolution (Storn and Price 1997, as SciPy has it) makes small

    objective = int t (sum_i |dw_i| + rho |u| / u_max) dt                                       p.u. s^2

the ITAE (4.108) with a price on effort, so that neither a limit cycle nor an offset is free. A run that loses
synchronism counts 1000 less the time that it lasted.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np
from scipy.optimize import differential_evolution

from facts_damping import loop
from facts_damping.analysis.indices import performance_indices
from facts_damping.analysis.measures import columns, speed_differences
from facts_damping.configuration import Case, make_case
from facts_damping.control.table import CONTROLLERS, Kind, kind
from facts_damping.errors import InputError
from facts_damping.files import find
from facts_damping.parameters.run import Controller, Tuned, TunedController
from facts_damping.plant.build import build
from facts_damping.sensitivity import sensitivities
from facts_damping.studies.pool import run_all

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

    from facts_damping.sensitivity import Sensitivity

SCENARIO = "training"
POPULATION = 24
RHO = 1e-4  # p.u. of speed that the device's limit costs
LOST = 1000.0  # objective of a run that loses synchronism at once


class Range(NamedTuple):
    """Where a parameter is searched, on a line or by powers of ten."""

    low: float
    high: float
    logarithmic: bool = False

    def value(self, at: float) -> float:
        """The value at a place from 0 to 1, to four digits."""
        if self.logarithmic:
            return float(f"{self.low * (self.high / self.low) ** at:.4g}")
        return float(f"{self.low + at * (self.high - self.low):.4g}")


LEAD_LAG = {
    "gain": Range(1.0, 200.0, logarithmic=True),
    "T1": Range(0.01, 1.0, logarithmic=True),
    "T2": Range(0.01, 1.0, logarithmic=True),
    "T3": Range(0.01, 1.0, logarithmic=True),
    "T4": Range(0.01, 1.0, logarithmic=True),
}
NEURO_FUZZY = {
    "scale": Range(0.001, 0.05, logarithmic=True),
    "change_scale": Range(1e-4, 0.01, logarithmic=True),
    "weight": Range(0.0, 2.0),
    "spread": Range(0.1, 1.5),
    "width": Range(0.4, 3.0),
    "eta": Range(1e-4, 0.3, logarithmic=True),
    "momentum": Range(0.0, 0.9),
    "hbar": Range(0.001, 1.0, logarithmic=True),
    "leakage": Range(1e-5, 0.1, logarithmic=True),
}
WAVELETS = {"dilation": Range(0.5, 8.0)}
INDIRECT = {
    "identifier_eta": Range(0.001, 1.0, logarithmic=True),
    "identifier_leakage": Range(1e-4, 1.0, logarithmic=True),
    "identifier_weight": Range(0.5, 4.0),
}
RATES = ("fixed", "lyapunov")  # searched too: a place below and above one half


Scheme = Literal["direct", "indirect"] | None


class Job(NamedTuple):
    """One search: system, controller, scheme, budget (runs) and seed."""

    system: str
    name: str
    scheme: Scheme
    budget: int
    seed: int


def rows(names: Sequence[str]) -> list[tuple[str, Scheme]]:
    """Controllers and schemes to be tuned; no names: all that have parameters to choose."""
    asked = list(names) or [name for name in CONTROLLERS if name != "LLC"]
    if "LLC" in asked:
        raise InputError("CONTROLLER: 'LLC' given; allowed: LLC-tuned, or a neuro-fuzzy controller")
    found: list[tuple[str, Scheme]] = []
    for name in asked:
        schemes: tuple[Scheme, ...] = (None,) if kind(name, "CONTROLLER").network is None else ("direct", "indirect")
        found += [(name, scheme) for scheme in schemes]
    return found


def space(row: Kind, scheme: str | None) -> dict[str, Range]:
    """What is searched for a controller."""
    if row.network is None:
        return LEAD_LAG
    wavelets = WAVELETS if row.network.consequent in ("mexican-hat", "morlet") else {}
    return {**NEURO_FUZZY, **wavelets, **(INDIRECT if scheme == "indirect" else {})}


def parameters(row: Kind, scheme: str | None, at: NDArray[np.float64], response: float) -> dict[str, float | str]:
    """Parameters at a point of the search, each coordinate from 0 to 1; the last one is the kind of learning rate.

    The indirect scheme's Jacobian is `response` (p.u. per p.u. within a frame) where the direct one's is 1: its
    learning rates and penalties are searched in the same multiples.
    """
    found: dict[str, float | str] = {
        name: one.value(float(v)) for (name, one), v in zip(space(row, scheme).items(), at, strict=False)
    }
    if row.network is None:
        return found
    found["rate"] = RATES[int(at[-1] >= 0.5)]
    if scheme == "indirect":
        jacobian = response / float(found["scale"])
        squared = found["rate"] == "lyapunov"
        found["hbar"] = float(f"{float(found['hbar']) * (jacobian**2 if squared else jacobian):.4g}")
        if not squared:
            found["eta"] = float(f"{float(found['eta']) / jacobian:.4g}")
    return found


class Trainer:
    """The training scenario of a system, ready to be run with any parameters of a controller."""

    def __init__(self, system: str, name: str, scheme: str | None) -> None:
        """Build the plant once."""
        content = {"system": system, "scenario": SCENARIO, "controllers": [{"name": "LLC"}]}
        self.case = make_case(content, f"tune {system}")
        case = self.case
        start = build(case.system, case.run.devices, [])
        self.known: dict[tuple[str, str], Sensitivity] = sensitivities(
            start, case.system, case.run.devices, case.run.frame_rate
        )
        self.name, self.scheme, self.row = name, scheme, kind(name)
        limit = next(d.v_max for d in case.system.devices if d.name == case.run.devices[0])
        self.response = abs(self.known["speed", case.run.devices[0]].frame) * limit

    def with_parameters(self, values: dict[str, float | str]) -> Case:
        """The training case of the controller with these parameters."""
        controller = {"name": self.name, "scheme": self.scheme, "parameters": values}
        content = {**self.case.document(), "controllers": [controller], "asked": None}
        return make_case(content, f"tune {self.case.system.name}")

    def objective(self, at: NDArray[np.float64]) -> float:
        """The objective at a point of the search."""
        return objective(self.with_parameters(parameters(self.row, self.scheme, at, self.response)), self.known)


def objective(case: Case, known: dict[tuple[str, str], Sensitivity]) -> float:
    """ITAE with a price on effort; of a run that loses synchronism 1000 less its duration."""
    record = loop.finish(case, loop.build_loop(case, known))
    t = record.time_s
    if not record.in_synchronism.all():
        return LOST - float(t[-1])
    limits = [next(d.v_max for d in case.system.devices if d.name == name) for name in record.device_names]
    effort = RHO * record.devices["setpoint"] / np.array(limits)
    judged = np.hstack([columns(speed_differences(record)), effort])
    return performance_indices(t, judged)["ITAE"]


def search(job: Job) -> TunedController:
    """The best of a budget of runs, by differential evolution from a Latin hypercube."""
    trainer = Trainer(job.system, job.name, job.scheme)
    row = trainer.row
    size = len(space(row, job.scheme)) + (row.network is not None)
    found = differential_evolution(
        trainer.objective,
        [(0.0, 1.0)] * size,
        init=_population(size, job.seed),
        maxiter=max(0, job.budget // POPULATION - 1),
        rng=np.random.default_rng(job.seed),
        tol=0.0,
        polish=False,
    )
    values = parameters(row, job.scheme, found.x, trainer.response)
    return TunedController(name=job.name, scheme=job.scheme, objective=float(f"{found.fun:.5g}"), parameters=values)


def _population(size: int, seed: int) -> NDArray[np.float64]:
    """A Latin hypercube of points."""
    random = np.random.default_rng(seed)
    places = [random.permutation(POPULATION) for _ in range(size)]
    return np.asarray((np.array(places).T + random.random((POPULATION, size))) / POPULATION)


def tune(
    system: str, names: Sequence[str], budget: int, seed: int, jobs: int, progress: Callable[[int, int], None]
) -> Tuned:
    """Search for every controller, several at a time."""
    find("scenarios", SCENARIO, f"{system}/")
    todo = [Job(system, name, scheme, budget, seed) for name, scheme in rows(names)]
    made = run_all(search, todo, jobs, progress)
    command = " ".join(["facts-damping tune", system, *names, f"--budget {budget} --seed {seed}"])
    own = Controller()
    return Tuned(
        system=system,
        scenario=SCENARIO,
        signals=own.signals,
        devices=own.devices,
        command=command,
        controllers=made,
    )


def document(tuned: Tuned) -> dict[str, Any]:
    """The file under config/controllers."""
    return tuned.model_dump(exclude_none=True)
