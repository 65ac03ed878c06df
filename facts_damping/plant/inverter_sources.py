"""The sources of inverters: what follows from their states before the network is solved, and their law; compiled."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from facts_damping.compiling import compiled
from facts_damping.elementary import magnitude, sin_cos
from facts_damping.elementary.arithmetic import divided
from facts_damping.plant.inverters import inverter
from facts_damping.plant.machines import blocks

if TYPE_CHECKING:
    from facts_damping.compiling.structs import Float1
    from facts_damping.plant.model import Plant, Work


@compiled
def begin(plant: Plant, work: Work) -> None:
    """Write the setpoints of all inverters as 0; what does not change is in the signals since the start."""
    for i in range(plant.inverters.size):
        for k in range(inverter.FIRST_SETPOINT, len(inverter.KNOWN)):
            work.inverter_signals[i, k] = 0.0


@compiled
def outputs(plant: Plant, x: Float1, after: bool, work: Work) -> None:
    """Write the signals of all inverters that follow from states or, `after` the network is solved, the others.

    Row by row for inverters that are alike: each signal waits for those before it, but not for those of its neighbours.
    """
    first = 0
    while first < plant.inverters.size:
        v = plant.inverters[first]
        begin, end = (v.known - v.first, v.end - v.first) if after else (0, v.known - v.first)
        for k in range(begin, end):
            for i in range(first, first + v.alike):
                s = work.inverter_signals[i]
                s[inverter.AT + k] = blocks.output(plant.blocks[plant.inverters[i].first + k], x, s)
        first += v.alike


@compiled
def move(plant: Plant, x: Float1, dx: Float1, work: Work) -> None:
    """Write the derivatives of the states of all inverters, 1/s, from their signals."""
    first = 0
    while first < plant.inverters.size:
        v = plant.inverters[first]
        for k in range(v.end - v.first):
            if plant.blocks[v.first + k].state >= 0:
                for i in range(first, first + v.alike):
                    row = plant.blocks[plant.inverters[i].first + k]
                    blocks.move(row, x, work.inverter_signals[i], dx)
        first += v.alike


@compiled
def prepare(plant: Plant, x: Float1, work: Work) -> None:
    """Evaluate what follows from states: each inverter's source, and the direction of its angle.

    The setpoints of devices are in `work.inverter_signals` already.
    """
    outputs(plant, x, False, work)
    for i in range(plant.inverters.size):
        v, s = plant.inverters[i], work.inverter_signals[i]
        work.inverter_source[i] = complex(s[v.real], s[v.imag])
        if v.angle >= 0:
            sine, cosine = sin_cos(s[v.angle])
            work.inverter_turn[i] = complex(cosine, sine)


@compiled
def law(plant: Plant, interval: int, i: int, voltage: complex, p: int, work: Work) -> complex:
    """Source of inverter i at its port p and terminal voltage, p.u. of the system; writes its derivative.

    A current source is f(|V|) turned by its angle. An EMF E has the current y (E - V), cut to I_max with its angle as
    it is; its source is that beside the admittance, I + y V. A blocked inverter has no current.
    """
    v, size = plant.inverters[i], magnitude(voltage)
    along = complex(voltage.real / size, voltage.imag / size) if size > inverter.SMALL else 1.0 + 0j
    size = max(size, inverter.SMALL)
    turn = along
    by_real, by_imag = divided(1.0 - along * along.real, size), divided(1j - along * along.imag, size)
    if v.angle >= 0:
        turn, by_real, by_imag = work.inverter_turn[i], 0j, 0j
    y = v.admittance
    if work.blocked[p]:
        total, by_real, by_imag = y * voltage, y, 1j * y
    elif v.source == inverter.CURRENT:
        value, slope = inverter.reduced(v, work.inverter_source[i], size)
        total = value * turn
        by_real, by_imag = slope * along.real * turn + value * by_real, slope * along.imag * turn + value * by_imag
    else:
        emf = work.inverter_source[i]
        current = y * (emf * turn - voltage)
        by_real, by_imag = y * (emf * by_real - 1.0), y * (emf * by_imag - 1j)
        flowing = magnitude(current)
        if flowing > v.I_max:
            unit, cut = divided(current, flowing), v.I_max / flowing
            by_real = cut * (by_real - unit * (unit.conjugate() * by_real).real)
            by_imag = cut * (by_imag - unit * (unit.conjugate() * by_imag).real)
            current = v.I_max * unit
        total, by_real, by_imag = current + y * voltage, by_real + y, by_imag + 1j * y
    share = v.ratio * plant.online[interval, plant.machines.size + i]
    work.slope[p, 0, 0], work.slope[p, 1, 0] = share * by_real.real, share * by_real.imag
    work.slope[p, 0, 1], work.slope[p, 1, 1] = share * by_imag.real, share * by_imag.imag
    return share * total  # type: ignore[no-any-return]


@compiled
def settled(plant: Plant, interval: int, h: complex, source: complex, p: int, work: Work) -> complex:
    """Source of the inverter at port p with the other sources as they are, p.u. of the system, as `law` has it.

    `h`: response to its source, which is `source` now. One that follows its voltage is blocked if it cannot be solved.
    A current at an angle of its own is that of the voltage as it is.
    """
    i, without = plant.ports[p].row, work.response[p] - h * source
    v, emf = plant.inverters[i], work.inverter_source[i]
    share = v.ratio * plant.online[interval, plant.machines.size + i]
    y = share * v.admittance
    if v.angle >= 0 and v.source == inverter.CURRENT:
        return share * inverter.reduced(v, emf, magnitude(work.response[p]))[0] * work.inverter_turn[i]  # type: ignore[no-any-return]
    open_voltage, z = without / (1.0 - h * y), h / (1.0 - h * y)  # without its current; the response to that
    if v.angle >= 0:
        driven, back, most = y * (emf * work.inverter_turn[i] - open_voltage), y * z, share * v.I_max
        current = driven / (1.0 + back)
        if magnitude(current) > most:
            across = math.sqrt(driven.real * driven.real + driven.imag * driven.imag - (most * back.imag) ** 2)
            current = most * driven / complex(across, most * back.imag)
        return current + y * (open_voltage + z * current)  # type: ignore[no-any-return]
    size = inverter.greatest_voltage(v, emf, h * share, magnitude(without))
    work.blocked[p] = size < 0.0
    if work.blocked[p]:
        return y * open_voltage  # type: ignore[no-any-return]
    value = y * emf if v.source == inverter.VOLTAGE else share * inverter.reduced(v, emf, size)[0]
    apart = size - h * value
    return value * without / apart if magnitude(apart) > inverter.SMALL else value  # type: ignore[no-any-return]
