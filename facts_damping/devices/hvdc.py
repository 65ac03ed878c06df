"""The HVDC link: ordered power from one bus to another, reduced at low voltage; compiled.

Its first port is at the inverter's bus, into which it feeds power; the other one is at the rectifier's. A setpoint is
added to the power order, and in AC emulation what the angle between its ends asks for (docs/facts_devices.md).
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, Literal

from facts_damping.compiling import compiled
from facts_damping.devices.base import KIND, Transmission
from facts_damping.devices.kind import DeviceKind, OtherEnd, Shown, Site, Start, table
from facts_damping.devices.power_at_bus import beside, power_fraction
from facts_damping.elementary import phase
from facts_damping.errors import InputError
from facts_damping.fields import quantity

if TYPE_CHECKING:
    from collections.abc import Sequence

    from facts_damping.compiling.structs import Float1


class Hvdc(Transmission):
    """An [HVDC link](facts_devices.md) that carries power from a rectifier's bus to an inverter's bus.

    Its setpoint is power added to its order. Setpoints are in p.u. of the system base, powers of the link in MW: with a
    base of 100 MVA a `setpoint_max` of 0.5 is 50 MW. A link that is not installed stays in service and carries its
    order. With `P_min` below 0 it is the modulation of a link whose schedule stands among the loads.
    """

    kind: Literal["hvdc"] = KIND
    P: float = quantity(
        ..., "MW", "power order, taken from the `from` bus; from `P_min` to `P_max`", usual=200, ge=0, le=1e5
    )
    P_max: float = quantity(..., "MW", "largest power, also with modulation", usual=300, gt=0, le=1e5)
    P_min: float = quantity(
        0.0,
        "MW",
        "smallest power, also with modulation; below 0 only without losses and reactive power",
        ge=-1e5,
        le=1e5,
    )
    setpoint_max: float = quantity(
        ..., "p.u.", "limit of the setpoint, power added to the order", usual=0.5, gt=0, le=1000
    )
    rate_max: float = quantity(..., "p.u./s", "rate limit of the setpoint", usual=10, gt=0, le=1e4)
    loss: float = quantity(0.0, "-", "losses of the converters, as a fraction of the power", ge=0, le=0.2)
    R: float = quantity(0.0, "p.u.", "resistance of the DC line, which loses R P^2", ge=0, le=10)
    pf_from: float = quantity(
        1.0, "-", "power factor of the rectifier, which draws reactive power; 1: none", ge=0.5, le=1
    )
    pf_to: float = quantity(1.0, "-", "power factor of the inverter, which draws reactive power; 1: none", ge=0.5, le=1)
    V_min: float = quantity(
        0.7, "p.u.", "voltage of either bus below which the power falls with its square", ge=0.1, le=1
    )
    T: float = quantity(
        0.02, "s", "time constant with which each end learns of the voltage at the other end", ge=0.001, le=10
    )
    K: float = quantity(
        0.0, "MW", "AC emulation: power per degree of the angle between `from` and `to`; 0: none", ge=0, le=1e4
    )
    T_angle: float = quantity(1.0, "s", "AC emulation: time constant of the measured angle", ge=0.001, le=1000)

    def check(self) -> None:
        """Raise `ValueError` where fields contradict each other."""
        if not self.P_min <= self.P <= self.P_max:
            raise ValueError(f"P must be between P_min and P_max, given {self.P}, {self.P_min} and {self.P_max}")
        if self.P_min < 0.0 and (self.loss, self.R, self.pf_from, self.pf_to) != (0.0, 0.0, 1.0, 1.0):
            raise ValueError(f"P_min below 0 needs loss 0, R 0, pf_from 1 and pf_to 1, given {self.P_min:g}")


STATES = ["V_to", "V_from", "angle"]  # the last in AC emulation alone
POWERS = ("P", "P_min", "P_max")
FIELDS = ("loss", "R", "V_min", "T", "T_angle")
# The last: reactive power drawn, relative to the active power; power per angle, p.u./rad; the angle at the start, rad.
TABLE = table(*POWERS, *FIELDS, "q_to", "q_from", "K", "angle")


def consumed_power(device: Hvdc, _voltages: Sequence[float], base_power: float) -> list[complex]:
    """Power drawn at rest from the inverter's bus and the rectifier's, P + j Q, p.u. of the base (MVA)."""
    P = device.P / base_power
    fed_in = P * (1.0 - device.loss) - device.R * P * P
    return [fed_in * complex(-1.0, beside(device.pf_to)), P * complex(1.0, beside(device.pf_from))]


def start(device: Hvdc, site: Site) -> Start:
    """The link at its power order. Raises `InputError` if an initial voltage is too low for it."""
    for bus, voltage in zip(device.buses, (site.size, site.other), strict=True):
        if voltage < device.V_min:
            raise InputError(
                f"devices: {device.name}: {bus} has {voltage:.4g} p.u. of voltage at the start; "
                f"allowed: at least its V_min, {device.V_min:g}"
            )
    powers = (getattr(device, name) / site.base_power for name in POWERS)
    others = (getattr(device, name) for name in FIELDS)
    K = math.degrees(device.K) / site.base_power
    row = (site.offset, *powers, *others, beside(device.pf_to), beside(device.pf_from), K, site.angle)
    return Start(row, [site.size, site.other, *([site.angle] if K > 0.0 else [])], 0.0)


@compiled
def power(d: Any, x: Float1, u: float, voltage: float) -> tuple[float, float]:
    """Power at the rectifier by the voltage of one end's bus, and its derivative by that voltage; p.u.

    P = clip(P0 + u + K (angle - angle0), P_min, P_max) min(fraction(V), fraction(V_to), fraction(V_from)). V_to, V_from
    and angle are states: the lagged voltages known to both ends, and the lagged angle between them.
    """
    emulated = d.K * (x[d.offset + 2] - d.angle) if d.K > 0.0 else 0.0
    order = min(max(d.P + u + emulated, d.P_min), d.P_max)
    known = min(power_fraction(x[d.offset], d.V_min), power_fraction(x[d.offset + 1], d.V_min))
    here = power_fraction(voltage, d.V_min)
    if here < known:
        return order * here, 2.0 * order * voltage / (d.V_min * d.V_min)
    return order * known, 0.0


@compiled
def to_end(device: Any, x: Float1, u: float, voltage: float) -> tuple[complex, complex]:
    """Current into the inverter's bus relative to the direction of its voltage, and its derivative by |V|, p.u.

    The link feeds in p = P (1 - loss) - R P^2 and draws q p: conj(S) / |V| = p (1 + j q) / |V|.
    """
    d = device.hvdc
    P, slope = power(d, x, u, voltage)
    fed_in, by_power = P * (1.0 - d.loss) - d.R * P * P, 1.0 - d.loss - 2.0 * d.R * P
    along = complex(1.0, d.q_to)
    value = fed_in * along / voltage
    return value, (by_power * slope * along - value) / voltage


@compiled
def from_end(device: Any, x: Float1, u: float, voltage: float) -> tuple[complex, complex]:
    """Current into the rectifier's bus, where the link draws P and q P: P (-1 + j q) / |V|, and its derivative, p.u."""
    d = device.hvdc
    P, slope = power(d, x, u, voltage)
    along = complex(-1.0, d.q_from)
    value = P * along / voltage
    return value, (slope * along - value) / voltage


