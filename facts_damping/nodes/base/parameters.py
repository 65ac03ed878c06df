"""ROS parameters of the nodes, declared from the fields of a run with meaning, unit and range."""

from __future__ import annotations

from array import array
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from annotated_types import Ge, Gt, Le, Lt
from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.parameter import Parameter

from facts_damping.case.loading import load_case
from facts_damping.errors import InputError
from facts_damping.parameters.run import Run

if TYPE_CHECKING:
    from collections.abc import Iterable

    from pydantic.fields import FieldInfo
    from rclpy.node import Node

    from facts_damping.case.model import Case

# Fields of a run that are parameters of every node; the others are changed by the parameter `set`.
RUN_FIELDS = ("system", "scenario", "link", "measurement", "frame_rate", "duration", "seed")

FIRST_ANSWERS = 1  # tick by which every node has answered once: tick 1 waits for the identifiers' first estimates

FREE_RUN = "two_area_free"  # a run that starts at rest and stays there
MODES = ("free", "lockstep", "realtime")
STAMPS = ("simulated", "wall")
OPTIONS: dict[str, tuple[Any, str]] = {
    "mode": (
        "free",
        "free: paced by the clock, nodes come and go; realtime: paced by the clock, all from the start; "  # noqa: ISC004
        "lockstep: the plant waits for each tick's setpoints",
    ),
    "timeout": (5.0, "longest wait for a silent node during the run, s"),
    "start_timeout": (30.0, "longest wait for the other nodes at the start, s; not in mode free"),
    "recorder": (False, "true: wait for a recorder before starting"),
    "view": (False, "true: wait for a live view before starting"),
    "endless": (False, "true: until it is stopped, whatever its duration"),
    "join": (False, "true (not in lockstep): start disarmed; in realtime also: replace a node that left"),
}


@dataclass(frozen=True)
class Options:
    """Options of every node (OPTIONS)."""

    mode: str
    timeout: float
    start_timeout: float
    recorder: bool
    view: bool
    join: bool = False
    endless: bool = False

    @property
    def paced(self) -> bool:
        """Whether the plant is paced by the clock."""
        return self.mode != "lockstep"

    @property
    def free(self) -> bool:
        """Whether nodes may come and go: no node waits for another, and the plant may be replaced."""
        return self.mode == "free"

    @property
    def late(self) -> bool:
        """Whether the first message that a node receives may be of any tick."""
        return self.join or self.free

    def ends(self, case: Case) -> bool:
        """Whether a run ends after its duration."""
        return not (self.endless or (self.free and case.run.duration is None))

    def patience(self, tick: int) -> float:
        """Longest wait for an answer to a tick, s; longer for the first ticks, when nodes may still be starting."""
        return max(self.timeout, self.start_timeout) if tick <= FIRST_ANSWERS else self.timeout


def descriptor(description: str, unit: str = "", low: Any = None, high: Any = None, read_only: bool = True) -> Any:
    """ROS parameter descriptor with meaning, unit and range, for `declare`."""
    described = ParameterDescriptor(description=f"{description} [{unit}]" if unit else description, read_only=read_only)
    if low is not None and high is not None:
        described.floating_point_range = [FloatingPointRange(from_value=float(low), to_value=float(high), step=0.0)]
    return described


# Values of parameters that stand for a field of the run that is not given or is no plain value.
SCENARIOS = 0.0
INLINE = ""  # of a field whose content stands in the run itself
DURATION = descriptor("simulated time; 0: the scenario's; in mode free: no end", "s", 0.0, 1e5)


def field_descriptor(field: FieldInfo, read_only: bool = True) -> Any:
    """ROS parameter descriptor of a field of a run or of a link's stage, from its declaration."""
    low = next((m.ge if isinstance(m, Ge) else m.gt for m in field.metadata if isinstance(m, (Ge, Gt))), None)
    high = next((m.le if isinstance(m, Le) else m.lt for m in field.metadata if isinstance(m, (Le, Lt))), None)
    extra = field.json_schema_extra
    unit = str(extra.get("unit", "")) if isinstance(extra, dict) else ""
    return descriptor(field.description or "", unit, low, high, read_only)


def declare(node: Node, name: str, default: Any, wanted: Any) -> Any:
    """Declare a parameter and return its value as plain Python.

    The default gives the type of the parameter and of its range; whole numbers are accepted for floats.
    """
    if type(default) is int and wanted.floating_point_range:
        whole = [int(bound) for limit in wanted.floating_point_range for bound in (limit.from_value, limit.to_value)]
        wanted.integer_range = [IntegerRange(from_value=whole[0], to_value=whole[1], step=1)]
        wanted.floating_point_range = []
    overrides = node._parameter_overrides  # noqa: SLF001 (rclpy has no other way to read them)
    if name in overrides:
        overrides[name] = Parameter(name, value=as_declared(default, overrides[name].value))
    return plain(node.declare_parameter(name, default, wanted).value)


def as_declared(default: Any, value: Any) -> Any:
    """Convert whole numbers to floats where the default is a float or a list of floats."""
    value = plain(value)
    if isinstance(default, float) and type(value) is int:
        return float(value)
    if isinstance(default, (list, array)) and len(default) and isinstance(default[0], float):
        return [float(item) if type(item) is int else item for item in value] if isinstance(value, list) else value
    return value


