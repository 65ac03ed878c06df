"""Learning over time: Jacobians and learning rates, one curve each."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from facts_damping.signals import group_by

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from facts_damping.signals import Record


class History(NamedTuple):
    """A quantity over time: times of the ticks (s) and values, both (n,)."""

    time_s: NDArray[np.float64]
    values: NDArray[np.float64]


def jacobian_histories(record: Record) -> dict[tuple[str, int, str], History]:
    """Identifiers' estimates of the plant's Jacobian, p.u. of the signal per p.u. of setpoint, one frame ahead.

    Keys: controller, index of its signal, device. Source: (5.3) on; the derivative that (5.1) passes to the controller.
    """
    return {
        (_controller(record, c), s, record.device_names[d]): _history(record, rows, "jacobian")
        for (c, s, d), rows in group_by(record.estimates, "controller", "signal", "device")
    }


def learning_rate_histories(record: Record) -> dict[tuple[str, bool, int, int], History]:
    """Learning rates of all networks, no unit.

    Keys: controller, whether the network is its identifier's, index of the output, index of the parameter group. If all
    groups have the same rate there is a single history, of group 0. Source: (4.39), (5.20) on.
    """
    found = {}
    for (c, identifier, output, group), rows in group_by(
        record.learning, "controller", "identifier", "output", "group"
    ):
        found[_controller(record, c), bool(identifier), output, group] = _history(record, rows, "rate")
    return {key: one for key, one in found.items() if not key[3] or not _alike(one, found.get((*key[:3], 0)))}


def _history(record: Record, rows: NDArray[Any], field: str) -> History:
    """A field of rows over the times of their ticks, including ticks that the record lacks."""
    rate = record.configuration.get("frame_rate") or 1 / np.median(np.diff(record.time_s))
    return History(rows["tick"] / rate, np.asarray(rows[field]))


def _controller(record: Record, index: int) -> str:
    """Name of a controller; its index if the record does not have it."""
    names = record.controller_names
    return names[index] if index < len(names) else f"controller_{index}"


def _alike(one: History, other: History | None) -> bool:
    return other is not None and np.array_equal(one.values, other.values, equal_nan=True)
