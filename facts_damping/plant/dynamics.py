"""Network solution and derivatives of the whole plant; compiled.

The same functions serve the integration, the measurement and the linearisation.
"""

from __future__ import annotations

from typing import Any, NamedTuple

from facts_damping.compiling import compiled, entry_point
from facts_damping.compiling.structs import Complex1, Float1
from facts_damping.elementary import magnitude, power, sin_cos
from facts_damping.elementary.arithmetic import divided
from facts_damping.plant.converters import dispatch
from facts_damping.plant.converters.first_order_lag import effective_reference
from facts_damping.plant.grid import load
from facts_damping.plant.inverter_sources import begin, move, outputs, prepare
from facts_damping.plant.inverters import inverter
from facts_damping.plant.machines import blocks, excitation, governor, stabiliser
from facts_damping.plant.machines.blocks import ID, IFD, IQ, OMEGA, ONE, PA, PE, PREF, SENSED, VC, VD, VQ, VREF, VS, VT
from facts_damping.plant.model import Plant, Work
from facts_damping.plant.network_response import respond, row_times, set_sources
from facts_damping.plant.ports import solve_ports


@compiled
def _add_at_controls(plant: Plant, x: Float1, reference: Float1, work: Work) -> None:
    """Write the setpoints of devices without a port, p.u.: at regulators into `work.added`, else to an inverter's.

    Forced oscillations of these setpoints are added.
    """
    begin(plant, work)
    for g in range(plant.machines.size):
        work.added[g] = 0.0
    for i in range(plant.placed.size):
        d = plant.placed[i]
        if d.port < 0:
            u = effective_reference(d, x, dispatch.reference_of(reference, i))
            if d.inverter >= 0:
                work.inverter_signals[d.inverter, d.input] += u
            else:
                work.added[d.machine] += u
    for i in range(plant.oscillations.size):
        o = plant.oscillations[i]
        if o.exciter >= 0:
            work.added[o.exciter] += work.value[i]
        elif o.inverter >= 0:
            work.inverter_signals[o.inverter, o.input] += work.value[i]


@compiled
def set_machines(plant: Plant, x: Float1, interval: int, work: Work) -> None:
    """Write the inputs of machines, y E with E = (Ed + j Eq) exp(j (delta - pi/2)), and of infinite buses, p.u."""
    machines = plant.machines.size
    for g in range(machines):
        m = plant.machines[g]
        o = m.offset
        emf_q, emf_d = m.E0.imag, m.E0.real
        for i in range(m.circuits):
            emf_q += m.C[0, i] * x[o + 2 + i]
            emf_d += m.C[1, i] * x[o + 2 + i]
        speed = 1.0 + m.speed * x[o + 1]
        work.emf[g] = complex(speed * emf_d, speed * emf_q)
        sine, cosine = sin_cos(x[o])
        work.rotation[g] = complex(sine, -cosine)
        work.inputs[g] = m.admittance * work.emf[g] * work.rotation[g] * plant.online[interval, g]
    for i in range(plant.infinite.size):
        work.inputs[machines + i] = plant.infinite[i]


@entry_point
def solve_network(plant: Plant, x: Float1, reference: Float1, source: Complex1, interval: int, work: Work) -> None:
    """Write the inputs of the network from machines, infinite buses and ports into `work.inputs`, p.u."""
    _add_at_controls(plant, x, reference, work)
    prepare(plant, x, work)
    set_machines(plant, x, interval, work)
    if source.size == 0:
        respond(plant, interval, work)
        return
    if source.size == 1 or len(plant.sparse_networks) == 0:
        first = plant.machines.size + plant.infinite.size
        for p in range(source.size):
            work.inputs[first + p] = 0.0
        respond(plant, interval, work)
        for p in range(source.size):
            work.given[p] = row_times(plant, interval, plant.machines.size + p, work.inputs, work)
    solve_ports(plant, x, reference, source, interval, work)
    set_sources(plant, source, work)
    respond(plant, interval, work)


class Stator(NamedTuple):
    """A machine's stator, p.u.; current and power of its rating."""

    voltage: complex  # at its terminals
    current: complex  # Id + j Iq
    power: float  # in the air gap
    flux: complex  # that saturates: of both axes, or E'q alone
    saturation: float  # S of this flux


