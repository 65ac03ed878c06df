"""Quantities over time: what identifiers and networks learn, and the centre of angle of each area (4.107)."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from facts_damping.analysis.measures import inline_system
from facts_damping.record import group_by

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

    from facts_damping.record import Record

WHOLE = "system"  # area of machines without one


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
    keys = ("controller", "identifier", "output", "group")
    rates = {
        (_controller(record, c), bool(identifier), output, group): _history(record, rows, "rate")
        for (c, identifier, output, group), rows in group_by(record.learning, *keys)
    }
    return {key: rate for key, rate in rates.items() if not key[3] or not _alike(rate, rates.get((*key[:3], 0)))}


def _history(record: Record, rows: NDArray[Any], field: str) -> History:
    """A field of rows over the times of their ticks, including ticks that the record lacks."""
    rate = record.configuration.get("frame_rate") or 1 / np.median(np.diff(record.time_s))
    return History(rows["tick"] / rate, np.asarray(rows[field]))


def _controller(record: Record, index: int) -> str:
    """Name of a controller; its index if the record does not have it."""
    names = record.controller_names
    return names[index] if index < len(names) else f"controller_{index}"


def _alike(history: History, other: History | None) -> bool:
    return other is not None and np.array_equal(history.values, other.values, equal_nan=True)


def centre_of_angle(angles: NDArray[np.float64], inertias: NDArray[np.float64]) -> NDArray[np.float64]:
    """`sum_k S_k H_k delta_k / sum_k S_k H_k`, rad, (ticks,).

    `angles`: (ticks, machines), rad, of the machines of one area; `inertias`: (machines,), MVA s, rating S times
    inertia constant H. Source: (4.107).
    """
    return np.asarray(angles @ inertias / inertias.sum())


def centres_of_angle(record: Record) -> dict[str, NDArray[np.float64]]:
    """Centre of angle of each area from the true rotor angles, which controllers do not have, rad, (ticks,).

    Areas, ratings and inertia constants come from an inline system; empty without one. The reference is an infinite bus
    if there is one, else the centre of all machines: after a change of load the system frequency changes, and all
    angles against synchronous speed would drift.
    """
    areas = _areas(record)
    if not areas:
        return {}
    angles, origin = np.asarray(record.machines["rotor_angle"]), np.zeros(len(record.machines))
    if not inline_system(record.configuration).get("infinite_buses"):
        every, inertias = (np.concatenate(parts) for parts in zip(*areas.values(), strict=True))
        origin = centre_of_angle(angles[:, every], inertias)
    return {area: centre_of_angle(angles[:, place], inertias) - origin for area, (place, inertias) in areas.items()}


def mean_speeds(record: Record) -> dict[str, NDArray[np.float64]]:
    """Mean speed deviation of each area, weighted by inertia, p.u., (ticks,): the rate of its centre of angle."""
    speeds = np.asarray(record.machines["speed_deviation"])
    return {area: centre_of_angle(speeds[:, place], inertias) for area, (place, inertias) in _areas(record).items()}


def _areas(record: Record) -> dict[str, tuple[NDArray[np.int64], NDArray[np.float64]]]:
    """By area: indices of its machines in the record, and their inertias; empty if any is unknown."""
    system = inline_system(record.configuration)
    known: dict[str, Mapping[str, Any]] = {row["name"]: row for row in system.get("machines") or []}
    rows = [known.get(name, {}) for name in record.machine_names]
    if not rows or any("rating" not in row or "H" not in row for row in rows):
        return {}
    inertias = np.array([row["rating"] * row["H"] for row in rows])
    areas = np.array([row.get("area") or WHOLE for row in rows])
    places = {area: np.flatnonzero(areas == area) for area in dict.fromkeys(areas.tolist())}
    return {area: (place, inertias[place]) for area, place in places.items()}