def accept_whole_numbers(node: Node) -> None:
    """Accept whole numbers for float parameters: `ros2 param set NODE gain 12` sets 12.0."""

    def convert(changed: list[Parameter[Any]]) -> list[Parameter[Any]]:
        return [
            Parameter(parameter.name, value=as_declared(node.get_parameter(parameter.name).value, parameter.value))
            if node.has_parameter(parameter.name) and parameter.value is not None
            else parameter
            for parameter in changed
        ]

    node.add_pre_set_parameters_callback(convert)


def check_declared(node: Node) -> None:
    """Raise `InputError` if a parameter was given that the node does not have."""
    for name in node._parameter_overrides:  # noqa: SLF001 (as in `declare`)
        if not node.has_parameter(name) and not name.startswith("qos_overrides."):
            raise InputError(f"parameter {name}: given; allowed: {', '.join(sorted(node._parameters))}")  # noqa: SLF001


def usage(node: Node, description: str) -> str:
    """Text of `--help`: what the node does, its declared parameters, an example."""
    name = node.get_name()
    lines = [
        f"usage: ros2 run facts_damping {name} [--ros-args -p NAME:=VALUE ...]",
        "",
        description,
        "",
        "parameters:",
    ]
    for parameter in sorted(node._parameters):  # noqa: SLF001 (rclpy lists them by a service only)
        wanted, value = node.describe_parameter(parameter), plain(node.get_parameter(parameter).value)
        ranges = [*wanted.integer_range, *wanted.floating_point_range]
        between = f", {ranges[0].from_value:g} to {ranges[0].to_value:g}" if ranges else ""
        live = "" if wanted.read_only else "; may be changed while it runs"
        lines.append(f"  {parameter} ({value!r}{between}): {wanted.description or 'of ROS 2'}{live}")
    example = f"example: ros2 run facts_damping {name} --ros-args -p run:=two_area_large"
    return "\n".join([*lines, "", example, "more: docs/ros2.md"])


def read_case(node: Node) -> Case:
    """Declare the run's parameters and load the case that they describe; in mode free the default run is at rest."""
    text = "name of a run under config/runs, or path of a YAML file; empty: all defaults"
    mode = node._parameter_overrides.get("mode")  # noqa: SLF001 (as in `declare`)
    free = (OPTIONS["mode"][0] if mode is None else mode.value) == "free"
    run: str = declare(node, "run", FREE_RUN if free else "", descriptor(text))
    text = "changes to the run: key.path=value; empty: none"
    sets = [setting for setting in declare(node, "set", [""], descriptor(text)) if setting]
    case = load_case(run or None, sets)
    changed, fields = [], Run.model_fields
    for name in RUN_FIELDS:
        value = getattr(case.run, name)
        if name == "duration" and value is None:
            value = SCENARIOS
        value = value if isinstance(value, (str, int, float)) else INLINE
        declared = declare(node, name, value, DURATION if name == "duration" else field_descriptor(fields[name]))
        if declared != value:
            changed.append(f"{name}={declared}")
    return load_case(run or None, [*changed, *sets]) if changed else case


def read_options(node: Node, joins: bool = True) -> Options:
    """Declare and read the options of every node; `joins`: whether this kind of node may join a running graph."""
    limits = {"timeout": (0.05, 3600.0), "start_timeout": (0.05, 3600.0)}
    values = {
        name: declare(node, name, default, descriptor(text, "", *limits.get(name, ())))
        for name, (default, text) in OPTIONS.items()
        if joins or name != "join"
    }
    options = Options(**values)
    if options.mode not in MODES:
        raise InputError(f"mode: '{options.mode}' given; allowed: {', '.join(MODES)}")
    if options.join and not options.paced:
        raise InputError("join: true given; allowed: with mode free, realtime")
    return options


def read_stamp(node: Node, options: Options) -> str:
    """Declare and read the parameter `stamp`: simulated or wall time in message headers."""
    stamp: str = declare(node, "stamp", STAMPS[0], descriptor(f"time in message stamps: {', '.join(STAMPS)}"))
    allowed = STAMPS if options.paced else STAMPS[:1]
    if stamp not in allowed:
        raise InputError(f"stamp: '{stamp}' given; allowed with mode {options.mode}: {', '.join(allowed)}")
    return stamp


def plain(value: Any) -> Any:
    """Parameter value as plain Python: rclpy returns lists of numbers as arrays."""
    return value.tolist() if isinstance(value, array) else value


def read_index(node: Node, allowed: Iterable[int], what: str = "controllers") -> int:
    """Declare and read the index of the run's controller (or link) that a node is or serves. Raises `InputError`."""
    indices = list(allowed)
    text = f"index of this node's {what.removesuffix('s')} in the run"
    first = indices[0] if indices else 0
    index = int(declare(node, "index", first, descriptor(text, "", 0, 15)))
    if index not in indices:
        there = ", ".join(map(str, indices)) or f"none: no such {what.removesuffix('s')}"
        raise InputError(f"index: {index} given; allowed: {there}")
    return index
