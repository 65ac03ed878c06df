"""PMU measurements, and true values that PMUs do not measure; compiled."""

from __future__ import annotations

import math
from typing import Any

from facts_damping.compiling import compiled, entry_point
from facts_damping.compiling.structs import Complex2, Float1, Float2
from facts_damping.elementary import atan2, magnitude, phase
from facts_damping.plant.converters import dispatch
from facts_damping.plant.converters.first_order_lag import effective_reference
from facts_damping.plant.dynamics import derivatives, move_controls, solve_network, stator
from facts_damping.plant.forced_oscillations import begin_oscillations, move_oscillations
from facts_damping.plant.inverters import inverter
from facts_damping.plant.load_noise import begin_noise, move_noise
from facts_damping.plant.model import Plant, PlantState, Work, begin_interval, interval_at
from facts_damping.plant.network_response import row_times
from facts_damping.signals import SPEED_BAND, DeviceTruths, MachineTruths

MOMENT = 1e-6  # s, time step of the angle's difference quotient for the frequency
LARGE_MOMENT = 3e-5  # s, the same of a large grid, whose ports are solved less closely


@compiled
def _machine(plant: Plant, state: PlantState, interval: int, g: int, out: Any, work: Work) -> None:
    x, m = state.x, plant.machines[g]
    omega = x[m.offset + 1]
    at = stator(plant, x, interval, g, work)
    efd, driven = move_controls(plant, x, interval, g, at, work.slopes[0], work)  # without use for the derivatives
    out.rotor_angle = x[m.offset]
    out.speed_deviation = omega
    out.electrical_power = at.power * m.ratio
    out.mechanical_power = driven * plant.online[interval, g] * m.ratio
    out.field_voltage = efd
    out.terminal_voltage = magnitude(at.voltage)


@compiled
def _device(plant: Plant, state: PlantState, d: int, out: Any, work: Work) -> None:
    """Write the true values of device d: from its port if in parallel, then those of its kind."""
    row = plant.devices[d]
    response, current, blocked = 0j, 0j, False
    if row.port >= 0:
        response, current, blocked = work.response[row.port], state.source[row.port], work.blocked[row.port]
    elif row.inverter >= 0:
        v = plant.inverters[row.inverter]
        response, blocked = work.response[v.port], work.blocked[v.port]
        current = inverter.current(v, state.source[v.port], response) * v.ratio
    flow = response * current.conjugate()
    out.setpoint = state.target[d]
    out.reference = state.reference[d]
    out.injected_voltage = out.active_voltage = out.dc_voltage = out.state = math.nan
    out.current = magnitude(current)
    out.active_power = flow.real
    out.reactive_power = flow.imag
    out.blocked = 1.0 if blocked else 0.0
    watch = state.watch[d]
    out.released = watch.released
    out.refused_value, out.refused_stamp, out.refused_order = (
        watch.refused_value,
        watch.refused_stamp,
        watch.refused_order,
    )
    u = effective_reference(row, state.x, state.reference[d])
    dispatch.truth(row.kind, row, state.x, u, magnitude(response), blocked, out)


@compiled
def _in_synchronism(plant: Plant, x: Float1, interval: int, work: Work) -> bool:
    """Whether the angles of rotors, grid-forming inverters and infinite buses of each island are within 180 degrees.

    And whether speeds of rotors are in their band; what is out of service does not count.
    """
    machines, many = plant.machines.size, 0
    inverters = machines + plant.infinite.size
    for i in range(inverters + plant.inverters.size):
        many = max(many, plant.island[interval, i] + 1)
    for number in range(many):
        low, high = math.inf, -math.inf
        for g in range(machines):
            if plant.online[interval, g] > 0.0 and plant.island[interval, g] == number:
                delta, omega = x[plant.machines[g].offset], x[plant.machines[g].offset + 1]
                low, high = min(low, delta), max(high, delta)
                if abs(omega) > SPEED_BAND:
                    return False
        for i in range(plant.infinite.size):
            if plant.island[interval, machines + i] == number:
                angle = phase(plant.infinite[i])
                low, high = min(low, angle), max(high, angle)
        for i in range(plant.inverters.size):
            v = plant.inverters[i]
            there = plant.online[interval, machines + i] > 0.0 and plant.island[interval, inverters + i] == number
            if v.forming > 0 and there:
                angle = work.inverter_signals[i, v.angle]
                low, high = min(low, angle), max(high, angle)
        if high - low > math.pi:
            return False
    return True


