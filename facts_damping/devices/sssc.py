"""The static synchronous series compensator: converter, regulators, DC link; compiled.

The converter is a voltage drop `v = (v_p + j v_q) I / |I|` between two buses, in series with its transformer
`rs + j xs`. A positive setpoint is capacitive, so the desired drop is u = -setpoint
(thesis 2.42, 2.87-2.89, 2.100-2.104; docs/facts_devices.md).
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

from facts_damping.compiling import compiled
from facts_damping.devices.base import KIND, Series, switch
from facts_damping.devices.kind import DeviceKind, Shown, Site, Start, table
from facts_damping.errors import InputError
from facts_damping.fields import quantity

if TYPE_CHECKING:
    from facts_damping.compiling.structs import Float1


class Sssc(Series):
    """A static synchronous series compensator ([SSSC](facts_devices.md)); data on the system base.

    Its setpoint is a voltage in quadrature to its current. It stands between two buses, or in a line next to one of its
    ends. In a line it has a bus of its own, `<line>.<device>`; its current counts in the direction of the line, and a
    PMU that lists the line at this end measures the flow of the device. A line or a pair of buses has room for one
    device. If it is not installed, only its resistance `rs` remains.
    """

    kind: Literal["sssc"] = KIND
    rs: float = quantity(0.000053, "p.u.", "resistance of the coupling transformer", ge=1e-6, le=1)
    xs: float = quantity(0.0016, "p.u.", "reactance of the coupling transformer", gt=0, le=1)
    setpoint_max: float = quantity(0.1, "p.u.", "limit of the setpoint, the quadrature voltage", gt=0, le=1)
    rate_max: float = quantity(5.0, "p.u./s", "rate limit of the quadrature voltage reference", gt=0, le=1000)
    vp_max: float = quantity(0.1, "p.u.", "limit of the active converter voltage, below `vc_max`", gt=0, le=1)
    vc_max: float = quantity(0.11, "p.u.", "limit of the whole converter voltage", gt=0, le=1)
    Kp: float = quantity(0.00375, "-", "proportional gain of the regulator of the injected voltage", ge=0, le=10)
    Ki: float = quantity(0.1875, "1/s", "integral gain of the regulator of the injected voltage", ge=0, le=1000)
    Kd: float = quantity(0.4, "p.u.", "proportional gain of the DC voltage regulator", ge=0, le=100)
    Kdi: float = quantity(8.0, "p.u./s", "integral gain of the DC voltage regulator", ge=0, le=1e4)
    tau: float = quantity(0.006, "s", "time constant of the DC link, C V^2 / S on the system base", ge=0.001, le=10)
    g: float = quantity(0.0, "p.u.", "conductance of the DC link, for losses", ge=0, le=10)
    I_rated: float = quantity(10.0, "p.u.", "rated current; above it the DC regulator keeps its power", gt=0, le=1000)
    enforce_rating: bool = switch("true: the converter is bypassed above `I_rated`")
    I_min: float = quantity(0.02, "p.u.", "current below which the converter is blocked", gt=0, le=1)

    def check(self) -> None:
        """Raise `ValueError` where fields contradict each other."""
        if self.vp_max >= self.vc_max:
            raise ValueError(f"vp_max must be below vc_max, given {self.vp_max} and {self.vc_max}")


STATES = ["x_ac", "x_dc", "vdc"]
FIELDS = ("rs", "xs", "vp_max", "vc_max", "Kp", "Ki", "Kd", "Kdi", "tau", "g", "I_rated", "I_min")


class Converter(NamedTuple):
    """Converter voltages at a current's magnitude, their derivatives by it, and the active limits; p.u."""

    v_p: float
    v_q: float
    v_p_slope: float
    v_q_slope: float
    ac_limited: bool
    dc_limited: bool


def start(device: Sssc, site: Site) -> Start:
    """The device at rest without injection, at rated DC voltage and the given current.

    The converter compensates its transformer, s_q = -xs |I|, and draws the losses of the DC link, s_p |I| = g. With
    `enforce_rating` it is bypassed above I_rated. Raises `InputError` if its limits exclude this state.
    """
    magnitude = site.size
    if magnitude < device.I_min:
        raise InputError(
            f"devices: {device.name} carries {magnitude:.3g} p.u. at the start; "
            f"allowed: at least I_min, {device.I_min:g}"
        )
    maximum = device.I_rated if device.enforce_rating else math.inf
    if magnitude > maximum:
        raise InputError(
            f"devices: {device.name} carries {magnitude:.4g} p.u. at the start; "
            f"allowed: with enforce_rating at most I_rated, {maximum:g}"
        )
    fraction = min(1.0, device.I_rated / magnitude)
    s_p, s_q = device.g / magnitude, device.xs * magnitude
    if s_p > device.vp_max or s_p * s_p + s_q * s_q > device.vc_max * device.vc_max:
        raise InputError(
            f"devices: {device.name} needs converter voltages of {s_p:.4g} (active) and {s_q:.4g} p.u. (reactive) "
            f"at the start; allowed: vp_max {device.vp_max:g}, vc_max {device.vc_max:g} in all"
        )
    row = (site.offset, *(getattr(device, name) for name in FIELDS))
    return Start(row, [0.0, s_p / fraction, 1.0], device.I_min, maximum)


