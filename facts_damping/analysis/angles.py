"""Centre of angle of each area (4.107)."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from facts_damping.analysis.measures import inline_system

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

    from facts_damping.signals import Record

WHOLE = "system"  # the area of machines that name none


def centre_of_angle(angles: NDArray[np.float64], inertias: NDArray[np.float64]) -> NDArray[np.float64]:
    """`sum_k S_k H_k delta_k / sum_k S_k H_k`, rad, (ticks,).

    `angles`: (ticks, machines), rad, of the machines of one area; `inertias`: (machines,), MVA s, rating S times
    inertia constant H. Source: (4.107).
    """
    return np.asarray(angles @ inertias / inertias.sum())


def centres_of_angle(record: Record) -> dict[str, NDArray[np.float64]]:
    """Centre of angle of each area, rad, (ticks,), by the true rotor angles: of no use to a controller.

    Areas, ratings and inertia constants are those of a system inline; without these nothing. Against an infinite bus,
    where there is one. Otherwise against the centre of all machines: after a change of load the whole system runs at
    another frequency, and its angles against synchronous speed would only tell that.
    """
    system = inline_system(record.configuration)
    data: dict[str, Mapping[str, Any]] = {one["name"]: one for one in system.get("machines") or []}
    if not record.machine_names or any(not _complete(data.get(name)) for name in record.machine_names):
        return {}
    angles = np.asarray(record.machines["rotor_angle"])
    inertias = np.array([data[name]["rating"] * data[name]["H"] for name in record.machine_names])
    areas = np.array([data[name].get("area") or WHOLE for name in record.machine_names])
    origin = np.zeros(len(angles)) if system.get("infinite_buses") else centre_of_angle(angles, inertias)
    named = dict.fromkeys(areas.tolist())
    return {area: centre_of_angle(angles[:, areas == area], inertias[areas == area]) - origin for area in named}


def _complete(machine: Mapping[str, Any] | None) -> bool:
    return machine is not None and "rating" in machine and "H" in machine
