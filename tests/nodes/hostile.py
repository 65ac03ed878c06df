"""Foreign messages: forged ones that would have an effect, random bytes, odd values in every field."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from facts_damping_msgs.msg import DeviceSetpoint, DeviceSetpoints, PmuDataFrame
from rclpy.serialization import serialize_message
from rosidl_parser.definition import AbstractSequence, Array, BasicType, NamespacedType

from facts_damping.nodes.transport.tables import FramesMessage, SetpointsMessage, start_of
from facts_damping.signals import DELIVERY, NANOSECONDS, SETPOINT

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.random import Generator

    from facts_damping.case.model import Case

CONTROLLER, IDENTIFIER = "controller_0_HBsWC", "identifier_0_ANFGuMoI"  # of these runs
SETS = ["scenario=large", "controllers.0.name=HBsWC", "controllers.0.scheme=indirect"]
LATEST = {
    "pmu/frames": {"wan_link"},
    "pmu/delivered": {CONTROLLER, IDENTIFIER},
    f"{IDENTIFIER}/estimate": {CONTROLLER},
    f"{CONTROLLER}/setpoints": {"wan_link", IDENTIFIER},
    "setpoints/delivered": {"plant_sim"},
}  # by topic: who listens beside the recorder
FAR = 10**9  # ticks
IN_2038 = 2_145_916_800 * NANOSECONDS

FLOATS = (0.0, -0.0, 0.05, -0.1, 1e308, float("nan"), float("inf"), -float("inf"), 5e-324)
NAMES = ("", "G1", "sssc", "statcom", "wan_link", "controller_0_LLC", "B8W", "\n", "x" * 300, "ünï\t", "\x00")
RAW = 3  # one in so many is no message at all
MAXIMUM = 12  # entries of a sequence


def value(rng: Generator, kind: Any, field: str) -> Any:
    """An odd value for a field of a type."""
    if isinstance(kind, BasicType):
        if kind.typename == "boolean":
            return bool(rng.integers(2))
        if kind.typename == "octet":
            return bytes([int(rng.integers(256))])
        if kind.typename in ("float", "double"):
            return float(FLOATS[rng.integers(len(FLOATS))]) if rng.random() < 0.7 else float(rng.normal())
        signed = not kind.typename.startswith("u")
        bits = int("".join(filter(str.isdigit, kind.typename)) or "8")
        top = 2 ** (bits - signed) - 1
        extremes = (0, 1, top, -top - 1 if signed else top - 1, min(10**9, top))
        return extremes[rng.integers(len(extremes))] if rng.random() < 0.5 else int(rng.integers(0, min(2000, top)))
    if isinstance(kind, NamespacedType):
        return message(rng, _class(kind))
    if isinstance(kind, Array):
        return [value(rng, kind.value_type, field) for _ in range(kind.size)]
    if isinstance(kind, AbstractSequence):
        return [value(rng, kind.value_type, field) for _ in range(rng.integers(MAXIMUM))]
    return str(NAMES[rng.integers(len(NAMES))])


def _class(kind: NamespacedType) -> Any:
    module = __import__(".".join(kind.namespaces), fromlist=[kind.name])
    return getattr(module, kind.name)


def message(rng: Generator, kind: Any) -> Any:
    """A message with odd values in every field."""
    made = kind()
    for field, what in zip(kind.get_fields_and_field_types(), kind.SLOT_TYPES, strict=True):
        setattr(made, field, value(rng, what, field))
    return made


def hostile(rng: Generator, kind: Any, genuine: Sequence[bytes] = ()) -> bytes:
    """Bytes to be sent as a message of a kind: an odd message, a mutated odd or genuine one, or random bytes.

    Never empty: the middleware would deliver neither that nor later messages of its publisher.
    """
    if rng.integers(RAW) == 0:
        return rng.bytes(int(rng.integers(1, 400)))
    data = bytearray(serialize_message(message(rng, kind)))
    if genuine and rng.random() < 0.5:
        data = bytearray(genuine[int(rng.integers(len(genuine)))])
    for _ in range(rng.integers(0, 4)):
        at = int(rng.integers(len(data)))
        data[at : at + 4] = rng.bytes(4) if rng.random() < 0.5 else b"\xff\xff\xff\xff"[: len(data) - at]
    end = int(rng.integers(1, len(data))) if rng.random() < 0.2 else len(data)
    return bytes(data[:end]) + rng.bytes(int(rng.integers(0, 16)) if rng.random() < 0.2 else 0)


def forgeries(case: Case) -> list[tuple[str, Callable[[int], bytes]]]:
    """Messages that would have an effect: topic, and function of the tick that returns the bytes."""
    frames, setpoints = FramesMessage(case), SetpointsMessage(case)

    def start(tick: int) -> int:
        return start_of(tick, case.run.frame_rate)

    def measured(at: int) -> Any:
        rows = np.zeros(1, DELIVERY)
        rows["measured_ns"] = rows["arrival_ns"] = at
        rows["values"] = 0.02
        return rows

    def setpoint(tick: int) -> Any:
        rows = np.zeros(1, SETPOINT)
        rows["measured_ns"] = rows["issued_ns"] = rows["effective_ns"] = start(tick)
        rows["value"] = 0.1 if tick % 2 else -0.1
        return rows

    unknown = DeviceSetpoints(setpoints=[DeviceSetpoint(device="of nobody", controller=CONTROLLER, value_pu=0.1)])
    none = np.zeros(0, SETPOINT)
    return [
        ("setpoints/delivered", lambda _: setpoints.fill(FAR, start(FAR), none, "")),
        ("setpoints/delivered", lambda tick: setpoints.fill(tick, start(tick), setpoint(tick), "")),
        ("setpoints/delivered", lambda _: serialize_message(unknown)),
        (f"{CONTROLLER}/setpoints", lambda tick: setpoints.fill(tick, start(tick), setpoint(tick), CONTROLLER)),
        ("pmu/frames", lambda _: frames.fill(FAR, start(FAR), measured(0), 1)),
        ("pmu/frames", lambda _: serialize_message(PmuDataFrame(tick=2**64 - 1))),
        ("pmu/delivered", lambda tick: frames.fill(tick, IN_2038, measured(IN_2038), 1)),
        ("pmu/delivered", lambda tick: np.random.default_rng(tick).bytes(60)),
    ]
