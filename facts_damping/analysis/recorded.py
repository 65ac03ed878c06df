"""Access to any signal of a record by name."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from facts_damping.analysis.measures import inline_system
from facts_damping.errors import InputError
from facts_damping.signals import CHANNELS

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from facts_damping.signals import Record

# Units of columns that may be analysed, as shown in pictures.
UNITS = {"pu": "p.u.", "rad": "rad", "hz": "Hz", "hz_per_s": "Hz/s", "s": "s", "pu/pu": "p.u./p.u."}


def recorded(record: Record, name: str) -> tuple[NDArray[np.float64], str]:
    """Values of a signal (ticks,), NaN where unknown, and its unit as shown in pictures, such as `p.u.` or `rad`.

    `name`: a signal of the system, as its PMUs measure it, without washout; or a column of `record.arrays` with a
    unit. Angles are unwrapped. Raises InputError for any other name.
    """
    signals = inline_system(record.configuration).get("signals") or {}
    if name in signals:
        channel = signals[name].get("channel", "speed_deviation")
        column, parts = list(CHANNELS).index(channel), signals[name]["weights"].items()
        values = sum(weight * record.frames[:, record.pmus.index(one), column] for one, weight in parts)
        unit = CHANNELS[channel]
    elif record.units.get(name) in UNITS and name != "time_s":
        values, unit = record.arrays[name], record.units[name]
    else:
        columns = [column for column, unit in record.units.items() if unit in UNITS and column != "time_s"]
        raise InputError(
            f"signal: '{name}' given; allowed: {', '.join([*sorted(signals), *columns[:1], *columns[-1:]])}, "
            "or any other column of `facts-damping export` that has a unit"
        )
    return (_unwrapped(values) if unit == "rad" else values), UNITS[unit]


def _unwrapped(angle: NDArray[np.float64]) -> NDArray[np.float64]:
    """An unwrapped angle, rad."""
    known = np.isfinite(angle)
    angle = angle.copy()
    angle[known] = np.unwrap(angle[known])
    return angle
