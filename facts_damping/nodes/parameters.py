"""Parameters of the nodes: declared from the fields of a run, with meaning, unit and range."""

from __future__ import annotations

import time
from array import array
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from annotated_types import Ge, Gt, Le, Lt
from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor, SetParametersResult
from rclpy.parameter import Parameter

from facts_damping.case.controllers import check_parameter, with_weights
from facts_damping.case.loading import load_case
from facts_damping.control.bank import put
from facts_damping.control.table import kind
from facts_damping.errors import InputError, RunError
from facts_damping.parameters.files import check_writable
from facts_damping.parameters.run import Controller, Run, Weights
from facts_damping.parameters.validation import check
from facts_damping.parameters.yaml_text import dump
from facts_damping.terminal import write_whole

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    import numpy as np
    from numpy.typing import NDArray
    from pydantic.fields import FieldInfo
    from rclpy.node import Node

    from facts_damping.case.model import Case
    from facts_damping.parameters.link import Link

# Fields of a run that are parameters of every node; the others are reached through `set`.
RUN_FIELDS = ("system", "scenario", "link", "frame_rate", "duration", "seed")

FIXED = ("window", "start", "duration")  # of a link's stage: not to be changed while it runs

SAVE_S = 10.0  # wall time between two writings of what was learnt
FIRST_ANSWERS = 1  # tick by which every node has been heard: an identifier's first estimate is waited for in tick 1

OPTIONS: dict[str, tuple[Any, str]] = {
    "mode": (
        "lockstep",
        "lockstep: the plant waits for each tick's setpoints; realtime: it is paced by the clock",
    ),
    "timeout": (5.0, "longest wait for a silent node once the run goes, s"),
    "start_timeout": (30.0, "longest wait for the other nodes at the start, s"),
    "recorder": (False, "true: wait for a recorder before starting"),
    "view": (False, "true: wait for a live view before starting"),
    "join": (False, "true, in real time: take the place of a node that has left a graph under way; disarmed at first"),
}


@dataclass(frozen=True)
class Options:
    """Options of every node."""

    mode: str
    timeout: float
    start_timeout: float
    recorder: bool
    view: bool
    join: bool = False

    @property
    def realtime(self) -> bool:
        """Whether the plant is paced by the clock."""
        return self.mode == "realtime"

    def patience(self, tick: int) -> float:
        """Longest wait for an answer to a tick, s: until the first ones are there, nodes may still be starting."""
        return max(self.timeout, self.start_timeout) if tick <= FIRST_ANSWERS else self.timeout


def descriptor(description: str, unit: str = "", low: Any = None, high: Any = None, read_only: bool = True) -> Any:
    """A ROS parameter's descriptor with meaning, unit and range."""
    made = ParameterDescriptor(description=f"{description} [{unit}]" if unit else description, read_only=read_only)
    if isinstance(low, int) and isinstance(high, int):
        made.integer_range = [IntegerRange(from_value=low, to_value=high, step=1)]
    elif low is not None and high is not None:
        made.floating_point_range = [FloatingPointRange(from_value=float(low), to_value=float(high), step=0.0)]
    return made


def field_descriptor(field: FieldInfo, read_only: bool = True) -> Any:
    """The descriptor of a field of a run or of a stage, from its declaration."""
    low = next((m.ge if isinstance(m, Ge) else m.gt for m in field.metadata if isinstance(m, (Ge, Gt))), None)
    high = next((m.le if isinstance(m, Le) else m.lt for m in field.metadata if isinstance(m, (Le, Lt))), None)
    extra = field.json_schema_extra
    unit = str(extra.get("unit", "")) if isinstance(extra, dict) else ""
    return descriptor(field.description or "", unit, low, high, read_only)


def read_case(node: Node) -> Case:
    """Declare the run's parameters and read the case that they describe."""
    text = "name of a run under config/runs, or path of a YAML file; empty: all defaults"
    run: Any = node.declare_parameter("run", "", descriptor(text)).value
    sets: Any = node.declare_parameter(
        "set", Parameter.Type.STRING_ARRAY, descriptor("changes to the run: key.path=value")
    ).value
    sets = list(sets or [])
    case = load_case(run or None, sets)
    changed = []
    for name in RUN_FIELDS:
        value = case.duration if name == "duration" else getattr(case.run, name)
        if isinstance(value, (str, int, float)):
            given: Any = node.declare_parameter(name, value, field_descriptor(Run.model_fields[name])).value
            if given != value:
                changed.append(f"{name}={given}")
    return load_case(run or None, [*changed, *sets]) if changed else case


def read_options(node: Node, joins: bool = True) -> Options:
    """Declare and read the options of every node; `joins`: whether one of its kind may join a graph under way."""
    limits = {"timeout": (0.05, 3600.0), "start_timeout": (0.05, 3600.0)}
    values = {
        name: node.declare_parameter(name, default, descriptor(text, "", *limits.get(name, ()))).value
        for name, (default, text) in OPTIONS.items()
        if joins or name != "join"
    }
    options = Options(**values)
    if options.mode not in ("lockstep", "realtime"):
        raise InputError(f"mode: '{options.mode}' given; allowed: lockstep, realtime")
    if options.join and not options.realtime:
        raise InputError("join: true given; allowed: with mode realtime")
    return options


