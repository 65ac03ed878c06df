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
from facts_damping.control.table import CONTROLLERS, Value, kind
from facts_damping.errors import InputError
from facts_damping.files import find
from facts_damping.parameters.run import Controller, Tuned, TunedController
from facts_damping.plant.build import build
from facts_damping.sensitivity import sensitivity
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
            return _four(self.low * (self.high / self.low) ** at)
        return _four(self.low + at * (self.high - self.low))


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
SHARE = Range(0.1, 10.0, logarithmic=True)  # scales of the second signal and on, by how they swing beside the first
HORIZON = Range(1.0, 24.0)  # frames, where there are several signals or devices
INDIRECT = {
    "identifier_eta": Range(0.001, 1.0, logarithmic=True),
    "identifier_leakage": Range(1e-4, 1.0, logarithmic=True),
    "identifier_weight": Range(0.5, 4.0),
}
RATES = ("fixed", "lyapunov")  # searched too: a place below and above one half


Scheme = Literal["direct", "indirect"] | None


class Task(NamedTuple):
    """What controllers are tuned for: a system, the devices that are installed and commanded, signals, budget, seed."""

    system: str
    devices: list[str]
    signals: list[str]
    budget: int
    seed: int


class Job(NamedTuple):
    """One search: a controller and its scheme."""

    task: Task
    name: str
    scheme: Scheme


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


class Trainer:
    """The training scenario of a task, ready to be run with a controller at any point of the search."""

    def __init__(self, job: Job) -> None:
        """Build the plant once."""
        task, self.name, self.scheme, self.row = job.task, job.name, job.scheme, kind(job.name)
        self.signals = task.signals[: self.row.signals]
        content = {"system": task.system, "scenario": SCENARIO, "devices": task.devices, "controllers": []}
        self.case = case = make_case(content, f"tune {task.system}")
        start = build(case.system, case.run.devices, [])
        found = sensitivity(start, case.system, case.run.devices, case.run.frame_rate)
        if found is None:
            raise InputError(f"SYSTEM: {task.system} has no swing mode; allowed: a system whose machines swing")
        self.sensitivity: Sensitivity = found
        self.limits = [next(d.v_max for d in case.system.devices if d.name == name) for name in task.devices]

    @property
    def space(self) -> dict[str, Range]:
        """What is searched: a coordinate for each parameter, `name.i` for that of device or signal i; the last is rate.

        Parameters that a list may give are searched for each device; scales for the first signal, with a share for
        each of the others.
        """
        if self.row.network is None:
            return self._each(LEAD_LAG)
        several = len(self.signals) * len(self.limits) > 1
        wavelets = WAVELETS if self.row.network.consequent in ("mexican-hat", "morlet") else {}
        made = {**self._each(NEURO_FUZZY), **wavelets, **(INDIRECT if self.scheme == "indirect" else {})}
        if several and self.scheme == "indirect":
            made["identifier_horizon"] = HORIZON
            del made["identifier_weight"]
        made |= {f"share.{i}": SHARE for i in range(1, len(self.signals))}
        return {**made, "rate": Range(0.0, 1.0)}

    def _each(self, ranges: dict[str, Range]) -> dict[str, Range]:
        made: dict[str, Range] = {}
        for name, one in ranges.items():
            if self.row.parameters[name].each == "device" and len(self.limits) > 1:
                made |= {f"{name}.{d}": one for d in range(len(self.limits))}
            else:
                made[name] = one
        return made

    def parameters(self, at: NDArray[np.float64]) -> dict[str, Value]:
        """Parameters at a point of the search, each coordinate from 0 to 1."""
        found: dict[str, Value] = {}
        for (place, one), v in zip(self.space.items(), at, strict=True):
            name, _, entry = place.partition(".")
            own = found.setdefault(name, []) if entry else None
            if own is None:
                found[name] = one.value(float(v))
            elif isinstance(own, list):
                own.append(one.value(float(v)))
        if self.row.network is None:
            return found
        found["rate"] = RATES[int(at[-1] >= 0.5)]
        shares = found.pop("share", None)
        if isinstance(shares, list):
            beside = [abs(self.sensitivity.ratio(signal, self.signals[0])) for signal in self.signals[1:]]
            for name in ("scale", "change_scale"):
                first = float(found[name])  # type: ignore[arg-type]
                found[name] = [first, *[_four(first * s * b) for s, b in zip(shares, beside, strict=True)]]
        if self.scheme == "indirect":
            self._in_multiples(found)
        return found

    def _in_multiples(self, found: dict[str, Value]) -> None:
        """Learning rate and penalties where the Jacobian is 1 become those of the indirect scheme.

        Its Jacobian is what the first device's limit does to the first signal over the identifier's horizon.
        """
        if "identifier_horizon" in found:
            found["identifier_horizon"] = float(round(float(found["identifier_horizon"])))  # type: ignore[arg-type]
        horizon = int(float(found.get("identifier_horizon", 1.0)))  # type: ignore[arg-type]
        answer = self.sensitivity.jacobian(self.signals[:1], [self.case.run.devices[0]], horizon)[0, 0]
        scale = found["scale"]
        jacobian = abs(float(answer)) * self.limits[0] / float(scale[0] if isinstance(scale, list) else scale)
        by = jacobian**2 if found["rate"] == "lyapunov" else jacobian
        hbar = found["hbar"]
        found["hbar"] = [_four(float(h) * by) for h in hbar] if isinstance(hbar, list) else _four(float(hbar) * by)
        if found["rate"] != "lyapunov":
            found["eta"] = _four(float(found["eta"]) / jacobian)  # type: ignore[arg-type]

    def with_parameters(self, values: dict[str, Value]) -> Case:
        """The training case of the controller with these parameters."""
        controller = {
            "name": self.name,
            "scheme": self.scheme,
            "devices": self.case.run.devices,
            "signals": self.signals,
            "parameters": values,
        }
        content = {**self.case.document(), "controllers": [controller], "asked": None}
        return make_case(content, f"tune {self.case.system.name}")

    def objective(self, at: NDArray[np.float64]) -> float:
        """The objective at a point of the search."""
        return objective(self.with_parameters(self.parameters(at)), self.sensitivity)


