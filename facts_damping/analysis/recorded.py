"""Any signal of a record by its name."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from facts_damping.errors import check_known
from facts_damping.signals import CHANNELS, DEVICE_TRUTH, MACHINE_TRUTH

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from facts_damping.signals import Record

ANGLES = ("voltage_angle", "rotor_angle")
NO_SIGNALS = ("blocked",)


def recorded(record: Record, name: str) -> tuple[NDArray[np.float64], str]:
    """Values of a signal (ticks,), NaN where it is not known, and its unit, `p.u.` or `rad`.

    `name`: a signal of the system, as its stations measure it, without washout; STATION.CHANNEL as measured, or the
    truth DEVICE.FIELD or MACHINE.FIELD, by the names of `facts_damping.signals`. Angles are unwrapped. Raises
    InputError for any other.
    """
    system = record.configuration.get("system")
    signals = (system.get("signals") or {}) if isinstance(system, dict) else {}
    owner, dot, channel = name.partition(".")
    if dot:
        fields = _fields(record)
        check_known("signal", owner, dict.fromkeys(one for one, _ in fields))
        check_known(f"signal {owner}", channel, [field for one, field in fields if one == owner])
        values = fields[owner, channel]
    else:
        check_known("signal", name, [*signals, "STATION.CHANNEL", "DEVICE.FIELD", "MACHINE.FIELD"])
        channel = signals[name].get("channel", "speed_deviation")
        column = list(CHANNELS).index(channel)
        parts = signals[name]["weights"].items()
        values = sum(weight * record.frames[:, record.stations.index(one), column] for one, weight in parts)
    return (_unwrapped(values), "rad") if channel in ANGLES else (values, "p.u.")


def _fields(record: Record) -> dict[tuple[str, str], NDArray[Any]]:
    """What is recorded of each device, machine and station: {(owner, field): (ticks,)}; what is measured goes first."""
    found: dict[tuple[str, str], NDArray[Any]] = {}
    for names, table, dtype in (
        (record.device_names, record.devices, DEVICE_TRUTH),
        (record.machine_names, record.machines, MACHINE_TRUTH),
    ):
        fields = [field for field in dtype.names or () if field not in NO_SIGNALS]
        found |= {(name, field): table[field][:, i] for i, name in enumerate(names) for field in fields}
    measured = [(name, channel) for name in record.stations for channel in CHANNELS]
    columns = record.frames.reshape(len(record.frames), len(measured)).T
    return found | dict(zip(measured, columns, strict=True))


def _unwrapped(angle: NDArray[np.float64]) -> NDArray[np.float64]:
    """An angle without jumps by whole turns, rad."""
    known = np.isfinite(angle)
    angle = angle.copy()
    angle[known] = np.unwrap(angle[known])
    return angle
