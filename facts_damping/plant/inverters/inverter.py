"""Inverters in the compiled plant: their sources at the ports, what their controls see, and how these move.

A source is a current, or an EMF behind an impedance (`machine_controls.blocks.Source`), in the direction of the
terminal's voltage or of an angle of its own. Its control is a run of rows of `plant.blocks`. The first rows follow from
states, and are evaluated before the network is solved; they give the source. The others see the solution.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from facts_damping.compiling import compiled
from facts_damping.elementary import atan2, magnitude
from facts_damping.elementary.arithmetic import divided

if TYPE_CHECKING:
    from facts_damping.compiling.structs import Float1

STARTS = ("Vt0", "Pe0", "Qe0", "Vbus0", "Vcomp0", "Pbranch0", "Qbranch0", "E0")  # E0: EMF of a voltage source
SETPOINTS = ("Pplant", "Qplant", "Vplant", "Paux", "Qaux", "Vaux")  # of a plant control, and of the inverter
# Signals of an inverter's blocks, p.u. of its rating; the blocks' own signals follow.
KNOWN = ("one", "none", "omega_0", "speed", "Pext", "Qext", *STARTS, *SETPOINTS)
MEASURED = ("Vt", "Pe", "Qe", "Vd", "Vq", "Id", "Iq", "theta", "Vbus", "theta_bus", "Pbranch", "Qbranch", "Vcomp")
# What stands for signals that no control may give.
STAND_INS = {"Pref": "Pext", "Pm": "Pe0", "pitch": "pitch_start", "speed_reference": "one"}
AT = len(KNOWN) + len(MEASURED)
FIRST_SETPOINT = len(KNOWN) - len(SETPOINTS)
VT, PE, QE, VD, VQ, ID, IQ, THETA, VBUS, THETA_BUS, PBRANCH, QBRANCH, VCOMP = range(len(KNOWN), AT)

CURRENT, VOLTAGE = 0, 1  # sorts of sources
SMALL = 1e-12  # p.u., voltage below which its direction is undefined

INVERTER = np.dtype(
    [
        ("port", "i8"),
        ("first", "i8"),  # of its rows in `plant.blocks`
        ("known", "i8"),  # end of those that follow from states
        ("end", "i8"),
        ("alike", "i8"),  # inverters from this one on with rows of the same kinds, that are evaluated side by side
        ("source", "i8"),  # CURRENT or VOLTAGE
        ("real", "i8"),  # signals that are its source; angle: -1 for that of the voltage
        ("imag", "i8"),
        ("angle", "i8"),
        ("forming", "i8"),  # 1: it forms a grid, with a direction of its own
        ("turning", "i8"),  # 1: its rows use the angle of a voltage; compensated: 1: they use Vcomp
        ("compensated", "i8"),
        ("bus", "i8"),  # rows of the network that are the regulated bus and the monitored branch; -1: its terminals
        ("branch", "i8"),
        ("ratio", "f8"),  # rating over system base
        ("admittance", "c16"),  # behind which its EMF is, p.u. of the rating; 0 of a current source
        ("I_max", "f8"),  # of a voltage source, p.u.
        ("V_low", "f8"),  # voltages at which the active current of a current source has fallen to 0, and begins to
        ("V_reduced", "f8"),
        ("V_high", "f8"),  # voltage above which reactive current is absorbed, the least reactive current, and the gain
        ("I_least", "f8"),
        ("K_high", "f8"),
        ("compensation", "c16"),  # of the voltage Vcomp, p.u.
        ("sensed", "f8", (len(KNOWN),)),
    ]
)


@compiled
def reduced(v: Any, source: complex, size: float) -> tuple[complex, complex]:
    """Current of a current source at a voltage |V|, and its derivative by |V|; p.u. of its rating.

    The active current falls from V_reduced to 0 at V_low. Above V_high, Khv (|V| - V_high) is taken from the injected
    reactive current, down to I_least.
    """
    gain, slope = 1.0, 0.0
    if size < v.V_reduced:
        gain = max(0.0, (size - v.V_low) / (v.V_reduced - v.V_low))
        slope = 1.0 / (v.V_reduced - v.V_low) if gain > 0.0 else 0.0
    injected, by_voltage = -source.imag, 0.0
    if size > v.V_high:
        less = injected - v.K_high * (size - v.V_high)
        by_voltage = -v.K_high if less > v.I_least else 0.0
        injected = max(less, v.I_least)
    return complex(gain * source.real, -injected), complex(slope * source.real, -by_voltage)


@compiled
def greatest_voltage(v: Any, source: complex, h: complex, without: float) -> float:
    """Greatest |V| that a source in the direction of its voltage can have, p.u.; -1: there is none.

    V = V0 + h f(|V|) V / |V|, with |V0| `without` the source and `h` its response to a current of 1 p.u. of the rating,
    asks for | |V| - h f | = |V0|. Between its kinks f is linear, so that this is a quadratic equation.
    """
    high, saturated = math.inf, v.V_high + max(0.0, -source.imag - v.I_least) / max(v.K_high, SMALL)
    while high > 0.0:
        low = 0.0
        for kink in (v.V_low, v.V_reduced, v.V_high, saturated):
            low = max(low, kink) if kink < high else low
        inside = min(2.0 * low + 1.0, 0.5 * (low + high))
        value, slope = reduced(v, source, inside) if v.source == CURRENT else (v.admittance * source, 0j)
        a, b = 1.0 - h * slope, h * (value - slope * inside)
        square, middle = a.real * a.real + a.imag * a.imag, a.real * b.real + a.imag * b.imag
        rest = middle * middle - square * (b.real * b.real + b.imag * b.imag - without * without)
        for sign in (1.0, -1.0):
            size = (middle + sign * math.sqrt(max(0.0, rest))) / square
            if rest >= 0.0 and low <= size <= high:
                return size
        high = low
    return -1.0


@compiled
def current(v: Any, source: complex, voltage: complex) -> complex:
    """Current of an inverter into the network, p.u. of its rating, from its port's source (p.u. of the system)."""
    return divided(source, v.ratio) - v.admittance * voltage  # type: ignore[no-any-return]