def _four(value: float) -> float:
    """A value to four digits."""
    return float(f"{value:.4g}")


def objective(case: Case, plant: Sensitivity) -> float:
    """ITAE with a price on effort; of a run that loses synchronism 1000 less its duration."""
    record = loop.finish(case, loop.build_loop(case, plant))
    t = record.time_s
    if not record.in_synchronism.all():
        return LOST - float(t[-1])
    limits = [next(d.v_max for d in case.system.devices if d.name == name) for name in record.device_names]
    effort = RHO * record.devices["setpoint"] / np.array(limits)
    judged = np.hstack([columns(speed_differences(record)), effort])
    return performance_indices(t, judged)["ITAE"]


def search(job: Job) -> TunedController:
    """The best of a budget of runs, by differential evolution from a Latin hypercube."""
    trainer = Trainer(job)
    size = len(trainer.space)
    found = differential_evolution(
        trainer.objective,
        [(0.0, 1.0)] * size,
        init=_population(size, job.task.seed),
        maxiter=max(0, job.task.budget // POPULATION - 1),
        rng=np.random.default_rng(job.task.seed),
        tol=0.0,
        polish=False,
    )
    reached = float(f"{found.fun:.5g}")
    values = trainer.parameters(found.x)
    return TunedController(name=job.name, scheme=job.scheme, objective=reached, parameters=values)


def _population(size: int, seed: int) -> NDArray[np.float64]:
    """A Latin hypercube of points."""
    random = np.random.default_rng(seed)
    places = [random.permutation(POPULATION) for _ in range(size)]
    return np.asarray((np.array(places).T + random.random((POPULATION, size))) / POPULATION)


def tune(task: Task, names: Sequence[str], jobs: int, progress: Callable[[int, int], None]) -> Tuned:
    """Search for every controller, several at a time."""
    find("scenarios", SCENARIO, f"{task.system}/")
    Trainer(Job(task, "ANFTSC", "direct")).with_parameters({})  # devices and signals that it cannot have
    made = run_all(search, [Job(task, name, scheme) for name, scheme in rows(names)], jobs, progress)
    own = Controller()
    more = [f"--devices {','.join(task.devices)}"] if task.devices != own.devices else []
    more += [f"--signals {','.join(task.signals)}"] if task.signals != own.signals else []
    words = ["facts-damping tune", task.system, *names, *more, f"--budget {task.budget} --seed {task.seed}"]
    return Tuned(
        system=task.system,
        scenario=SCENARIO,
        signals=task.signals,
        devices=task.devices,
        command=" ".join(words),
        controllers=made,
    )


def document(tuned: Tuned) -> dict[str, Any]:
    """The file under config/controllers."""
    return tuned.model_dump(exclude_none=True)