@compiled
def write_phasors(plant: Plant, interval: int, work: Work, phasors: Complex2) -> None:
    """Write voltage and current of each PMU from the network's inputs, p.u., (PMUs, 2)."""
    first, pmus = plant.machines.size + plant.ports.size, plant.pmu_machine.size
    for s in range(pmus):
        phasors[s, 0] = row_times(plant, interval, first + s, work.inputs, work)
        phasors[s, 1] = row_times(plant, interval, first + pmus + s, work.inputs, work)


@compiled
def _a_moment_later(plant: Plant, state: PlantState, interval: int, work: Work) -> float:
    """Solve the network a moment later on the plant's trajectory, with held references; into `work`, not the state.

    Returns the moment, s.
    """
    dx, trial, moment = work.slopes[0], work.trial, LARGE_MOMENT if len(plant.sparse_networks) > 0 else MOMENT
    for p in range(work.source.size):
        work.source[p] = state.source[p]
    derivatives(plant, state.x, state.reference, work.source, interval, dx, work)
    for i in range(dx.size):
        trial[i] = state.x[i] + moment * dx[i]
    move_noise(plant, work, moment)
    move_oscillations(plant, work, moment)
    solve_network(plant, trial, state.reference, work.source, interval, work)
    return moment


@entry_point
def observe(
    plant: Plant, state: PlantState, time_ns: int, machines: MachineTruths, devices: DeviceTruths, work: Work
) -> bool:
    """Write true values at an instant into MACHINE_TRUTH and DEVICE_TRUTH tables, and PMUs' phasors into `work`.

    Returns whether the plant is sound: all states finite, network solved, all rotors in synchronism.
    """
    interval = begin_interval(plant, state, time_ns)
    x = state.x
    begin_noise(plant, work, time_ns, time_ns)
    begin_oscillations(plant, work, time_ns, time_ns)
    solve_network(plant, x, state.reference, state.source, interval, work)
    sound = _in_synchronism(plant, x, interval, work)
    for i in range(x.size):
        sound = sound and math.isfinite(x[i])
    for p in range(plant.ports.size):
        sound = sound and math.isfinite(state.source[p].real)
    for g in range(plant.machines.size):
        _machine(plant, state, interval, g, machines[g], work)
    for d in range(plant.devices.size):
        _device(plant, state, d, devices[d], work)
    write_phasors(plant, interval, work, work.phasors)
    return sound


@entry_point
def measure(
    plant: Plant,
    state: PlantState,
    time_ns: int,
    frame: Float2,
    machines: MachineTruths,
    devices: DeviceTruths,
    work: Work,
) -> bool:
    """Measure the PMUs at an instant into `frame` (PMUs, channels) without errors, and `observe`.

    The frequency is the derivative of the voltage's angle, d theta / dt / (2 pi), along the plant's trajectory from
    this instant; its rate of change is not computed (NaN).
    """
    sound, x = observe(plant, state, time_ns, machines, devices, work), state.x
    interval = interval_at(plant, time_ns)
    moment = _a_moment_later(plant, state, interval, work)
    first = plant.machines.size + plant.ports.size
    for s in range(plant.pmu_machine.size):
        voltage, current = work.phasors[s, 0], work.phasors[s, 1]
        g = plant.pmu_machine[s]
        flow = voltage * current.conjugate()
        later = row_times(plant, interval, first + s, work.inputs, work)
        frame[s, 0] = magnitude(voltage)
        frame[s, 1] = atan2(voltage.imag, voltage.real)
        frame[s, 2] = math.nan if g < 0 else x[plant.machines[g].offset + 1]
        frame[s, 3] = flow.real
        frame[s, 4] = flow.imag
        frame[s, 5] = (plant.omega_0 + phase(later * voltage.conjugate()) / moment) / (2.0 * math.pi)
        frame[s, 6] = math.nan
        frame[s, 7] = magnitude(current)
        frame[s, 8] = phase(current)
    return sound  # type: ignore[no-any-return]
