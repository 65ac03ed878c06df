"""Episodes: runs, drawn from a study by seed, in which an agent replaces a controller."""

from __future__ import annotations

from copy import deepcopy
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from facts_damping.analysis.measures import measure_weights
from facts_damping.case import loading
from facts_damping.case.changes import as_sets, change
from facts_damping.compiling.structs import Table
from facts_damping.control.called import sensed
from facts_damping.control.inputs import inputs
from facts_damping.errors import InputError
from facts_damping.parameters.field_errors import short
from facts_damping.parameters.run import Controller, Run
from facts_damping.signals import NANOSECONDS
from facts_damping.simulation import loop
from facts_damping.simulation.loop import build_loop
from facts_damping.simulation.programs.policies import check
from facts_damping_gym.many import AgentInputs, Episodes, Information, step_many
from facts_damping_studies.sweeps import sweep

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from facts_damping.case.model import Case
    from facts_damping.record import Record
    from facts_damping.simulation.parts import Parts

AGENT = "agent"  # its controller name
KEPT = ("devices", "signals", "link", "namespace", "fallback_of")  # fields taken from the replaced controller
MAX_SEED = 2**31


class Source:
    """Source of episodes: a run, or the points of a study."""

    def __init__(self, run: str | None, study: str | None, controller: int, fields: dict[str, Any]) -> None:
        """Read the source. Raises `InputError`, also if a run has no controller with devices."""
        if study is None:
            self._content, self._where = loading.read_run(run)
            self._set: dict[str, Any] = {}
            self.points: list[dict[str, Any]] = [{}]
        else:
            plan = sweep.plan(study, [])
            self._content, self._where, self._set = plan.base.content, plan.base.source, plan.base.set
            self.points = [point.changes for point in plan.points]
        self._fields, self._controller = fields, controller
        self._cases: dict[int, Case] = {}
        self.first = self.case(0, 0)

    def draw(self, random: np.random.Generator, options: dict[str, Any] | None = None) -> tuple[int, Case]:
        """A random point and its run with a random seed; `options` may set `point` and `seed`."""
        drawn = {"point": int(random.integers(len(self.points))), "seed": int(random.integers(MAX_SEED))}
        chosen = {name: int(value) for name, value in {**drawn, **(options or {})}.items() if name in drawn}
        return chosen["point"], self.case(**chosen)

    def case(self, point: int, seed: int) -> Case:
        """The run of a point, with a seed."""
        if not 0 <= point < len(self.points):
            raise InputError(f"point: {point} given; allowed: 0 to {len(self.points) - 1}")
        if point not in self._cases:
            self._cases[point] = self._made(self.points[point])
        case = self._cases[point]
        return replace(case, run=case.run.model_copy(update={"seed": seed}))

    def _made(self, changes: dict[str, Any]) -> Case:
        content, values = deepcopy(self._content), {**self._set, **self._fields, **changes}
        change(content, values, as_sets(values))
        content.pop("asked", None)
        rows = content.setdefault("controllers", [Controller().model_dump(include={"devices", "signals"})])
        c, installed = self._controller, content.get("devices", Run.model_fields["devices"].default)
        if not 0 <= c < len(rows) or not installed:
            problem = f"controller: {c} given; " + ("no device is installed" if not installed else f"{len(rows)} there")
            raise InputError(f"{self._where}: {problem}; allowed: a run with a controller of a device")
        content["controllers"] = list(rows)
        fields = {name: rows[c][name] for name in KEPT if name in rows[c]}
        content["controllers"][c] = {**fields, "name": AGENT, "external": True}
        return loading.make_case(content, self._where)


