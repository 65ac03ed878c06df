"""Fields that are read from messages, and the check that a recording's schema has them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from rosbags.interfaces import Nodetype

from facts_damping.errors import RecordingError
from facts_damping.signals import CHANNELS, DEVICE_TRUTH, FLAGS, MACHINE_TRUTH, REFUSED, truth_field

if TYPE_CHECKING:
    from collections.abc import Mapping

# Fields of PmuFrame, MachineState and DeviceState in the order of the arrays' columns.
# A field's name is the column's name and its unit.
FRAME_FIELDS = [f"{name}_{unit}" for name, unit in CHANNELS.items()]
MACHINE_FIELDS = [truth_field(name) for name in MACHINE_TRUTH.names or ()]
DEVICE_FIELDS = [truth_field(name) for name in DEVICE_TRUTH.names or ()]

OURS = "facts_damping_msgs/msg/"
TIME, HEADER = "builtin_interfaces/msg/Time", "std_msgs/msg/Header"
_HEAD = {"header": HEADER, "tick": "uint64"}

# Fields that are read, by message type, each with its type as in the definition. Other fields are allowed.
FIELDS: dict[str, dict[str, str]] = {
    TIME: {"sec": "int32", "nanosec": "uint32"},
    HEADER: {"stamp": TIME},
    f"{OURS}PmuDataFrame": {"tick": "uint64", "frames": f"{OURS}PmuFrame[]"},
    f"{OURS}PmuFrame": {"header": HEADER, "pmu": "string", "arrival": TIME, "status": "uint16"}
    | dict.fromkeys(FRAME_FIELDS, "float64"),
    f"{OURS}DeviceSetpoints": {"tick": "uint64", "controller": "string", "setpoints": f"{OURS}DeviceSetpoint[]"},
    f"{OURS}DeviceSetpoint": {"header": HEADER, "device": "string", "controller": "string"}
    | {"issued": TIME, "effective": TIME, "value_pu": "float64"},
    f"{OURS}JacobianEstimate": _HEAD
    | {"identifier": "string", "input_names": "string[]", "parameter_groups": "string[]", "learning_rates": "float64[]"}
    | dict.fromkeys(("jacobian", "prediction", "error", "change"), "float64[]")
    | dict.fromkeys(("ahead", "lyapunov", "lyapunov_fall"), "float64"),
    f"{OURS}ControllerState": {"tick": "uint64", "controller": "string"}
    | {"parameter_groups": "string[]", "learning_rates": "float64[]"}
    | dict.fromkeys(("lyapunov", "lyapunov_fall"), "float64"),
    f"{OURS}SupervisorState": _HEAD
    | dict.fromkeys(("controller", "state", "cause", "refused"), "string")
    | {"monitors": "string[]", "values": "float64[]"}
    | dict.fromkeys(("fraction", "probe_gain", "probe_phase_rad", "probe_coherence"), "float64")
    | dict.fromkeys(("added_damping_per_s", "phase_margin_rad", "gain_margin"), "float64"),
    f"{OURS}RunState": {"state": "uint8", "reason": "string"},
    f"{OURS}PlantState": _HEAD
    | {"in_synchronism": "bool", "machines": f"{OURS}MachineState[]", "devices": f"{OURS}DeviceState[]"},
    f"{OURS}MachineState": {"machine": "string"} | dict.fromkeys(MACHINE_FIELDS, "float64"),
    f"{OURS}DeviceState": {"device": "string"}
    | dict.fromkeys(DEVICE_FIELDS, "float64")
    | dict.fromkeys(FLAGS, "bool")
    | dict.fromkeys(REFUSED, "uint64"),
    f"{OURS}GridEvent": {"header": HEADER, "kind": "string", "element": "string"}
    | dict.fromkeys(("value", "location"), "float64"),
    f"{OURS}RefusedMessages": {"node": "string", "refused": f"{OURS}RefusedCount[]"},
    f"{OURS}RunChange": {"tick": "uint64", "index": "uint32"}
    | dict.fromkeys(("node", "role", "kind", "name", "value"), "string"),
    "diagnostic_msgs/msg/DiagnosticArray": {"status": "diagnostic_msgs/msg/DiagnosticStatus[]"},
    "diagnostic_msgs/msg/DiagnosticStatus": {"name": "string", "values": "diagnostic_msgs/msg/KeyValue[]"},
    "diagnostic_msgs/msg/KeyValue": {"key": "string", "value": "string"},
    f"{OURS}RefusedCount": dict.fromkeys(("topic", "cause", "source"), "string") | {"count": "uint64"},
}


def check_fields(message_type: str, definitions: Mapping[str, Any]) -> None:
    """Raise `RecordingError` if the schema of a type lacks a field that is read or has another type for it.

    `definitions`: types that the schema defines, as `rosbags` gives them. Types must be identical, as ROS 2 itself
    requires: the meaning of a number of another type is unknown.
    """
    for owner in (type_name for type_name in FIELDS if type_name in definitions):
        types = {name: written(kind) for name, kind in definitions[owner][1]}
        for name, allowed in FIELDS[owner].items():
            type_text = types.get(name, "no such field")
            if type_text != allowed:
                raise RecordingError(f"schema of {message_type}: {owner}.{name}: {type_text} given; allowed: {allowed}")


def written(kind: Any) -> str:
    """A field's type as in a definition: `float64`, `string<=5`, `package/msg/Type[]`, `bool[3]`."""
    node, what = kind
    if node == Nodetype.NAME:
        return str(what)
    base, count = what
    if node == Nodetype.BASE:
        return f"{base}<={count}" if count else str(base)
    bound = "<=" if node == Nodetype.SEQUENCE and count else ""
    return f"{written(base)}[{bound}{count or ''}]"