def declare_settings(
    node: Node, controller: Controller, names: list[str], rows: NDArray[Any], swing: NDArray[np.float64]
) -> None:
    """Declare parameters of a controller or its identifier; those that are safe to change may, into `rows` (SETTINGS).

    `swing` is that of the signals (control/bank.py). Raises `InputError` for a value that is not allowed, and where one
    that shapes the start differs from the run's: other nodes would not know.
    """
    table = kind(controller.name).parameters
    counts = {"signal": len(controller.signals), "device": len(controller.devices)}
    for name in names:
        p = table[name]
        text = f"{p.description}: {', '.join(p.choices)}" if p.choices else p.description
        low, high = (None, None) if p.choices else (p.low, p.high)
        wanted = controller.parameters[name]
        given = plain(node.declare_parameter(name, wanted, descriptor(text, p.unit, low, high, not p.live)).value)
        if given != wanted and not p.live:
            raise InputError(f"{name}: {given} given; allowed: the run's {wanted}, or set: controllers.<i>.parameters")
        check_parameter(name, name, given, table, counts)
        put(rows, name, p, given, swing)

    def change(changed: list[Parameter[Any]]) -> SetParametersResult:
        own = [(one.name, plain(one.value)) for one in changed if one.name in names]
        try:
            for name, value in own:
                check_parameter(name, name, value, table, counts)
        except InputError as error:
            return SetParametersResult(successful=False, reason=str(error))
        for name, value in own:
            put(rows, name, table[name], value, swing)
        return SetParametersResult(successful=True)

    node.add_on_set_parameters_callback(change)


def declare_stages(node: Node, link: Link, put: Callable[[str, int, Any], None]) -> None:
    """Declare the numbers of a link's stages, `up.0.delay`; `put` takes a direction, a place and the changed stage.

    Windows of a replay and times of a start are the run's, the others may change while it runs.
    """
    stages = {f"{way}.{i}": stage for way in ("up", "down") for i, stage in enumerate(getattr(link, way))}

    def change(values: Iterable[tuple[str, Any]]) -> None:
        new = dict(stages)
        for path, value in values:
            place, _, name = path.rpartition(".")
            if place in new:
                new[place] = check(type(new[place]), {**new[place].model_dump(), name: value}, "link", None, place)
        for place, stage in new.items():
            if stage != stages[place]:
                way, _, i = place.partition(".")
                put(way, int(i), stage)
        stages.update(new)

    def changed(parameters: list[Parameter[Any]]) -> SetParametersResult:
        try:
            change((one.name, one.value) for one in parameters)
        except InputError as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    given: list[tuple[str, Any]] = []
    for place, stage in stages.items():
        for name, value in stage.model_dump().items():
            if isinstance(value, float):
                wanted = field_descriptor(type(stage).model_fields[name], read_only=name in FIXED)
                given.append((f"{place}.{name}", node.declare_parameter(f"{place}.{name}", value, wanted).value))
    change(given)
    node.add_on_set_parameters_callback(changed)


def plain(value: Any) -> Any:
    """A parameter's value as YAML has it: rclpy gives numbers of a list in an array."""
    return value.tolist() if isinstance(value, array) else value


def read_index(node: Node, allowed: Iterable[int], what: str = "controllers") -> int:
    """Declare and read which of the run's controllers (or links) a node is or serves."""
    indices = list(allowed)
    text = f"which of the run's {what} this is, or serves"
    first = indices[0] if indices else 0
    index = int(node.declare_parameter("index", first, descriptor(text, "", 0, 15)).value)
    if index not in indices:
        there = ", ".join(map(str, indices)) or f"none: no such {what.removesuffix('s')}"
        raise InputError(f"index: {index} given; allowed: {there}")
    return index


class WeightsFile:
    """The file of what a node has learnt: brought up to date now and then, so that a killed node leaves it, too."""

    def __init__(self, node: Node) -> None:
        """Declare and read the parameters."""
        text = "file that the adapted weights go to, every 10 s and at the end; empty: none"
        name = str(node.declare_parameter("save", "", descriptor(text)).value)
        text = "true: begin with the weights in the file of `save`, where it is there"
        resume: Any = node.declare_parameter("resume", False, descriptor(text)).value
        check_writable(name or None, "save")
        if resume and not name:
            raise InputError("resume: true given; allowed: with save")
        self._path, self._resume = Path(name) if name else None, bool(resume)
        self._saved = time.monotonic()

    def start(self, case: Case, index: int) -> Case:
        """The case whose controller `index` begins with what was saved, if that is wanted and there."""
        if self._path is None or not self._resume or not self._path.is_file():
            return case
        controllers = list(case.controllers)
        controllers[index] = with_weights(controllers[index], self._path)
        return replace(case, controllers=controllers)

    def keep(self, learnt: Callable[[], Weights | None], last: bool = False) -> None:
        """Write what was learnt, whole or not at all, if it is time for that."""
        if self._path is None or not (last or time.monotonic() - self._saved > SAVE_S):
            return
        self._saved = time.monotonic()
        if (weights := learnt()) is None:
            return
        try:
            write_whole(self._path, dump(weights.model_dump()))
        except OSError as error:  # a full disk, say: no reason to stop under way
            if last:
                raise RunError(f"save: {self._path}: cannot be written: {error.strerror}") from error