class Episode:
    """A run in progress with an agent as controller `c`; between steps, the newest tick has been delivered."""

    def __init__(
        self,
        case: Case,
        c: int,
        scale: NDArray[np.float64],
        window: NDArray[Any],
        deviations: NDArray[Any],
        parts: Parts,
    ) -> None:
        """Begin the run: the first tick is measured and delivered.

        The episode writes observations into `window`, (ticks, signals, 3), and `deviations`, (differences,). It uses
        `parts` of the episodes before it again, which ends them.
        """
        self.case, self.loop = case, build_loop(case, outside=True, part=parts.again)
        agent = case.controllers[c]
        names, pmus = [list(agent.signals)], [pmu.name for pmu in case.system.pmus]
        eyes = inputs(names, case.system.signals, pmus, case.system.frequency)
        self.eyes = AgentInputs(*eyes, sensed(1, len(names[0]), len(pmus)))
        self.limits = np.array([case.system.device(name).setpoint_max for name in agent.devices])
        self.weights = weights_of(case)
        window[:] = 0.0
        window[:, :, 2] = 1.0
        self._alone = Episodes(
            loops=Table([self.loop]),
            eyes=Table([self.eyes]),
            waits=np.zeros(1, np.bool_),
            ticks=np.full(1, -1),
            time_ns=np.zeros(1, np.int64),
            lost=np.zeros(1, np.bool_),
            agent=c,
            setpoints=np.zeros((1, len(agent.devices))),
            windows=window[None],
            scale=scale,
            weights=self.weights[None],
            deviations=deviations[None],
            information=first_information(1, places_of(case, c), [supervisor_of(case, c)]),
        )
        self._go_on()

    @property
    def tick(self) -> int:
        """The newest tick."""
        return int(self._alone.ticks[0])

    @property
    def time_s(self) -> float:
        """Time of the newest tick, s."""
        return float(self._alone.time_ns[0]) / NANOSECONDS

    def step(self, action: NDArray[Any]) -> None:
        """Answer the newest tick's delivery with an action, -1 to 1 of the limits, and advance to the next tick."""
        np.multiply(action, self.limits, out=self._alone.setpoints[0])
        self._go_on()

    def _go_on(self) -> None:
        step_many(self._alone, 0, 1)
        check(self.loop.programs)

    @property
    def information(self) -> Information:
        """What the information of the newest tick tells."""
        return self._alone.information

    @property
    def lost(self) -> bool:
        """Whether the plant has lost synchronism: the episode ends."""
        return bool(self._alone.lost[0])

    @property
    def over(self) -> bool:
        """Whether this is the last tick."""
        return self.tick + 1 >= self.case.ticks

    def record(self) -> Record:
        """The record up to now."""
        return loop.record(self.case, self.loop)


def first_information(episodes: int, places: list[int], supervisors: list[int]) -> Information:
    """What the information of episodes tells, at their start."""
    zeros, tripped = np.zeros(episodes), np.zeros(episodes, np.bool_)
    setpoints = np.zeros((episodes, len(places)))
    return Information(np.array(places), np.array(supervisors), zeros, zeros.copy(), setpoints, tripped)


def places_of(case: Case, c: int) -> list[int]:
    """Indices of the devices of controller `c` among those of the run."""
    return [list(case.run.devices).index(name) for name in case.controllers[c].devices]


def supervisor_of(case: Case, c: int) -> int:
    """Index of the supervisor of controller `c`; -1: it has none."""
    if case.supervision is None or case.controllers[c].fallback_of is not None:
        return -1
    return sum(controller.fallback_of is None for controller in case.controllers[:c])


def checked(action: Any, shape: tuple[int, ...]) -> NDArray[np.float64]:
    """Actions within -1 to 1. Raises `ValueError` for another shape and for what is no finite number."""
    try:
        asked = np.asarray(action, np.float64)
    except (TypeError, ValueError) as error:
        raise ValueError(f"action: {short(action)} given; allowed: numbers of shape {shape}") from error
    if asked.shape != shape and not (len(shape) == 1 and asked.size == shape[0]):
        raise ValueError(f"action: shape {asked.shape} given; allowed: {shape}, -1 to 1 for each device")
    if not np.isfinite(asked).all():
        at = np.argwhere(~np.isfinite(asked))[0]
        raise ValueError(f"action{at.tolist()}: {asked[tuple(at)]} given; allowed: a finite number, -1 to 1")
    return np.clip(asked.reshape(shape), -1.0, 1.0)


def weights_of(case: Case) -> NDArray[np.float64]:
    """Weights of the monitored speed differences, (differences, machines + PMUs).

    Of the speeds of machines, and where there is no rotor of the frequencies of PMUs.
    """
    machines = [machine.name for machine in case.system.machines]
    at = {
        pmu.name: machines.index(pmu.machine) if pmu.machine in machines else len(machines) + s
        for s, pmu in enumerate(case.system.pmus)
    }
    judged = measure_weights(case.system.model_dump(by_alias=True))
    speed_weights = np.zeros((len(judged), len(machines) + len(at)))
    for row, weights in zip(speed_weights, judged.values(), strict=True):
        for pmu, weight in weights.items():
            row[at[pmu]] += weight
    return speed_weights
