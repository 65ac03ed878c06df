"""The sources of inverters: what follows from their states before the network is solved, and their law; compiled."""

from __future__ import annotations

from typing import TYPE_CHECKING

from facts_damping.compiling import compiled
from facts_damping.elementary import magnitude, sin_cos
from facts_damping.plant.inverters import inverter
from facts_damping.plant.machines import blocks

if TYPE_CHECKING:
    from facts_damping.compiling.structs import Float1
    from facts_damping.plant.model import Plant, Work


@compiled
def begin(plant: Plant, work: Work) -> None:
    """Write what does not change with time into the inverters' signals, setpoints as 0."""
    for i in range(plant.inverters.size):
        for k in range(len(inverter.KNOWN)):
            work.inverter_signals[i, k] = plant.inverters[i].sensed[k]


@compiled
def prepare(plant: Plant, x: Float1, work: Work) -> None:
    """Evaluate what follows from states: each inverter's source, and the direction of its angle.

    The setpoints of devices are in `work.inverter_signals` already.
    """
    for i in range(plant.inverters.size):
        v, s = plant.inverters[i], work.inverter_signals[i]
        blocks.outputs(plant.blocks, v.first, v.known, inverter.AT, x, s)
        work.inverter_source[i] = complex(s[v.real], s[v.imag])
        if v.angle >= 0:
            sine, cosine = sin_cos(s[v.angle])
            work.inverter_turn[i] = complex(cosine, sine)


@compiled
def law(plant: Plant, interval: int, i: int, voltage: complex, p: int, work: Work) -> complex:
    """Source of inverter i at its port p and terminal voltage, p.u. of the system; writes its derivative.

    A current source is f(|V|) turned by its angle. An EMF E has the current y (E - V), cut to I_max with its angle as
    it is; its source is that beside the admittance, I + y V.
    """
    v, size = plant.inverters[i], magnitude(voltage)
    if plant.online[interval, plant.machines.size + i] == 0.0:
        work.slope[p, 0, 0] = work.slope[p, 0, 1] = work.slope[p, 1, 0] = work.slope[p, 1, 1] = 0.0
        return 0j
    along = complex(voltage.real / size, voltage.imag / size) if size > inverter.SMALL else 1.0 + 0j
    size = max(size, inverter.SMALL)
    turn, by_real, by_imag = along, (1.0 - along * along.real) / size, (1j - along * along.imag) / size
    if v.angle >= 0:
        turn, by_real, by_imag = work.inverter_turn[i], 0j, 0j
    if v.source == inverter.CURRENT:
        value, slope = inverter.reduced(v, work.inverter_source[i], size)
        total = value * turn
        by_real, by_imag = slope * along.real * turn + value * by_real, slope * along.imag * turn + value * by_imag
    else:
        emf, y = work.inverter_source[i], v.admittance
        current = y * (emf * turn - voltage)
        by_real, by_imag = y * (emf * by_real - 1.0), y * (emf * by_imag - 1j)
        flowing = magnitude(current)
        if flowing > v.I_max:
            unit, cut = current / flowing, v.I_max / flowing
            by_real = cut * (by_real - unit * (unit.conjugate() * by_real).real)
            by_imag = cut * (by_imag - unit * (unit.conjugate() * by_imag).real)
            current = v.I_max * unit
        total, by_real, by_imag = current + y * voltage, by_real + y, by_imag + 1j * y
    work.slope[p, 0, 0], work.slope[p, 1, 0] = v.ratio * by_real.real, v.ratio * by_real.imag
    work.slope[p, 0, 1], work.slope[p, 1, 1] = v.ratio * by_imag.real, v.ratio * by_imag.imag
    return v.ratio * total  # type: ignore[no-any-return]
