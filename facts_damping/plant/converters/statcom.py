"""The static synchronous compensator: converter, regulators, DC link; compiled.

A current i_d + j i_q flows into the network, the d axis along the bus voltage (ideal phase-locked loop). A setpoint
is an offset of the voltage reference (thesis 2.90-2.92, 2.105-2.109; docs/facts_devices.md).
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from facts_damping.compiling import compiled
from facts_damping.errors import InputError
from facts_damping.plant.converters.site import Start

if TYPE_CHECKING:
    from collections.abc import Sequence

    from facts_damping.compiling.structs import Float1
    from facts_damping.parameters.plant.devices import Statcom
    from facts_damping.plant.converters.site import Site

STATE_NAMES = ["id", "iq", "vdc", "x_ac", "x_dc", "x_d", "x_q"]
STATES = len(STATE_NAMES)
FIELDS = ("R", "L", "I_max", "Kp", "Ki", "droop", "Kd", "Kdi", "Kc", "Kci", "Kf", "tau", "V_min", "g")

STATCOM = np.dtype(
    [("offset", "i8"), ("whole", "i8"), ("omega_0", "f8"), ("Vref", "f8"), *((name, "f8") for name in FIELDS)]
)


def losses_current(device: Statcom, voltage: float) -> float:
    """Active current drawn at rest to keep the DC voltage, p.u.: V i - R i^2 = g.

    Raises `InputError` if there is none within I_max.
    """
    root = voltage * voltage - 4.0 * device.R * device.g
    drawn = 2.0 * device.g / (voltage + math.sqrt(root)) if root > 0.0 else math.inf
    if drawn > device.I_max:
        raise InputError(
            f"devices: {device.name}.g: {device.g:g} given, whose losses at {voltage:.4g} p.u. of voltage need "
            f"{drawn:.4g} p.u. of current; allowed: at most I_max, {device.I_max:g}"
        )
    return drawn


def consumed_power(device: Statcom, voltages: Sequence[float], _base_power: float) -> list[complex]:
    """Power drawn from its bus at rest, p.u.: V i; R i^2 is lost in the transformer, g in the DC link."""
    return [complex(voltages[0] * losses_current(device, voltages[0]))]


def start(device: Statcom, site: Site) -> Start:
    """The device at rest: rated DC voltage, the current that covers its losses, and the matching voltage reference.

    i_d = -i, c_d = V + R i_d and c_q = L i_d, so x_dc = i, x_d = R i_d, x_q = (L - Kf) i_d.
    """
    row = (
        site.offset,
        int(device.enforce_rating),
        site.omega_0,
        site.size,
        *(getattr(device, name) for name in FIELDS),
    )
    i = losses_current(device, site.size)
    states = [0.0 - i, 0.0, 1.0, 0.0, i, 0.0 - device.R * i, 0.0 - (device.L - device.Kf) * i]
    return Start(row, states, device.V_min)


@compiled
def characteristic(device: Any, x: Float1, _u: float, _voltage: float) -> tuple[complex, complex]:
    """Current relative to the direction of the voltage, i_d + j i_q, and its derivative by |V|, p.u."""
    d = device.statcom
    return complex(x[d.offset], x[d.offset + 1]), 0j


@compiled
def derivatives(device: Any, x: Float1, u: float, voltage: float, dx: Float1) -> None:
    """Write the derivatives of the states, 1/s, at an offset u of its reference and a bus voltage |V|, p.u.

    Currents: did = omega_0 / L (c_d - V - R i_d + L i_q), diq = omega_0 / L (c_q - R i_q - L i_d).
    AC voltage: e = Vref + u - V - droop i_Q with i_Q = -i_q; i_Q* = clip(Kp e + x_ac), dx_ac = Ki e.
    DC voltage: i_P* = clip(Kd (1 - vdc) + x_dc), dx_dc = Kdi (1 - vdc).
    Current: e_d = -i_P* - i_d, e_q = -i_Q* - i_q, dx_d = Kci e_d, dx_q = Kci e_q,
    c_d = vdc (V - Kf i_q + Kc e_d + x_d), c_q = vdc (Kf i_d + Kc e_q + x_q).
    DC link: dvdc = -(c_d i_d + c_q i_q + g vdc^2) / (tau vdc). If the rating limits the total current, i_P* has
    priority and i_Q* is limited to sqrt(I_max^2 - i_P*^2): without active current the DC voltage would collapse. An
    integrator is held while its output is limited.
    """
    d = device.statcom
    o = d.offset
    i_d, i_q, vdc = x[o], x[o + 1], x[o + 2]
    e_ac = d.Vref + u - voltage + d.droop * i_q
    e_dc = 1.0 - vdc
    wanted_q = d.Kp * e_ac + x[o + 3]
    wanted_p = d.Kd * e_dc + x[o + 4]
    active = min(max(wanted_p, -d.I_max), d.I_max)
    room = d.I_max
    if d.whole == 1:
        room = math.sqrt(d.I_max * d.I_max - active * active)
    e_d = -active - i_d
    e_q = -min(max(wanted_q, -room), room) - i_q
    c_d = vdc * (voltage - d.Kf * i_q + d.Kc * e_d + x[o + 5])
    c_q = vdc * (d.Kf * i_d + d.Kc * e_q + x[o + 6])
    dx[o] = d.omega_0 / d.L * (c_d - voltage - d.R * i_d + d.L * i_q)
    dx[o + 1] = d.omega_0 / d.L * (c_q - d.R * i_q - d.L * i_d)
    dx[o + 2] = -(c_d * i_d + c_q * i_q + d.g * vdc * vdc) / (d.tau * vdc)
    dx[o + 3] = 0.0 if abs(wanted_q) > room else d.Ki * e_ac
    dx[o + 4] = 0.0 if abs(wanted_p) > d.I_max else d.Kdi * e_dc
    dx[o + 5] = d.Kci * e_d
    dx[o + 6] = d.Kci * e_q


@compiled
def truth(device: Any, x: Float1, _u: float, _voltage: float, _blocked: bool, out: Any) -> None:
    """Write its fields of DEVICE_TRUTH, in addition to current and power."""
    d = device.statcom
    out.dc_voltage = x[d.offset + 2]
