"""Devices in the plant: their rows, and the compiled functions of their kinds."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from facts_damping.compiling import branching, compiled
from facts_damping.devices.kind import OtherEnd, at_rest
from facts_damping.devices.table import KINDS
from facts_damping.plant.watchdog import WATCHDOG
from facts_damping.signals import to_ns

if TYPE_CHECKING:
    from collections.abc import Sequence

    from facts_damping.compiling.structs import Float1
    from facts_damping.devices.base import Series
    from facts_damping.devices.kind import Site, Start
    from facts_damping.parameters.plant.system import Device


CODES = {name: code for code, name in enumerate(KINDS)}  # codes in compiled functions

# A device: its ports (-1: none, at a machine or inverter; `other`, at a second bus; 0: none), the machine, or the
# inverter and its signal, at which it acts, kind, states, dead time, the state and time constant of its response (0:
# none), the limits of its setpoint and of the rate of its reference, its watchdog, and the row of its kind's table;
# those of the other kinds are empty.
DEVICE = np.dtype(
    [
        *((name, "i8") for name in ("port", "other", "machine", "inverter", "input")),
        *((name, "i8") for name in ("kind", "offset", "states", "dead_ns", "lag")),
        *((name, "f8") for name in ("setpoint_max", "rate_max", "response_time")),
        ("watchdog", WATCHDOG),
        *((name, kind.table) for name, kind in KINDS.items()),
    ]
)


def install(row: Any, device: Device, site: Site) -> Start:
    """Fill a row of DEVICE, except its port, with a device at rest."""
    kind = KINDS[device.kind]
    start = kind.start(device, site)
    row["kind"], row["offset"], row["states"] = CODES[device.kind], site.offset, len(start.states)
    row["setpoint_max"], row["rate_max"] = device.setpoint_max, device.rate_max
    row["machine"], row["inverter"] = site.machine, site.inverter
    row["dead_ns"], row["response_time"] = to_ns(device.dead_time), device.response_time
    row["lag"] = site.offset + len(start.states)
    row[device.kind] = start.row
    return start


@compiled
def reference_of(reference: Float1, d: int) -> float:
    """Reference of device d, p.u.; 0 for uncommanded devices in service."""
    return reference[d] if d < reference.size else 0.0


def losses_of(device: Series, magnitude: float) -> float:
    """Resistance equivalent to the losses of a series device at a current, p.u."""
    losses = KINDS[device.kind].losses
    return losses(device, magnitude) if losses else 0.0


def consumed_power(device: Device, voltages: Sequence[float], base_power: float) -> list[complex]:
    """Power of a parallel device from each of its buses at rest, P + j Q, p.u. of the base (MVA)."""
    power = KINDS[device.kind].consumed_power
    return power(device, voltages, base_power) if power else [0j] * len(voltages)


@compiled
def _unknown(_d: Any, _x: Float1, _u: float, _size: float) -> tuple[complex, complex]:
    """Unknown kind: returns NaN, which ends the run."""
    return complex(math.nan, math.nan), 0j


# Compiled functions of a kind's code and the arguments of `DeviceKind`.
_other_ends = [kind.other_end or OtherEnd(_unknown, at_rest, at_rest) for kind in KINDS.values()]
characteristic = branching([*(kind.characteristic for kind in KINDS.values()), _unknown])
derivatives = branching([kind.derivatives for kind in KINDS.values()])
truth = branching([kind.truth for kind in KINDS.values()])
other_characteristic = branching([*(end.characteristic for end in _other_ends), _unknown])
other_derivatives = branching([end.derivatives for end in _other_ends])
between_derivatives = branching([end.between for end in _other_ends])
