"""What a plant consists of for the compiled functions: frozen parameters, state, and arrays to work with."""

from __future__ import annotations

from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray

from facts_damping.compiling import compiled
from facts_damping.compiling.structs import (
    Array,
    Bool1,
    Complex1,
    Complex2,
    Complex3,
    Float1,
    Float2,
    Float3,
    Int1,
    Struct,
)
from facts_damping.plant.converters.dead_time import UNDER_WAY
from facts_damping.plant.converters.devices import DEVICE
from facts_damping.plant.converters.site import PORT
from facts_damping.plant.grid.load import LOAD
from facts_damping.plant.machines.blocks import BLOCK, CONTROLS, SENSED
from facts_damping.plant.machines.excitation import EXCITER
from facts_damping.plant.machines.governor import GOVERNOR
from facts_damping.plant.machines.machine import MACHINE
from facts_damping.plant.machines.stabiliser import STABILISER
from facts_damping.plant.watchdog import WATCH


class Plant(Struct):
    """Frozen parameters of a plant with its events: what `advance` and `measure` need.

    The network of stage s, from `stage_start_ns[s]` on, is `network[s]`, complex. It maps its inputs (machine
    Norton currents, voltages of infinite buses, sources at the ports) to its outputs (machine voltages,
    responses of the ports, station voltages, station currents), p.u. A port in parallel injects a current and
    sees its bus voltage; one in series holds a voltage drop and sees its current. Shape
    (machines + ports + 2 stations, machines + infinite buses + ports).
    """

    omega_0: float  # rad/s
    step_ns: int
    machines: Annotated[NDArray[Any], Array(MACHINE, 1)]  # MACHINE, (machines,), as the controls
    exciters: Annotated[NDArray[Any], Array(EXCITER, 1)]  # EXCITER
    stabilisers: Annotated[NDArray[Any], Array(STABILISER, 1)]  # STABILISER
    governors: Annotated[NDArray[Any], Array(GOVERNOR, 1)]  # GOVERNOR
    blocks: Annotated[NDArray[Any], Array(BLOCK, 1)]  # blocks.BLOCK, of all controls that are tables of blocks
    controls: Annotated[NDArray[Any], Array(CONTROLS, 1)]  # blocks.CONTROLS, (machines,): which of them are whose
    loads: Annotated[NDArray[Any], Array(LOAD, 1)]  # LOAD, those that are not impedances
    ports: Annotated[NDArray[Any], Array(PORT, 1)]  # PORT
    placed: Annotated[
        NDArray[Any], Array(DEVICE, 1)
    ]  # devices.DEVICE: those of the run in its order, then those in service that nobody commands
    devices: Annotated[NDArray[Any], Array(DEVICE, 1)]  # the first of them, those of the run
    infinite: Complex1  # (infinite buses,), p.u.
    stage_start_ns: Int1  # (stages,), ascending, the first at the start of time
    mechanical_power: Float2  # (stages, machines), p.u. of the rating
    online: Float2  # (stages, machines), 1 or 0
    load_scale: Float2  # (stages, loads)
    load_noise: Float3  # (points, loads, 2), relative, of P and Q (load_noise.py); no points: none
    network: Complex3
    station_machine: Int1  # (stations,), machine index or -1


class PlantState(Struct):
    """State of a plant: `x` as the kernels lay it out, and of each device the reference and its target, p.u.

    `watch`: what their watchdogs know; `under_way`: setpoints in their dead times. `source` holds what the ports give
    (p.u.) as last solved: the next solution starts from there.
    """

    x: Float1
    reference: Float1
    target: Float1
    watch: Annotated[NDArray[Any], Array(WATCH, 1)]  # watchdog.WATCH
    source: Complex1
    under_way: Annotated[NDArray[Any], Array(UNDER_WAY, 2)]  # dead_time.UNDER_WAY, (devices, room)
    waiting: Int1  # (devices,), how many of them are


class Work(Struct):
    """Arrays that the kernels reuse."""

    slopes: Float2  # (6, states)
    reference: Float1  # (devices,)
    inputs: Complex1  # of the network
    emf: Complex1  # (machines,), Ed + j Eq behind the stator's reactances, in the rotor's frame, p.u.
    rotation: Complex1  # (machines,), exp(j (delta - pi/2)), from the rotor's frame to the network's
    given: Complex1  # (ports,), response to all inputs but the ports' own
    response: Complex1  # (ports,)
    blocked: Bool1  # (ports,)
    low: Bool1  # (ports,), loads that are taken as what they are below V_min
    slope: Float3  # (ports, 2, 2), of the source by the response
    matrix: Float2  # (2 ports, 2 ports)
    change: Float1  # (2 ports,)
    step: Float1  # (2 ports,)
    source: Complex1  # (ports,), of a solution beside the state's own
    phasors: Complex2  # (stations, 2), voltages and currents of the stations, p.u.
    noise: Float2  # (loads, 2), relative, of P and Q, as it is
    noise_start: Float2  # the same as it was at the start of this part of its grid
    noise_slope: Float2  # 1/s
    signals: Float1  # of the blocks of one control


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
def interval_at(plant: Plant, time_ns: int) -> int:
    """Index of the stage at a time; an event acts from its own instant on."""
    stage = 0
    while stage + 1 < len(plant.stage_start_ns) and plant.stage_start_ns[stage + 1] <= time_ns:
        stage += 1
    return stage


@compiled
def begin_interval(plant: Plant, state: PlantState, time_ns: int) -> int:
    """Index of the stage at a time; where it begins, the solution before tells nothing of the network to come."""
    stage = interval_at(plant, time_ns)
    if plant.stage_start_ns[stage] == time_ns:
        state.source[:] = 0.0
    return stage
