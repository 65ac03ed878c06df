"""The compiled plant: network solution, derivatives, one step of time, measurement.

State is explicit and owned by the caller; every function here is called by the plant node, by the
in-process loop and by the linearisation alike. Times are integer nanoseconds.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from facts_damping.compiling import compiled
from facts_damping.plant import excitation, sssc
from facts_damping.plant.machine import ROTOR_STATES

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
    emf: NDArray[np.complex128]  # (machines,), subtransient EMF in the network's frame
    reference: NDArray[np.float64]  # (devices,)


def workspace(plant: Plant, state: PlantState) -> Work:
    """Arrays of the right size for `plant`."""
    machines, columns = len(plant.machines), plant.network.shape[2]
    return Work(
        np.zeros((6, len(state.x))),
        np.zeros(columns, np.complex128),
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


@compiled
def _row(plant: Plant, stage: int, row: int, injection: NDArray[np.complex128]) -> complex:
    """One row of the network times the injected currents, p.u."""
    total = 0j
    for column in range(injection.size):
        total += plant.network[stage, row, column] * injection[column]
    return total


@compiled
def solve_network(plant: Plant, x: NDArray[np.float64], reference: NDArray[np.float64], stage: int, work: Work) -> Any:
    """Injected currents of all machines and devices into `work.injection`, p.u.; returns the converter.

    Machines: y E'' with E'' = (E''d + j E''q) exp(j (delta - pi/2)). Without a device the converter
    returned is that of an open port.
    """
    machines = plant.machines.size
    for g in range(machines):
        m = plant.machines[g]
        o = ROTOR_STATES * g
        emf_q, emf_d = 0.0, 0.0
        for i in range(4):
            emf_q += m.C[0, i] * x[o + 2 + i]
            emf_d += m.C[1, i] * x[o + 2 + i]
        delta = x[o]
        work.emf[g] = complex(emf_d, emf_q) * complex(math.sin(delta), -math.cos(delta))
        work.injection[g] = m.admittance * work.emf[g] * plant.online[stage, g]
    found = sssc.Converter(0j, 0.0, 0.0, 0.0, 0.0, 0.0, True, True, True)
    for p in range(plant.converters.size):
        port = machines + p
        work.injection[port] = 0.0
        open_circuit = _row(plant, stage, port, work.injection)
        impedance = -plant.network[stage, port, port]
        # A setpoint is capacitive positive, the converter's voltage a drop.
        found = sssc.converter(plant.converters[p], x, -reference[p], open_circuit, impedance)
        work.injection[port] = found.current
    return found


@compiled
def stator(plant: Plant, x: NDArray[np.float64], stage: int, g: int, work: Work) -> tuple[complex, complex, float]:
    """Terminal voltage (p.u.), stator current Id + j Iq and air-gap power (p.u. of the rating) of machine g."""
    m = plant.machines[g]
    o = ROTOR_STATES * g
    voltage = _row(plant, stage, g, work.injection)
    current = m.admittance * (work.emf[g] - voltage) * plant.online[stage, g] / m.ratio
    back = complex(math.sin(x[o]), math.cos(x[o]))  # exp(-j (delta - pi/2))
    emf = work.emf[g] * back
    current *= back
    return voltage, current, emf.real * current.real + emf.imag * current.imag


@compiled
def derivatives(
    plant: Plant,
    x: NDArray[np.float64],
    reference: NDArray[np.float64],
    stage: int,
    dx: NDArray[np.float64],
    work: Work,
) -> None:
    """Write dx/dt, 1/s: swing equations (2.1)-(2.2), rotor circuits, exciters, devices.

    ddelta = omega_0 omega; 2 H domega = Pm - Pe - D omega; dz = A z + B [Id, Iq, Efd].
    """
    found = solve_network(plant, x, reference, stage, work)
    for g in range(plant.machines.size):
        m = plant.machines[g]
        e = plant.exciters[g]
        o = ROTOR_STATES * g
        voltage, current, power = stator(plant, x, stage, g, work)
        efd = excitation.field_voltage(e, x)
        dx[o] = plant.omega_0 * x[o + 1]
        dx[o + 1] = (plant.mechanical_power[stage, g] - power - m.D * x[o + 1]) / (2.0 * m.H)
        for i in range(4):
            slope = m.B[i, 0] * current.real + m.B[i, 1] * current.imag + m.B[i, 2] * efd
            for j in range(4):
                slope += m.A[i, j] * x[o + 2 + j]
            dx[o + 2 + i] = slope
        excitation.derivatives(e, x, abs(voltage), efd, dx)
    for p in range(plant.converters.size):
        sssc.derivatives(plant.converters[p], x, found, dx)


@compiled
def _runge_kutta(plant: Plant, state: PlantState, ramp: NDArray[np.float64], stage: int, h: float, work: Work) -> None:
    """One classical fourth-order Runge-Kutta step of `h` seconds; references move by `ramp` p.u./s."""
    x, k, reference = state.x, work.slopes, work.reference
    trial = k[4]
    derivatives(plant, x, state.reference, stage, k[0], work)
    for part in range(1, 4):
        share = h if part == 3 else 0.5 * h
        for i in range(x.size):
            trial[i] = x[i] + share * k[part - 1, i]
        for d in range(reference.size):
            reference[d] = state.reference[d] + share * ramp[d]
        derivatives(plant, trial, reference, stage, k[part], work)
    for i in range(x.size):
        x[i] += h / 6.0 * (k[0, i] + 2.0 * (k[1, i] + k[2, i]) + k[3, i])


@compiled
def _take_setpoints(plant: Plant, state: PlantState, setpoints: NDArray[Any], first: int, count: int, now: int) -> int:
    """Put the setpoints that are effective by `now` in force, limited; returns the index of the next one."""
    while first < count and setpoints[first].effective_ns <= now:
        value, device = setpoints[first].value, setpoints[first].device
        if math.isfinite(value):
            limit = plant.converters[device].v_max
            state.target[device] = min(max(value, -limit), limit)
        first += 1
    return first


@compiled
def _ramp(plant: Plant, state: PlantState, ramp: NDArray[np.float64], end: int, now: int) -> int:
    """Slopes (p.u./s) that take the references to their targets at their rate limits; where the first arrives."""
    for d in range(ramp.size):
        gap = state.target[d] - state.reference[d]
        rate = plant.converters[d].rate_max
        ramp[d] = 0.0
        if gap != 0.0:
            ramp[d] = math.copysign(rate, gap)
            end = min(end, now + max(1, math.ceil(abs(gap) / rate * 1e9)))
    return end


@compiled
def _move_reference(state: PlantState, ramp: NDArray[np.float64], seconds: float) -> None:
    """Move the references along their ramps, not beyond their targets."""
    for d in range(ramp.size):
        gap = state.target[d] - state.reference[d]
        move = ramp[d] * seconds
        if abs(move) >= abs(gap):
            state.reference[d] = state.target[d]
        else:
            state.reference[d] += move


@compiled
def advance(
    plant: Plant,
    state: PlantState,
    start_ns: int,
    end_ns: int,
    setpoints: NDArray[Any],
    count: int,
    work: Work,
) -> None:
    """Advance the plant in place from `start_ns` to `end_ns` under `count` setpoints, ordered by time.

    Setpoints, events and the ends of reference ramps split the interval exactly; each part is divided
    into equal steps of at most `plant.step_ns`. A setpoint that is not finite is passed over.
    """
    now, following = start_ns, 0
    ramp = work.slopes[5, : state.reference.size]
    while now < end_ns:
        following = _take_setpoints(plant, state, setpoints, following, count, now)
        stage = stage_at(plant, now)
        end = end_ns
        if following < count:
            end = min(end, setpoints[following].effective_ns)
        if stage + 1 < plant.stage_start_ns.size:
            end = min(end, plant.stage_start_ns[stage + 1])
        end = _ramp(plant, state, ramp, end, now)
        steps = (end - now + plant.step_ns - 1) // plant.step_ns
        h = (end - now) * 1e-9 / steps
        for _ in range(steps):
            _runge_kutta(plant, state, ramp, stage, h, work)
            _move_reference(state, ramp, h)
        now = end


@compiled
def measure(
    plant: Plant,
    state: PlantState,
    time_ns: int,
    frame: NDArray[np.float64],
    machines: NDArray[Any],
    devices: NDArray[Any],
    work: Work,
) -> bool:
    """What the PMUs see at an instant, and the truth: fills `frame` (stations, channels), MACHINE_TRUTH, DEVICE_TRUTH.

    Returns whether the plant is sound: all states finite and the rotor angles of the machines in service
    within 180 degrees of each other.
    """
    stage = stage_at(plant, time_ns)
    x = state.x
    found = solve_network(plant, x, state.reference, stage, work)
    count = plant.machines.size
    low, high, sound = math.inf, -math.inf, True
    for i in range(x.size):
        sound = sound and math.isfinite(x[i])
    for g in range(count):
        voltage, _, power = stator(plant, x, stage, g, work)
        delta = x[ROTOR_STATES * g]
        machines[g].rotor_angle = delta
        machines[g].speed_deviation = x[ROTOR_STATES * g + 1]
        machines[g].electrical_power = power * plant.machines[g].ratio
        machines[g].field_voltage = excitation.field_voltage(plant.exciters[g], x)
        machines[g].terminal_voltage = abs(voltage)
        if plant.online[stage, g] > 0.0:
            low, high = min(low, delta), max(high, delta)
    for p in range(plant.converters.size):
        devices[p].setpoint = state.target[p]
        devices[p].reference = state.reference[p]
        devices[p].injected_voltage = -(found.v_q + plant.converters[p].xs * found.magnitude)
        devices[p].active_voltage = found.v_p
        devices[p].current = found.magnitude
        devices[p].dc_voltage = x[plant.converters[p].offset + 2]
        devices[p].blocked = 1.0 if found.blocked else 0.0
    first = count + plant.converters.size
    stations = plant.station_machine.size
    for s in range(stations):
        voltage = _row(plant, stage, first + s, work.injection)
        current = _row(plant, stage, first + stations + s, work.injection)
        g = plant.station_machine[s]
        flow = voltage * current.conjugate()
        frame[s, 0] = abs(voltage)
        frame[s, 1] = math.atan2(voltage.imag, voltage.real)
        frame[s, 2] = math.nan if g < 0 else x[ROTOR_STATES * g + 1]
        frame[s, 3] = flow.real
        frame[s, 4] = flow.imag
    return sound and not high - low > math.pi
