"""What a plant consists of for the compiled functions: frozen parameters, state, and arrays to work with."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from facts_damping.compiling import compiled

if TYPE_CHECKING:
    from numpy.typing import NDArray

MACHINE = np.dtype(
    [
        ("ratio", "f8"),  # rating over system base
        ("H", "f8"),  # s
        ("D", "f8"),  # p.u. of the rating
        ("admittance", "c16"),  # 1 / (Ra + j X''), p.u. of the system base
        ("A", "f8", (4, 4)),
        ("B", "f8", (4, 3)),
        ("C", "f8", (2, 4)),
    ]
)


class Plant(NamedTuple):
    """Frozen parameters of a plant with its events: what `advance` and `measure` need.

    The network of stage s, from `stage_start_ns[s]` on, is `network[s]`, complex, shape
    (machines + ports + 2 stations, machines + ports): it maps machine Norton currents and port currents
    to machine voltages, port open-circuit voltages, station voltages and station currents, p.u.
    """

    omega_0: float  # rad/s
    step_ns: int
    machines: NDArray[Any]  # MACHINE, (machines,)
    exciters: NDArray[Any]  # EXCITER, (machines,)
    converters: NDArray[Any]  # SSSC, (ports,): one at most
    stage_start_ns: NDArray[np.int64]  # (stages,), ascending, the first at the start of time
    mechanical_power: NDArray[np.float64]  # (stages, machines), p.u. of the rating
    online: NDArray[np.float64]  # (stages, machines), 1 or 0
    network: NDArray[np.complex128]
    station_machine: NDArray[np.int64]  # (stations,), machine index or -1


class PlantState(NamedTuple):
    """State of a plant: `x` as the kernels lay it out, and of each device the reference and its target, p.u."""

    x: NDArray[np.float64]
    reference: NDArray[np.float64]
    target: NDArray[np.float64]


class Work(NamedTuple):
    """Arrays that the kernels reuse."""

    slopes: NDArray[np.float64]  # (6, states)
    injection: NDArray[np.complex128]  # (machines + ports,)
    emf: NDArray[np.complex128]  # (machines,), subtransient EMF E''d + j E''q in the rotor's frame, p.u.
    rotation: NDArray[np.complex128]  # (machines,), exp(j (delta - pi/2)), from the rotor's frame to the network's
    reference: NDArray[np.float64]  # (devices,)


def workspace(plant: Plant, state: PlantState) -> Work:
    """Arrays of the right size for `plant`."""
    machines, columns = len(plant.machines), plant.network.shape[2]
    return Work(
        np.zeros((6, len(state.x))),
        np.zeros(columns, np.complex128),
        np.zeros(machines, np.complex128),
        np.zeros(machines, np.complex128),
        np.zeros(len(state.reference)),
    )


@compiled
def stage_at(plant: Plant, time_ns: int) -> int:
    """Index of the stage at a time; an event acts from its own instant on."""
    stage = 0
    while stage + 1 < len(plant.stage_start_ns) and plant.stage_start_ns[stage + 1] <= time_ns:
        stage += 1
    return stage
