"""Data of a plant for the compiled functions: frozen parameters, state, and work arrays."""

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
    Int2,
    Struct,
    Table,
)
from facts_damping.plant.converters.dispatch import DEVICE
from facts_damping.plant.converters.site import PORT
from facts_damping.plant.events import OSCILLATION
from facts_damping.plant.grid.load import LOAD
from facts_damping.plant.grid.sparse_network import SparseNetwork
from facts_damping.plant.inverters.inverter import AT, INVERTER, KNOWN
from facts_damping.plant.machines.blocks import BLOCK, CONTROLS, SENSED
from facts_damping.plant.machines.excitation import EXCITER
from facts_damping.plant.machines.governor import GOVERNOR
from facts_damping.plant.machines.machine import MACHINE
from facts_damping.plant.machines.stabiliser import STABILISER
from facts_damping.plant.watchdog import UNDER_WAY, WATCH


class Plant(Struct):
    """Frozen parameters of a plant with its events, as needed by `advance` and `measure`.

    `network[s]`, complex, is the network of interval s, valid from `interval_start_ns[s]`. It maps its inputs (Norton
    currents of machines, voltages of infinite buses, sources at the ports) to its outputs (machine voltages, responses
    of the ports, voltages and currents of the PMUs, those that inverters' plant controls see), p.u. A parallel port
    injects a current and its response is the bus voltage; a series port injects a voltage drop and its response is the
    current. Shape (machines + ports + 2 PMUs + 2 meters, machines + infinite buses + ports). Of a large grid
    `sparse_networks` has it instead.
    """

    omega_0: float  # rad/s
    step_ns: int
    machines: Annotated[NDArray[Any], Array(MACHINE, 1)]  # MACHINE, (machines,), same shape as the controls
    exciters: Annotated[NDArray[Any], Array(EXCITER, 1)]  # EXCITER
    stabilisers: Annotated[NDArray[Any], Array(STABILISER, 1)]  # STABILISER
    governors: Annotated[NDArray[Any], Array(GOVERNOR, 1)]  # GOVERNOR
    blocks: Annotated[NDArray[Any], Array(BLOCK, 1)]  # blocks.BLOCK, of all block controls
    controls: Annotated[NDArray[Any], Array(CONTROLS, 1)]  # blocks.CONTROLS, (machines,): the blocks of each machine
    inverters: Annotated[NDArray[Any], Array(INVERTER, 1)]  # INVERTER
    loads: Annotated[NDArray[Any], Array(LOAD, 1)]  # LOAD, without constant impedances
    ports: Annotated[NDArray[Any], Array(PORT, 1)]  # PORT
    placed: Annotated[
        NDArray[Any], Array(DEVICE, 1)
    ]  # devices.DEVICE: those of the run in its order, then uncommanded ones in service
    devices: Annotated[NDArray[Any], Array(DEVICE, 1)]  # the commanded ones, those of the run
    infinite: Complex1  # (infinite buses,), p.u.
    interval_start_ns: Int1  # (intervals,), ascending, the first at the earliest time
    mechanical_power: Float2  # (intervals, machines), p.u. of the rating
    online: Float2  # (intervals, machines + inverters), 1 or 0
    island: Int2  # (intervals, machines + infinite buses + inverters), number of the island
    load_scale: Float2  # (intervals, loads)
    load_noise: Float3  # (points, loads, 2), relative, of P and Q (load_noise.py); no points: no noise
    oscillations: Annotated[NDArray[Any], Array(OSCILLATION, 1)]  # events.OSCILLATION
    network: Complex3
    sparse_networks: Table[SparseNetwork]
    pmu_machine: Int1  # (PMUs,), machine index or -1


class PlantState(Struct):
    """State of a plant: `x` in the kernels' order, and the reference of each device and its target, p.u.

    `watch`: state of the watchdogs; `under_way`: setpoints in their dead times. `source`: the last solution of the
    ports' sources (p.u.), from which the next one starts; `source_motion`: as `prediction` has it.
    """

    x: Float1
    reference: Float1
    target: Float1
    watch: Annotated[NDArray[Any], Array(WATCH, 1)]  # watchdog.WATCH
    source: Complex1
    source_motion: Complex2  # (3, ports)
    under_way: Annotated[NDArray[Any], Array(UNDER_WAY, 2)]  # watchdog.UNDER_WAY, (devices, room)
    waiting: Int1  # (devices,), number of setpoints in `under_way`