@compiled
def stator(plant: Plant, x: Float1, interval: int, g: int, work: Work) -> Stator:
    """Voltage, current, power and saturation of machine g.

    Pe = Ed Id + Eq Iq + (Xq - Xd) Id Iq.
    """
    m = plant.machines[g]
    emf = work.emf[g]
    voltage = row_times(plant, interval, g, work.inputs, work)
    back = work.rotation[g].conjugate()  # into the rotor's frame
    # A factor of zero instead of a branch, which doubles the time of the compiled code.
    beyond = m.salient * work.inputs[m.column] * back
    current = (m.admittance * (emf - voltage * back) + beyond) * (plant.online[interval, g] / m.ratio)
    saliency = (m.Xq - m.Xd) * current.real * current.imag
    air_gap = emf.real * current.real + emf.imag * current.imag + saliency
    flux = complex(0.0, x[m.offset + 2]) if m.field_saturates else emf
    return Stator(voltage, current, air_gap, flux, saturated(m, flux))


@compiled
def saturated(m: Any, flux: complex) -> float:
    """S of a machine's flux: B (psi - A)^2 / psi above A, or B psi^A; 0 without saturation."""
    if m.saturation_B == 0.0:
        return 0.0
    psi = magnitude(flux)
    if m.exponential:
        return m.saturation_B * power(psi, m.saturation_A)  # type: ignore[no-any-return]
    return m.saturation_B * max(0.0, psi - m.saturation_A) ** 2 / psi  # type: ignore[no-any-return]


@compiled
def _circuits(m: Any, x: Float1, n: int, at: Stator, efd: float, dx: Float1) -> None:
    """Write the derivatives of a machine's n rotor circuits, 1/s: dz = A z + B [Id, Iq, Efd] - S W [psiq, psid]."""
    first = m.offset + 2
    for i in range(n):
        slope = m.B[i, 0] * at.current.real + m.B[i, 1] * at.current.imag + m.B[i, 2] * efd
        for j in range(n):
            slope += m.A[i, j] * x[first + j]
        if at.saturation > 0.0:
            slope -= at.saturation * (m.W[i, 0] * at.flux.imag + m.W[i, 1] * at.flux.real)
        dx[first + i] = slope


@entry_point
def derivatives(
    plant: Plant, x: Float1, reference: Float1, source: Complex1, interval: int, dx: Float1, work: Work
) -> None:
    """Write dx/dt, 1/s: swing equations (2.1)-(2.2), rotor circuits, controls, loads, devices; solves `source`.

    ddelta = omega_0 omega; 2 H domega = Pm - Pe - D omega, powers over 1 + omega if the speed multiplies the EMF, and
    (Pm - D omega) / (1 + omega) - Pe with `speed_torque`.
    """
    solve_network(plant, x, reference, source, interval, work)
    for g in range(plant.machines.size):
        m = plant.machines[g]
        o = m.offset
        omega = x[o + 1]
        at = stator(plant, x, interval, g, work)
        efd, mechanical_power = move_controls(plant, x, interval, g, at, dx, work)
        shaft = 1.0 + m.shaft * omega
        driven = mechanical_power * plant.online[interval, g] / shaft
        dx[o] = plant.omega_0 * omega
        dx[o + 1] = ((driven - at.power) / (1.0 + m.speed * omega) - m.D * omega / shaft) / (2.0 * m.H)
        if m.circuits == 4:  # the usual number, so that the compiler unrolls the loop
            _circuits(m, x, 4, at, efd, dx)
        else:
            _circuits(m, x, m.circuits, at, efd, dx)
    for i in range(plant.inverters.size):
        _sense_inverter(plant, source, interval, i, work)
    if plant.inverters.size > 0:
        outputs(plant, x, True, work)
        move(plant, x, dx, work)
    _port_derivatives(plant, x, reference, dx, work)


@entry_point
def _sense_inverter(plant: Plant, source: Complex1, interval: int, i: int, work: Work) -> None:
    """Write what inverter i measures into its signals."""
    v, s = plant.inverters[i], work.inverter_signals[i]
    voltage = work.response[v.port]
    flowing = inverter.current(v, source[v.port], voltage) * plant.online[interval, plant.machines.size + i]
    inverter.sense(v, work.inverter_turn[i], voltage, flowing, s)
    if v.bus >= 0:
        bus = row_times(plant, interval, v.bus, work.inputs, work)
        if v.branch >= 0:
            flowing = divided(row_times(plant, interval, v.branch, work.inputs, work), v.ratio)
        inverter.sense_plant(v, bus, flowing, s)