def losses(device: Sssc, magnitude: float) -> float:
    """Resistance equivalent to the losses of the DC link at a current, g / |I|^2, p.u."""
    maximum = max(magnitude, device.I_min)
    return device.g / (maximum * maximum)


@compiled
def converter(d: Any, x: Float1, u: float, magnitude: float) -> Converter:
    """Converter voltages at a current's magnitude.

    The injected-voltage regulator has algebraic feedback (e_ac = u - v_q - xs |I|), so its equation
    s_q = u + Kp e_ac + x_ac - xs |I| is solved for s_q first; s_q is then limited.
    """
    o = d.offset
    vdc = x[o + 2]
    s_p = d.Kd * (1.0 - vdc) + x[o + 1]
    s_p_slope = 0.0
    if magnitude > d.I_rated:
        s_p *= d.I_rated / magnitude
        s_p_slope = -s_p / magnitude
    dc_limited = abs(s_p) > d.vp_max
    if dc_limited:
        s_p, s_p_slope = math.copysign(d.vp_max, s_p), 0.0
    drop = d.xs * magnitude
    scale = 1.0 / (1.0 + d.Kp * vdc)
    s_q = (u + d.Kp * (u - drop) + x[o] - drop) * scale
    s_q_slope = -(1.0 + d.Kp) * d.xs * scale
    room = math.sqrt(d.vc_max * d.vc_max - s_p * s_p)
    ac_limited = abs(s_q) > room
    if ac_limited:
        s_q_slope = -math.copysign(1.0, s_q) * s_p * s_p_slope / room
        s_q = math.copysign(room, s_q)
    return Converter(s_p * vdc, s_q * vdc, s_p_slope * vdc, s_q_slope * vdc, ac_limited, dc_limited)


@compiled
def characteristic(device: Any, x: Float1, setpoint: float, magnitude: float) -> tuple[complex, complex]:
    """Converter voltage relative to the direction of the current, v_p + j v_q, and its derivative by |I|, p.u."""
    d = device.sssc
    c = converter(d, x, -setpoint, magnitude)
    return complex(c.v_p, c.v_q), complex(c.v_p_slope, c.v_q_slope)


@compiled
def derivatives(device: Any, x: Float1, setpoint: float, magnitude: float, dx: Float1) -> None:
    """Write the derivatives of the states, 1/s, at a current's magnitude, p.u.

    dx_ac = Ki e_ac, dx_dc = Kdi (1 - vdc), each held while its output is limited;
    dvdc = (v_p |I| - g vdc^2) / (tau vdc): the power into the converter charges the DC link or is lost.
    """
    d = device.sssc
    o, u = d.offset, -setpoint
    vdc = x[o + 2]
    c = converter(d, x, u, magnitude)
    dx[o] = 0.0 if c.ac_limited else d.Ki * (u - c.v_q - d.xs * magnitude)
    dx[o + 1] = 0.0 if c.dc_limited else d.Kdi * (1.0 - vdc)
    dx[o + 2] = (c.v_p * magnitude - d.g * vdc * vdc) / (d.tau * vdc)


@compiled
def truth(device: Any, x: Float1, setpoint: float, magnitude: float, blocked: bool, out: Any) -> None:
    """Write its fields of DEVICE_TRUTH: voltages, and the power fed in by converter and transformer."""
    d = device.sssc
    c = converter(d, x, -setpoint, magnitude)
    v_p, v_q = (0.0, 0.0) if blocked else (c.v_p, c.v_q)
    out.injected_voltage = -(v_q + d.xs * magnitude)
    out.active_voltage = v_p
    out.current = magnitude
    out.dc_voltage = x[d.offset + 2]
    out.active_power = -(v_p + d.rs * magnitude) * magnitude
    out.reactive_power = -(v_q + d.xs * magnitude) * magnitude


SHOWN = Shown(
    "SSSC (static synchronous series compensator)",
    "voltage in quadrature to the line current",
    "is capacitive, raises the transfer",
    marker="s",
    outline="M-1,-1H1V1H-1Z",
)
ROW = DeviceKind(
    table(*FIELDS), STATES, start, characteristic, derivatives, truth, losses, model=Sssc, shown=SHOWN, new={}
)
