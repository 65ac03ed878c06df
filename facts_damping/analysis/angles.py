"""Centre of angle of each area (4.107)."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from facts_damping.analysis.measures import inline_system

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

    from facts_damping.signals import Record

WHOLE = "system"  # area of machines without one


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
    return {area: centre_of_angle(angles[:, own], inertias) - origin for area, (own, inertias) in areas.items()}


def mean_speeds(record: Record) -> dict[str, NDArray[np.float64]]:
    """Mean speed deviation of each area, weighted by inertia, p.u., (ticks,): the rate of its centre of angle."""
    speeds = np.asarray(record.machines["speed_deviation"])
    return {area: centre_of_angle(speeds[:, own], inertias) for area, (own, inertias) in _areas(record).items()}


def _areas(record: Record) -> dict[str, tuple[NDArray[np.int64], NDArray[np.float64]]]:
    """By area: indices of its machines in the record, and their inertias; empty if any is unknown."""
    system = inline_system(record.configuration)
    data: dict[str, Mapping[str, Any]] = {one["name"]: one for one in system.get("machines") or []}
    if not record.machine_names or any(not _complete(data.get(name)) for name in record.machine_names):
        return {}
    inertias = np.array([data[name]["rating"] * data[name]["H"] for name in record.machine_names])
    areas = np.array([data[name].get("area") or WHOLE for name in record.machine_names])
    found = {area: np.flatnonzero(areas == area) for area in dict.fromkeys(areas.tolist())}
    return {area: (own, inertias[own]) for area, own in found.items()}


def _complete(machine: Mapping[str, Any] | None) -> bool:
    return machine is not None and "rating" in machine and "H" in machine