@entry_point
def _port_derivatives(plant: Plant, x: Float1, reference: Float1, dx: Float1, work: Work) -> None:
    """Write dx/dt of the states of loads and devices, 1/s; zero for a blocked device."""
    for i in range(plant.loads.size):
        if plant.loads[i].offset >= 0:
            load.derivatives(plant.loads[i], x, work.response[plant.loads[i].port], dx)
    for i in range(plant.placed.size):
        d = plant.placed[i]
        u = dispatch.reference_of(reference, i)
        if d.response_time > 0.0:  # its lag also moves while the device is blocked
            dx[d.lag] = (u - x[d.lag]) / d.response_time
        if d.port < 0:
            continue
        if work.blocked[d.port]:
            for k in range(d.states):
                dx[d.offset + k] = 0.0
        else:
            u = effective_reference(d, x, u)
            dispatch.derivatives(d.kind, d, x, u, magnitude(work.response[d.port]), dx)
            if d.other > 0:
                dispatch.other_derivatives(d.kind, d, x, u, magnitude(work.response[d.other]), dx)
                dispatch.between_derivatives(d.kind, d, x, work.response[d.port], work.response[d.other], dx)


AT = len(SENSED)


@compiled
def _field_current(m: Any, x: Float1, at: Stator) -> float:
    """Field current of a machine, p.u. of that for 1 p.u. of voltage without saturation: T'd0 dE'q = Efd - Ifd."""
    if m.circuits == 0:
        return 0.0
    slope = m.B[0, 0] * at.current.real + m.B[0, 1] * at.current.imag
    for j in range(m.circuits):
        slope += m.A[0, j] * x[m.offset + 2 + j]
    if at.saturation > 0.0:
        slope -= at.saturation * (m.W[0, 0] * at.flux.imag + m.W[0, 1] * at.flux.real)
    return -slope / m.B[0, 2]  # type: ignore[no-any-return]


@compiled
def _given(plant: Plant, first: int, end: int, gives: int, x: Float1, dx: Float1, work: Work) -> float:
    """The output of a block control; writes the derivatives of its states, 1/s."""
    blocks.outputs(plant.blocks, first, end, AT, x, work.signals)
    blocks.derivatives(plant.blocks, first, end, x, work.signals, dx)
    return work.signals[AT + gives]  # type: ignore[no-any-return]


@compiled
def move_controls(
    plant: Plant, x: Float1, interval: int, g: int, at: Stator, dx: Float1, work: Work
) -> tuple[float, float]:
    """Field voltage and mechanical power of machine g, p.u. of its rating; writes its controls' derivatives, 1/s."""
    m, s = plant.machines[g], work.signals
    omega, size, asked = x[m.offset + 1], magnitude(at.voltage), plant.mechanical_power[interval, g]
    forced = asked * work.forced[g]
    driven = governor.power(plant.governors[g], x, asked, omega) + forced
    governor.derivatives(plant.governors[g], x, asked, omega, dx)
    added = stabiliser.output(plant.stabilisers[g], x, omega) + work.added[g]
    stabiliser.derivatives(plant.stabilisers[g], x, omega, dx)
    if plant.blocks.size > 0:
        c = plant.controls[g]
        ifd = _field_current(m, x, at)
        seen, current = at.voltage * work.rotation[g].conjugate(), at.current  # in the rotor's frame
        s[ONE], s[VT], s[OMEGA], s[IFD] = 1.0, magnitude(seen), omega, ifd
        s[VD], s[VQ], s[ID], s[IQ] = seen.real, seen.imag, current.real, current.imag
        s[VC], s[PE] = magnitude(seen + c.compensation * current), (seen * current.conjugate()).real
        s[VREF], s[PREF], s[blocks.VT0] = c.Vref, asked + c.power_offset, c.Vt0
        if c.governor_end > c.governor_first:
            driven = _given(plant, c.governor_first, c.governor_end, c.governor_gives, x, dx, work) + forced
        s[PA] = driven - s[PE]
        if c.stabiliser_end > c.stabiliser_first:
            added = work.added[g] + _given(plant, c.stabiliser_first, c.stabiliser_end, c.stabiliser_gives, x, dx, work)
        s[VS] = added
        if c.exciter_end > c.exciter_first:
            return _given(plant, c.exciter_first, c.exciter_end, c.exciter_gives, x, dx, work), driven
    efd = excitation.field_voltage(plant.exciters[g], x, size, added)
    excitation.derivatives(plant.exciters[g], x, size, added, efd, dx)
    return efd, driven