class Work(Struct):
    """Arrays reused by the kernels."""

    slopes: Float2  # (4, states), 1/s, of the parts of an integration step
    trial: Float1  # (states,), at which a part takes its slopes
    ramp: Float1  # (devices,), p.u./s, of the references
    reference: Float1  # (devices,)
    inputs: Complex1  # of the network
    unit: Complex1  # the same, zero between uses
    voltage: Complex1  # of a large grid's buses, p.u., in their order of elimination
    emf: Complex1  # (machines,), Ed + j Eq behind the stator's reactances, in the rotor's frame, p.u.
    rotation: Complex1  # (machines,), exp(j (delta - pi/2)), from the rotor's frame to the network's
    given: Complex1  # (ports,), response to all inputs except the ports' sources
    response: Complex1  # (ports,)
    blocked: Bool1  # (ports,)
    given_up: Bool1  # (ports,), inverters that stay blocked
    low: Bool1  # (ports,), loads with their characteristic below V_min
    slope: Float3  # (ports, 2, 2), derivative of the source by the response
    matrix: Float2  # (2 ports, 2 ports + 1), of Newton's method, with the mismatch
    step: Float1  # (2 ports,)
    source: Complex1  # (ports,), of a solution that is not stored in the state
    source_path: Complex2  # (2, ports), within a step, as `prediction` has it
    phasors: Complex2  # (PMUs, 2), voltages and currents of the PMUs, p.u.
    samples: Complex3  # (instants, PMUs, 2), likewise, within a call of `advance`
    noise: Float2  # (loads, 2), relative, of P and Q, current values, with forced oscillations
    noise_start: Float2  # values at the start of the current segment of its grid
    noise_slope: Float2  # 1/s
    since: Float1  # (oscillations,), s from the start to the current segment; negative: not active
    level: Float1  # (oscillations,), of square waves in the current segment
    value: Float1  # (oscillations,), current values; 0: not active
    forced: Float1  # (machines,), forced oscillation relative to the mechanical power, current value
    signals: Float1  # of the blocks of one control
    added: Float1  # (machines,), p.u., setpoints at the summing points of voltage regulators
    inverter_signals: Float2  # (inverters, room), of each inverter
    inverter_source: Complex1  # (inverters,), current or EMF in the direction of its angle, p.u. of the rating
    inverter_turn: Complex1  # (inverters,), direction of its angle


def workspace(plant: Plant, state: PlantState, samples: int = 0) -> Work:
    """Arrays of the right size for `plant`; `samples`: of the PMUs within a call of `advance`."""
    machines, ports = len(plant.machines), len(plant.ports)
    inputs = machines + len(plant.infinite) + ports
    most_rows = int((plant.inverters["end"] - plant.inverters["first"]).max(initial=0))
    signals = np.zeros((len(plant.inverters), AT + most_rows))
    signals[:, : len(KNOWN)] = plant.inverters["sensed"]
    return Work(
        np.zeros((4, len(state.x))),
        np.zeros(len(state.x)),
        np.zeros(len(state.reference)),
        np.zeros(len(state.reference)),
        np.zeros(inputs, np.complex128),
        np.zeros(inputs, np.complex128),
        np.zeros(max((len(net.lower.begin) - 1 for net in plant.sparse_networks), default=0), np.complex128),
        np.zeros(machines, np.complex128),
        np.zeros(machines, np.complex128),
        np.zeros(ports, np.complex128),
        np.zeros(ports, np.complex128),
        np.zeros(ports, np.bool_),
        np.zeros(ports, np.bool_),
        np.zeros(ports, np.bool_),
        np.zeros((ports, 2, 2)),
        np.zeros((2 * ports, 2 * ports + 1)),
        np.zeros(2 * ports),
        np.zeros(ports, np.complex128),
        np.zeros((2, ports), np.complex128),
        np.zeros((len(plant.pmu_machine), 2), np.complex128),
        np.zeros((samples, len(plant.pmu_machine), 2), np.complex128),
        np.zeros((len(plant.loads), 2)),
        np.zeros((len(plant.loads), 2)),
        np.zeros((len(plant.loads), 2)),
        np.full(len(plant.oscillations), -1.0),
        np.zeros(len(plant.oscillations)),
        np.zeros(len(plant.oscillations)),
        np.zeros(machines),
        np.zeros(len(SENSED) + len(plant.blocks)),
        np.zeros(machines),
        signals,
        np.zeros(len(plant.inverters), np.complex128),
        np.zeros(len(plant.inverters), np.complex128),
    )


def copy(state: PlantState) -> PlantState:
    """An independent copy of a state."""
    return PlantState(*(array.copy() for array in state))


def fitted(state: PlantState, plant: Plant) -> PlantState:
    """A state for a plant with more ports or fewer, as after an event during a run; the same if it fits."""
    if len(state.source) == len(plant.ports):
        return state
    ports = len(plant.ports)
    return state._replace(source=np.zeros(ports, np.complex128), source_motion=np.zeros((3, ports), np.complex128))


@compiled
def interval_at(plant: Plant, time_ns: int) -> int:
    """Index of the interval at a time; an event acts from its own instant on."""
    interval = 0
    while interval + 1 < len(plant.interval_start_ns) and plant.interval_start_ns[interval + 1] <= time_ns:
        interval += 1
    return interval


@compiled
def begin_interval(plant: Plant, state: PlantState, time_ns: int) -> int:
    """Index of the interval at a time.

    If the interval begins there, the last solution is no start for the new network, unless there are inverters: with
    them there may be several, of which that nearest to the last one counts.
    """
    interval = interval_at(plant, time_ns)
    if plant.interval_start_ns[interval] == time_ns and plant.inverters.size == 0:
        state.source[:] = 0.0
        state.source_motion[:] = 0.0
    return interval
