"""All controls of a machine together: inputs, outputs, derivatives; compiled."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from facts_damping.compiling import compiled
from facts_damping.elementary import magnitude
from facts_damping.plant.machines import blocks, excitation, governor, stabiliser
from facts_damping.plant.machines.blocks import ID, IFD, IQ, OMEGA, ONE, PA, PE, PREF, SENSED, VD, VQ, VREF, VS, VT

if TYPE_CHECKING:
    from facts_damping.compiling.structs import Float1
    from facts_damping.plant.model import Plant, Work

AT = len(SENSED)


@compiled
def _field_current(m: Any, x: Float1, current: complex, saturation: float, emf: complex) -> float:
    """Field current of a machine, p.u. of that for 1 p.u. of voltage without saturation: T'd0 dE'q = Efd - Ifd."""
    if m.circuits == 0:
        return 0.0
    slope = m.B[0, 0] * current.real + m.B[0, 1] * current.imag
    for j in range(m.circuits):
        slope += m.A[0, j] * x[m.offset + 2 + j]
    if saturation > 0.0:
        slope -= saturation * (m.W[0, 0] * emf.imag + m.W[0, 1] * emf.real)
    return -slope / m.B[0, 2]  # type: ignore[no-any-return]


@compiled
def _given(plant: Plant, first: int, end: int, gives: int, x: Float1, dx: Float1, work: Work) -> float:
    """The output of a block control; writes the derivatives of its states, 1/s."""
    blocks.outputs(plant.blocks, first, end, AT, x, work.signals)
    blocks.derivatives(plant.blocks, first, end, x, work.signals, dx)
    return work.signals[AT + gives]  # type: ignore[no-any-return]


@compiled
def move(
    plant: Plant,
    x: Float1,
    stage: int,
    g: int,
    voltage: complex,
    current: complex,
    saturation: float,
    dx: Float1,
    work: Work,
) -> tuple[float, float]:
    """Field voltage and mechanical power of machine g, p.u. of its rating; writes its controls' derivatives, 1/s.

    `voltage`, `current`: of its stator; `saturation`: S of its flux.
    """
    m, s = plant.machines[g], work.signals
    omega, size, asked = x[m.offset + 1], magnitude(voltage), plant.mechanical_power[stage, g]
    driven = governor.power(plant.governors[g], x, asked, omega)
    governor.derivatives(plant.governors[g], x, asked, omega, dx)
    added = stabiliser.output(plant.stabilisers[g], x, omega)
    stabiliser.derivatives(plant.stabilisers[g], x, omega, dx)
    if plant.blocks.size > 0:
        c = plant.controls[g]
        ifd = _field_current(m, x, current, saturation, work.emf[g])
        seen = voltage * work.rotation[g].conjugate()  # in the rotor's frame
        s[ONE], s[VT], s[OMEGA], s[IFD] = 1.0, magnitude(seen), omega, ifd
        s[VD], s[VQ], s[ID], s[IQ] = seen.real, seen.imag, current.real, current.imag
        s[PE] = (seen * current.conjugate()).real
        s[VREF], s[PREF] = c.Vref, asked + c.power_offset
        if c.governor_end > c.governor_first:
            driven = _given(plant, c.governor_first, c.governor_end, c.governor_gives, x, dx, work)
        s[PA] = driven - s[PE]
        if c.stabiliser_end > c.stabiliser_first:
            added = _given(plant, c.stabiliser_first, c.stabiliser_end, c.stabiliser_gives, x, dx, work)
        s[VS] = added
        if c.exciter_end > c.exciter_first:
            return _given(plant, c.exciter_first, c.exciter_end, c.exciter_gives, x, dx, work), driven
    efd = excitation.field_voltage(plant.exciters[g], x, size, added)
    excitation.derivatives(plant.exciters[g], x, size, added, efd, dx)
    return efd, driven
