"""Table of device kinds with their compiled functions."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from facts_damping.compiling import branching, compiled
from facts_damping.extensions import rows
from facts_damping.plant.converters import bess, exciter_input, hvdc, load_modulation, sssc, statcom, svc, tcsc
from facts_damping.plant.watchdog import WATCHDOG
from facts_damping.signals import to_ns

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from facts_damping.compiling.structs import Float1
    from facts_damping.parameters.plant.devices import Series
    from facts_damping.parameters.plant.system import Device
    from facts_damping.plant.converters.site import Site, Start


@compiled
def _no_more(_d: Any, _x: Float1, _u: float, _size: float, _blocked: bool, _out: Any) -> None:
    """No true values in addition to the port's."""


@compiled
def _at_rest(_d: Any, _x: Float1, _u: float, _size: float, _dx: Float1) -> None:
    """No states."""


class OtherEnd(NamedTuple):
    """A device's port at a second bus: functions of the voltage there, for its states that depend on it."""

    characteristic: Callable[..., tuple[complex, complex]]
    derivatives: Callable[..., None]


class DeviceKind(NamedTuple):
    """A kind of device: fields of its table, names of its states, its initial state, and its functions.

    Arguments of the compiled functions: `d`, a row of DEVICE (the kind's own fields are in the field of its name); `x`,
    the plant's states; `u`, the reference after the response time; `size`, the magnitude of the port's response
    (current in series, bus voltage in parallel); p.u. For the power flow: `losses(device, |I|)`, resistance equivalent
    to the losses of a series device (p.u.); `consumed_power(device, |V|, base)`, power of a parallel device from each
    of its buses at rest, P + j Q (p.u. of the base, MVA).
    """

    table: np.dtype[Any]
    states: list[str]
    start: Callable[[Any, Site], Start]
    characteristic: Callable[..., tuple[complex, complex]]  # (d, x, u, size): its source, and the derivative by size
    derivatives: Callable[..., None]  # (d, x, u, size, dx), 1/s
    truth: Callable[..., None] = _no_more  # (d, x, u, size, blocked, out): true values in addition to the port's
    losses: Callable[[Any, float], float] | None = None
    consumed_power: Callable[[Any, Sequence[float], float], list[complex]] | None = None
    other_end: OtherEnd | None = None
    integrals: Sequence[str] = ()  # states that are integrals and act on nothing near rest


KINDS = {
    "sssc": DeviceKind(
        sssc.SSSC, sssc.STATE_NAMES, sssc.start, sssc.characteristic, sssc.derivatives, sssc.truth, sssc.losses
    ),
    "statcom": DeviceKind(
        statcom.STATCOM,
        statcom.STATE_NAMES,
        statcom.start,
        statcom.characteristic,
        statcom.derivatives,
        statcom.truth,
        consumed_power=statcom.consumed_power,
    ),
    "svc": DeviceKind(svc.SVC, svc.STATE_NAMES, svc.start, svc.characteristic, svc.derivatives, svc.truth),
    "hvdc": DeviceKind(
        hvdc.HVDC,
        hvdc.STATE_NAMES,
        hvdc.start,
        hvdc.to_end,
        hvdc.derivatives,
        consumed_power=hvdc.consumed_power,
        other_end=OtherEnd(hvdc.from_end, hvdc.from_derivatives),
    ),
    "load_modulation": DeviceKind(
        load_modulation.LOAD_MODULATION, [], load_modulation.start, load_modulation.characteristic, _at_rest
    ),
    "bess": DeviceKind(
        bess.BESS,
        bess.STATE_NAMES,
        bess.start,
        bess.characteristic,
        bess.derivatives,
        bess.truth,
        integrals=bess.STATE_NAMES,
    ),
    "tcsc": DeviceKind(tcsc.TCSC, tcsc.STATE_NAMES, tcsc.start, tcsc.characteristic, tcsc.derivatives, tcsc.truth),
    "exciter_input": DeviceKind(
        exciter_input.EXCITER_INPUT, [], exciter_input.start, exciter_input.characteristic, _at_rest
    ),
}
KINDS |= rows("device_kinds", DeviceKind, KINDS)
CODES = {name: code for code, name in enumerate(KINDS)}  # codes in compiled functions

# A device: its ports (-1: none, at a machine; `other`, at a second bus; 0: none), kind and states, its dead time, the
# state and time constant of its response (0: none), the limits of its setpoint and of the rate of its reference, its
# watchdog, and the row of its kind's table; those of the other kinds are empty.
DEVICE = np.dtype(
    [
        *((name, "i8") for name in ("port", "other", "kind", "offset", "states", "dead_ns", "lag")),
        *((name, "f8") for name in ("setpoint_max", "rate_max", "response_time")),
        ("watchdog", WATCHDOG),
        *((name, kind.table) for name, kind in KINDS.items()),
    ]
)


def install(row: Any, device: Device, site: Site) -> Start:
    """Fill a row of DEVICE, except its port, with a device at rest."""
    kind = KINDS[device.kind]
    start = kind.start(device, site)
    row["kind"], row["offset"], row["states"] = CODES[device.kind], site.offset, len(kind.states)
    row["setpoint_max"], row["rate_max"] = device.setpoint_max, device.rate_max
    row["dead_ns"], row["response_time"] = to_ns(device.dead_time), device.response_time
    row["lag"] = site.offset + len(kind.states)
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
_other_ends = [kind.other_end or OtherEnd(_unknown, _at_rest) for kind in KINDS.values()]
characteristic = branching([*(kind.characteristic for kind in KINDS.values()), _unknown])
derivatives = branching([kind.derivatives for kind in KINDS.values()])
truth = branching([kind.truth for kind in KINDS.values()])
other_characteristic = branching([*(end.characteristic for end in _other_ends), _unknown])
other_derivatives = branching([end.derivatives for end in _other_ends])