@compiled
def sense(v: Any, turn: complex, voltage: complex, flowing: complex, s: Float1) -> None:
    """Write what an inverter measures at its terminals; `turn`: direction of its angle, if it has one."""
    size = magnitude(voltage)
    if v.angle < 0:
        turn = complex(voltage.real / size, voltage.imag / size) if size > SMALL else 1.0 + 0j
    power = voltage * flowing.conjugate()
    own_voltage, own_current = voltage * turn.conjugate(), flowing * turn.conjugate()
    s[VT] = s[VBUS] = size
    s[PE], s[QE] = power.real, power.imag
    s[PBRANCH], s[QBRANCH] = power.real, power.imag
    s[VD], s[VQ], s[ID], s[IQ] = own_voltage.real, own_voltage.imag, own_current.real, own_current.imag
    if v.turning == 1:
        s[THETA] = s[THETA_BUS] = atan2(voltage.imag, voltage.real)
    if v.compensated == 1:
        s[VCOMP] = magnitude(voltage - v.compensation * flowing)


@compiled
def sense_plant(v: Any, bus: complex, flowing: complex, s: Float1) -> None:
    """Write what its plant control measures at a bus, and of the current in a branch out of it or, without, its own."""
    if v.branch >= 0:
        power = bus * flowing.conjugate()
        s[PBRANCH], s[QBRANCH] = power.real, power.imag
    s[VBUS] = magnitude(bus)
    if v.turning == 1:
        s[THETA_BUS] = atan2(bus.imag, bus.real)
    if v.compensated == 1:
        s[VCOMP] = magnitude(bus - v.compensation * flowing)
