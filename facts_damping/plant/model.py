"""What a plant consists of for the compiled functions: frozen parameters, state, and arrays to work with."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from facts_damping.compiling import compiled
from facts_damping.plant.blocks import SENSED

if TYPE_CHECKING:
    from numpy.typing import NDArray

# Kinds of ports: places where something beside the linear network acts.
SALIENT, LOAD, DEVICE, OTHER_END = 0, 1, 2, 3  # the last: of a device at a second bus

# A port: its kind, the row of its table (machines, loads, devices), and the responses below and above which it is
# blocked.
PORT = np.dtype([("kind", "i8"), ("row", "i8"), ("least", "f8"), ("most", "f8")])


class Site(NamedTuple):
    """Where a device stands as the power flow leaves it."""

    offset: int  # of its states in the plant's
    omega_0: float  # rad/s
    size: float  # p.u., of what its port sees: in series its current, in parallel its bus voltage
    other: float = math.nan  # p.u., of its second bus
    base_power: float = math.nan  # MVA


class Start(NamedTuple):
    """A device at rest: the row of its kind's table, its states, and between which responses it is not blocked."""

    row: tuple[Any, ...]
    states: list[float]
    least: float  # p.u.; 0: never for too small a response
    most: float = math.inf  # p.u.


class Plant(NamedTuple):
    """Frozen parameters of a plant with its events: what `advance` and `measure` need.

    The network of stage s, from `stage_start_ns[s]` on, is `network[s]`, complex. It maps its inputs (machine
    Norton currents, voltages of infinite buses, sources at the ports) to its outputs (machine voltages,
    responses of the ports, station voltages, station currents), p.u. A port in parallel injects a current and
    sees its bus voltage; one in series holds a voltage drop and sees its current. Shape
    (machines + ports + 2 stations, machines + infinite buses + ports).
    """

    omega_0: float  # rad/s
    step_ns: int
    machines: NDArray[Any]  # MACHINE, (machines,), as the controls
    exciters: NDArray[Any]  # EXCITER
    stabilisers: NDArray[Any]  # STABILISER
    governors: NDArray[Any]  # GOVERNOR
    blocks: NDArray[Any]  # blocks.BLOCK, of all controls that are tables of blocks
    controls: NDArray[Any]  # blocks.CONTROLS, (machines,): which of them are whose
    loads: NDArray[Any]  # LOAD, those that are not impedances
    ports: NDArray[Any]  # PORT
    placed: NDArray[Any]  # devices.DEVICE: those of the run in its order, then those in service that nobody commands
    devices: NDArray[Any]  # the first of them, those of the run
    infinite: NDArray[np.complex128]  # (infinite buses,), p.u.
    stage_start_ns: NDArray[np.int64]  # (stages,), ascending, the first at the start of time
    mechanical_power: NDArray[np.float64]  # (stages, machines), p.u. of the rating
    online: NDArray[np.float64]  # (stages, machines), 1 or 0
    load_scale: NDArray[np.float64]  # (stages, loads)
    load_noise: NDArray[np.float64]  # (points, loads, 2), relative, of P and Q (load_noise.py); no points: none
    network: NDArray[np.complex128]
    station_machine: NDArray[np.int64]  # (stations,), machine index or -1


class PlantState(NamedTuple):
    """State of a plant: `x` as the kernels lay it out, and of each device the reference and its target, p.u.

    `watch`: what their watchdogs know; `under_way`: setpoints in their dead times. `source` holds what the ports give
    (p.u.) as last solved: the next solution starts from there.
    """

    x: NDArray[np.float64]
    reference: NDArray[np.float64]
    target: NDArray[np.float64]
    watch: NDArray[Any]  # watchdog.WATCH
    source: NDArray[np.complex128]
    under_way: NDArray[Any]  # dead_time.UNDER_WAY, (devices, room)
    waiting: NDArray[np.int64]  # (devices,), how many of them are


class Work(NamedTuple):
    """Arrays that the kernels reuse."""

    slopes: NDArray[np.float64]  # (6, states)
    reference: NDArray[np.float64]  # (devices,)
    inputs: NDArray[np.complex128]  # of the network
    emf: NDArray[np.complex128]  # (machines,), Ed + j Eq behind the stator's reactances, in the rotor's frame, p.u.
    rotation: NDArray[np.complex128]  # (machines,), exp(j (delta - pi/2)), from the rotor's frame to the network's
    given: NDArray[np.complex128]  # (ports,), response to all inputs but the ports' own
    response: NDArray[np.complex128]  # (ports,)
    blocked: NDArray[np.bool_]  # (ports,)
    low: NDArray[np.bool_]  # (ports,), loads that are taken as what they are below V_min
    slope: NDArray[np.float64]  # (ports, 2, 2), of the source by the response
    matrix: NDArray[np.float64]  # (2 ports, 2 ports)
    change: NDArray[np.float64]  # (2 ports,)
    step: NDArray[np.float64]  # (2 ports,)
    source: NDArray[np.complex128]  # (ports,), of a solution beside the state's own
    phasors: NDArray[np.complex128]  # (stations, 2), voltages and currents of the stations, p.u.
    noise: NDArray[np.float64]  # (loads, 2), relative, of P and Q, as it is
    noise_start: NDArray[np.float64]  # the same as it was at the start of this part of its grid
    noise_slope: NDArray[np.float64]  # 1/s
    signals: NDArray[np.float64]  # of the blocks of one control


def workspace(plant: Plant, state: PlantState) -> Work:
    """Arrays of the right size for `plant`."""
    machines, ports = len(plant.machines), len(plant.ports)
    return Work(
        np.zeros((6, len(state.x))),
        np.zeros(len(state.reference)),
        np.zeros(plant.network.shape[2], np.complex128),
        np.zeros(machines, np.complex128),
        np.zeros(machines, np.complex128),
        np.zeros(ports, np.complex128),
        np.zeros(ports, np.complex128),
        np.zeros(ports, np.bool_),
        np.zeros(ports, np.bool_),
        np.zeros((ports, 2, 2)),
        np.zeros((2 * ports, 2 * ports)),
        np.zeros(2 * ports),
        np.zeros(2 * ports),
        np.zeros(ports, np.complex128),
        np.zeros((len(plant.station_machine), 2), np.complex128),
        np.zeros((len(plant.loads), 2)),
        np.zeros((len(plant.loads), 2)),
        np.zeros((len(plant.loads), 2)),
        np.zeros(len(SENSED) + len(plant.blocks)),
    )


def copy(state: PlantState) -> PlantState:
    """A state of its own with the same content."""
    return PlantState(*(array.copy() for array in state))


@compiled
def stage_at(plant: Plant, time_ns: int) -> int:
    """Index of the stage at a time; an event acts from its own instant on."""
    stage = 0
    while stage + 1 < len(plant.stage_start_ns) and plant.stage_start_ns[stage + 1] <= time_ns:
        stage += 1
    return stage


@compiled
def begin_stage(plant: Plant, state: PlantState, time_ns: int) -> int:
    """Index of the stage at a time; where it begins, the solution before tells nothing of the network to come."""
    stage = stage_at(plant, time_ns)
    if plant.stage_start_ns[stage] == time_ns:
        state.source[:] = 0.0
    return stage
