"""The static synchronous compensator: converter, regulators, DC link; compiled.

A current i_d + j i_q flows into the network, the d axis along the bus voltage (ideal phase-locked loop). A setpoint
is an offset of the voltage reference (thesis 2.90-2.92, 2.105-2.109; docs/facts_devices.md).
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, Literal

from facts_damping.compiling import compiled
from facts_damping.devices.base import KIND, Parallel, switch
from facts_damping.devices.kind import DeviceKind, Shown, Site, Start, table
from facts_damping.errors import InputError
from facts_damping.fields import quantity

if TYPE_CHECKING:
    from collections.abc import Sequence

    from facts_damping.compiling.structs import Float1


class Statcom(Parallel):
    """A static synchronous compensator ([STATCOM](facts_devices.md)) at a bus; data on the system base.

    Its setpoint is an offset of its voltage reference. Integration steps are at most 1/480 s with it. One that is not
    installed does nothing.
    """

    kind: Literal["statcom"] = KIND
    R: float = quantity(0.0073, "p.u.", "resistance of the coupling transformer", ge=0, le=10)
    L: float = quantity(0.22, "p.u.", "reactance of the coupling transformer", gt=0, le=10)
    setpoint_max: float = quantity(
        ..., "p.u.", "limit of the setpoint, an offset of the voltage reference", usual=0.1, gt=0, le=1
    )
    rate_max: float = quantity(..., "p.u./s", "rate limit of the setpoint", usual=10, gt=0, le=1000)
    I_max: float = quantity(..., "p.u.", "limit of the active and of the reactive current", usual=1, gt=0, le=1000)
    Kp: float = quantity(
        5.0, "p.u.", "proportional gain of the AC voltage regulator: current per voltage", ge=0, le=1000
    )
    Ki: float = quantity(1000.0, "p.u./s", "integral gain of the AC voltage regulator", ge=0, le=1e5)
    droop: float = quantity(0.0, "p.u.", "slope of the voltage: voltage per reactive current", ge=0, le=1)
    Kd: float = quantity(
        4.0, "p.u.", "proportional gain of the DC voltage regulator: current per voltage", ge=0, le=1000
    )
    Kdi: float = quantity(80.0, "p.u./s", "integral gain of the DC voltage regulator", ge=0, le=1e5)
    Kc: float = quantity(0.3, "p.u.", "proportional gain of the current regulator", ge=0, le=100)
    Kci: float = quantity(10.0, "p.u./s", "integral gain of the current regulator", ge=0, le=1e4)
    Kf: float = quantity(0.22, "p.u.", "current regulator: feed-forward of the transformer's voltage", ge=0, le=10)
    tau: float = quantity(0.006, "s", "time constant of the DC link, C V^2 / S on the system base", ge=0.001, le=10)
    g: float = quantity(0.0, "p.u.", "conductance of the DC link, for losses", ge=0, le=10)
    enforce_rating: bool = switch("true: `I_max` limits the whole current, with priority for the active part")
    V_min: float = quantity(0.05, "p.u.", "voltage of its bus below which the converter is blocked", gt=0, le=0.9)


STATES = ["id", "iq", "vdc", "x_ac", "x_dc", "x_d", "x_q"]
FIELDS = ("R", "L", "I_max", "Kp", "Ki", "droop", "Kd", "Kdi", "Kc", "Kci", "Kf", "tau", "V_min", "g")
TABLE = table("whole", "omega_0", "Vref", *FIELDS)


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
    fields = (getattr(device, name) for name in FIELDS)
    row = (site.offset, float(device.enforce_rating), site.omega_0, site.size, *fields)
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
    if d.whole > 0.0:
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


SHOWN = Shown(
    "STATCOM (static synchronous compensator)",
    "offset of the voltage reference",
    "raises the bus voltage",
    marker="D",
    outline="M0,-1.3L1.3,0L0,1.3L-1.3,0Z",
)
ROW = DeviceKind(
    TABLE,
    STATES,
    start,
    characteristic,
    derivatives,
    truth,
    consumed_power=consumed_power,
    model=Statcom,
    shown=SHOWN,
    new={},
    step=1 / 480,
)
