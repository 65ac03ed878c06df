"""The static synchronous series compensator: converter, regulators, DC link; compiled.

The converter stands between two buses as a voltage drop `v = (v_p + j v_q) I / |I|` behind its
transformer `rs + j xs`; a setpoint is capacitive positive, so the wanted drop is u = -setpoint
(thesis 2.42, 2.87-2.89, 2.100-2.104; docs/plant.md).
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from facts_damping.compiling import compiled
from facts_damping.errors import InputError

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from facts_damping.parameters.system import Sssc

STATE_NAMES = ["x_ac", "x_dc", "vdc"]
STATES = len(STATE_NAMES)
FIELDS = (
    "rs",
    "xs",
    "v_max",
    "rate_max",
    "vp_max",
    "vc_max",
    "Kp",
    "Ki",
    "Kd",
    "Kdi",
    "tau",
    "g",
    "I_rated",
    "I_min",
)

SSSC = np.dtype([("offset", "i8"), *((name, "f8") for name in FIELDS)])

_TOLERANCE = 1e-13  # p.u., of the current
_MAX_ITERATIONS = 60


class Converter(NamedTuple):
    """Algebraic variables of the converter, p.u.: current phasor and magnitude, voltages, what limits act."""

    current: complex
    magnitude: float
    v_p: float
    v_q: float
    e_ac: float
    e_dc: float
    ac_limited: bool
    dc_limited: bool
    blocked: bool


def row(device: Sssc, offset: int) -> Any:
    """A row of SSSC."""
    made = np.zeros((), SSSC)
    made["offset"] = offset
    for name in FIELDS:
        made[name] = getattr(device, name)
    return made


def start(device: Sssc, magnitude: float) -> NDArray[np.float64]:
    """States at rest with no injection, at rated DC voltage and a current's magnitude (p.u.).

    The converter makes up for its transformer, s_q = -xs |I|, and draws what the DC link loses,
    s_p |I| = g. Raises `InputError` where its limits do not admit that.
    """
    if magnitude < device.I_min:
        raise InputError(
            f"devices: {device.name} carries {magnitude:.3g} p.u. at the start; "
            f"allowed: at least I_min, {device.I_min:g}"
        )
    share = min(1.0, device.I_rated / magnitude)
    s_p, s_q = device.g / magnitude, device.xs * magnitude
    if s_p > device.vp_max or s_p**2 + s_q**2 > device.vc_max**2:
        raise InputError(
            f"devices: {device.name} needs converter voltages of {s_p:.4g} (active) and {s_q:.4g} p.u. (reactive) "
            f"at the start; allowed: vp_max {device.vp_max:g}, vc_max {device.vc_max:g} in all"
        )
    return np.array([0.0, s_p / share, 1.0])


@compiled
def _voltages(d: Any, x: NDArray[np.float64], u: float, magnitude: float) -> tuple[float, float, bool, bool]:
    """Converter voltages (v_p, v_q) at a current's magnitude, and whether the AC and the DC limit act.

    The injected-voltage regulator feeds its own output back (e_ac = u - v_q - xs |I|), so its equation
    s_q = u + Kp e_ac + x_ac - xs |I| is solved for s_q first; a limited s_q is what the limit says.
    """
    o = d.offset
    vdc = x[o + 2]
    s_p = min(1.0, d.I_rated / magnitude) * (d.Kd * (1.0 - vdc) + x[o + 1])
    dc_limited = abs(s_p) > d.vp_max
    s_p = min(max(s_p, -d.vp_max), d.vp_max)
    drop = d.xs * magnitude
    s_q = (u + d.Kp * (u - drop) + x[o] - drop) / (1.0 + d.Kp * vdc)
    room = math.sqrt(d.vc_max * d.vc_max - s_p * s_p)
    ac_limited = abs(s_q) > room
    s_q = min(max(s_q, -room), room)
    return s_p * vdc, s_q * vdc, ac_limited, dc_limited


@compiled
def converter(d: Any, x: NDArray[np.float64], u: float, open_circuit: complex, impedance: complex) -> Converter:
    """Solve the converter against the network's Thevenin equivalent at its two buses, p.u.

    With Y = 1 / (Zth + rs + j xs), I0 = Y Voc and a = Y (v_p + j v_q): |I| = sqrt(|I0|^2 - Im(a)^2) - Re(a),
    arg I = arg I0 - arg(|I| + a). The voltages depend on |I| through xs |I| and the rated current, weakly,
    so a fixed-point iteration on |I| converges by about two digits a turn. No solution, or |I| < I_min:
    blocked, v = 0.
    """
    admittance = 1.0 / (impedance + complex(d.rs, d.xs))
    short = admittance * open_circuit
    most = abs(short)
    vdc = x[d.offset + 2]
    magnitude = most
    if most >= d.I_min:
        for _ in range(_MAX_ITERATIONS):
            v_p, v_q, ac_limited, dc_limited = _voltages(d, x, u, magnitude)
            a = admittance * complex(v_p, v_q)
            if abs(a.imag) > most:
                break
            found = math.sqrt(most * most - a.imag * a.imag) - a.real
            if found < d.I_min:
                break
            change = abs(found - magnitude)
            magnitude = found
            if change <= _TOLERANCE * most:
                turned = complex(magnitude, 0.0) + a
                current = short * (magnitude / most) * (turned.conjugate() / abs(turned))
                e_ac = u - v_q - d.xs * magnitude
                return Converter(current, magnitude, v_p, v_q, e_ac, 1.0 - vdc, ac_limited, dc_limited, False)
    return Converter(short, most, 0.0, 0.0, 0.0, 0.0, True, True, True)


@compiled
def derivatives(d: Any, x: NDArray[np.float64], c: Converter, dx: NDArray[np.float64]) -> None:
    """Write the derivatives of the states, 1/s.

    dx_ac = Ki e_ac, dx_dc = Kdi (1 - vdc), each frozen while its output is limited;
    dvdc = (v_p |I| - g vdc^2) / (tau vdc): what the converter draws charges the DC link or is lost.
    """
    o = d.offset
    vdc = x[o + 2]
    dx[o] = 0.0 if c.ac_limited else d.Ki * c.e_ac
    dx[o + 1] = 0.0 if c.dc_limited else d.Kdi * c.e_dc
    dx[o + 2] = (c.v_p * c.magnitude - d.g * vdc * vdc) / (d.tau * vdc)
