"""The kinds of devices: a row each, and the one place where compiled functions branch on them."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from facts_damping.compiling import compiled
from facts_damping.plant import sssc, statcom, svc
from facts_damping.signals import to_ns

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from facts_damping.parameters.devices import Device, Series
    from facts_damping.plant.model import Site, Start


class DeviceKind(NamedTuple):
    """A kind of device: code, fields of its table, names of its states, where it starts, its losses in series.

    `losses(device, |I|)` is the resistance (p.u.) that stands for them in the power flow.
    """

    code: int
    table: np.dtype[Any]
    states: list[str]
    start: Callable[[Any, Site], Start]
    losses: Callable[[Any, float], float] | None = None


SSSC, STATCOM, SVC = range(3)

KINDS = {
    "sssc": DeviceKind(SSSC, sssc.SSSC, sssc.STATE_NAMES, sssc.start, sssc.losses),
    "statcom": DeviceKind(STATCOM, statcom.STATCOM, statcom.STATE_NAMES, statcom.start),
    "svc": DeviceKind(SVC, svc.SVC, svc.STATE_NAMES, svc.start),
}

FOREVER = 1 << 62  # ns

# An installed device: its port, kind and states, the limits of its setpoint and of the rate of its reference, how long
# it holds a setpoint, and the row of its kind's table; those of the other kinds are empty.
DEVICE = np.dtype(
    [
        *((name, "i8") for name in ("port", "kind", "offset", "states")),
        *((name, "f8") for name in ("v_max", "rate_max")),
        ("hold_ns", "i8"),
        *((name, kind.table) for name, kind in KINDS.items()),
    ]
)


def install(row: Any, device: Device, site: Site) -> Start:
    """Fill a row of DEVICE, but for its port, with a device at rest."""
    kind = KINDS[device.kind]
    start = kind.start(device, site)
    row["kind"], row["offset"], row["states"] = kind.code, site.offset, len(kind.states)
    row["v_max"], row["rate_max"] = device.v_max, device.rate_max
    row["hold_ns"] = FOREVER if device.hold is None else to_ns(device.hold)
    row[device.kind] = start.row
    return start


def losses_of(device: Series, magnitude: float) -> float:
    """Resistance that stands for the losses of a device in series at a current, p.u."""
    losses = KINDS[device.kind].losses
    return losses(device, magnitude) if losses else 0.0


# What follows has a branch a kind. `d` is a row of DEVICE, `x` the plant's states, `u` the reference, `size` the
# magnitude of the port's response: in series its current, in parallel its bus voltage; p.u.


@compiled
def characteristic(d: Any, x: NDArray[np.float64], u: float, size: float) -> tuple[complex, complex]:
    """What a device gives over the direction of its response, and the derivative by `size`, p.u.

    In series a voltage drop, in parallel a current into the network.
    """
    if d.kind == SSSC:
        return sssc.characteristic(d.sssc, x, u, size)
    if d.kind == STATCOM:
        return statcom.characteristic(d.statcom, x)
    if d.kind == SVC:
        return svc.characteristic(d.svc, x, size)
    return complex(math.nan, math.nan), 0j


@compiled
def derivatives(d: Any, x: NDArray[np.float64], u: float, size: float, dx: NDArray[np.float64]) -> None:
    """Write the derivatives of a device's states, 1/s."""
    if d.kind == SSSC:
        sssc.derivatives(d.sssc, x, u, size, dx)
    elif d.kind == STATCOM:
        statcom.derivatives(d.statcom, x, u, size, dx)
    elif d.kind == SVC:
        svc.derivatives(d.svc, x, u, size, dx)


@compiled
def truth(d: Any, x: NDArray[np.float64], u: float, size: float, blocked: bool, out: Any) -> None:
    """Write into a row of DEVICE_TRUTH what a kind knows better than its port: see `measurement`."""
    if d.kind == SSSC:
        sssc.truth(d.sssc, x, u, size, blocked, out)
    elif d.kind == STATCOM:
        statcom.truth(d.statcom, x, out)
