"""Foreign messages: forged, replayed, of an older version, random bytes, odd values in every field."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from rclpy.serialization import serialize_message
from rosidl_parser.definition import AbstractSequence, Array, BasicType, NamespacedType

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.random import Generator


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
    filled = kind()
    for field, what in zip(kind.get_fields_and_field_types(), kind.SLOT_TYPES, strict=True):
        setattr(filled, field, value(rng, what, field))
    return filled


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


def foreign(
    what: str, kind: Any, genuine: Sequence[bytes], forge: Callable[[int], bytes] | None, tick: int, seed: int
) -> bytes:
    """A foreign message of a kind: `forged`, `replayed`, `older` or `malformed`; empty: there is none.

    `genuine`: messages of its topic that were received; `forge`: see `attacker.forgeries`.
    """
    rng = np.random.default_rng(seed)
    if what == "forged":
        return forge(tick) if forge is not None else serialize_message(message(rng, kind))
    if what == "replayed":
        return genuine[int(rng.integers(len(genuine)))] if genuine else b""
    if what == "older":  # as before its last fields were added
        return serialize_message(message(rng, kind))[: -8 * int(rng.integers(1, 3))]
    return hostile(rng, kind, genuine)
