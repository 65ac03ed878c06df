"""The static synchronous series compensator: converter, regulators, DC link; compiled.

The converter is a voltage drop `v = (v_p + j v_q) I / |I|` between two buses, in series with its transformer
`rs + j xs`. A positive setpoint is capacitive, so the desired drop is u = -setpoint
(thesis 2.42, 2.87-2.89, 2.100-2.104; docs/facts_devices.md).
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from facts_damping.compiling import compiled
from facts_damping.errors import InputError
from facts_damping.plant.converters.site import Start

if TYPE_CHECKING:
    from facts_damping.compiling.structs import Float1
    from facts_damping.parameters.plant.devices import Sssc
    from facts_damping.plant.converters.site import Site

STATE_NAMES = ["x_ac", "x_dc", "vdc"]
STATES = len(STATE_NAMES)
FIELDS = ("rs", "xs", "vp_max", "vc_max", "Kp", "Ki", "Kd", "Kdi", "tau", "g", "I_rated", "I_min")

SSSC = np.dtype([("offset", "i8"), *((name, "f8") for name in FIELDS)])


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