@compiled
def derivatives(device: Any, x: Float1, _u: float, voltage: float, dx: Float1) -> None:
    """Write the derivative of the lagged voltage of the inverter's bus, 1/s: T dV_to = |V| - V_to."""
    d = device.hvdc
    dx[d.offset] = (voltage - x[d.offset]) / d.T


@compiled
def from_derivatives(device: Any, x: Float1, _u: float, voltage: float, dx: Float1) -> None:
    """Write the derivative of the lagged voltage of the rectifier's bus, 1/s: T dV_from = |V| - V_from."""
    d = device.hvdc
    dx[d.offset + 1] = (voltage - x[d.offset + 1]) / d.T


@compiled
def angle_derivatives(device: Any, x: Float1, at_to: complex, at_from: complex, dx: Float1) -> None:
    """Write the derivative of the lagged angle by which `from` leads, rad/s: T_angle d(angle) = leads - angle."""
    d = device.hvdc
    if d.K > 0.0:
        dx[d.offset + 2] = (phase(at_from * at_to.conjugate()) - x[d.offset + 2]) / d.T_angle


OTHER = OtherEnd(from_end, from_derivatives, angle_derivatives)
SHOWN = Shown(
    "HVDC link",
    "power added to the order",
    "carries more power from `from` to `to`",
    "power added",
    outline="M-1,-1L1,1V-1L-1,1Z",
)
ROW = DeviceKind(
    TABLE, STATES, start, to_end, derivatives, consumed_power=consumed_power, other_end=OTHER, model=Hvdc, shown=SHOWN
)
