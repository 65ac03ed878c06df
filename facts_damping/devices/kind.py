"""What a kind of device is: the row that each file of this folder ends with."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from facts_damping.compiling import compiled

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from facts_damping.compiling.structs import Float1
    from facts_damping.devices.base import DeviceModel


class Site(NamedTuple):
    """Location of a device in the solved power flow."""

    offset: int  # index of its states in the plant's
    omega_0: float  # rad/s
    size: float  # p.u., response of its port: current in series, bus voltage in parallel
    other: float = math.nan  # p.u., voltage of its second bus
    base_power: float = math.nan  # MVA
    machine: int = -1  # index of the machine or inverter of a device without a port
    inverter: int = -1
    angle: float = math.nan  # rad, by which its second bus leads its first


class Start(NamedTuple):
    """A device at rest: the row of its kind's table, its states, and the range of responses without blocking."""

    row: tuple[Any, ...]
    states: list[float]
    minimum: float  # p.u.; 0: never for too small a response
    maximum: float = math.inf  # p.u.


def table(*fields: str) -> np.dtype[Any]:
    """Numbers of a kind's row: `offset`, index of its first state in the plant's, and fields."""
    return np.dtype([("offset", "i8"), *((name, "f8") for name in fields)])


@compiled
def first_state(d: Any, x: Float1, _u: float, _size: float, _blocked: bool, out: Any) -> None:
    """Write the first state as the state of DEVICE_TRUTH."""
    out.state = x[d.offset]


@compiled
def _no_more(_d: Any, _x: Float1, _u: float, _size: float, _blocked: bool, _out: Any) -> None:
    """No true values in addition to the port's."""


@compiled
def at_rest(_d: Any, _x: Float1, _u: float, _size: float, _dx: Float1) -> None:
    """No states."""


def without_states(_device: DeviceModel, site: Site) -> Start:
    """A device at rest that has neither states nor constants."""
    return Start((site.offset,), [], 0.0)


@compiled
def no_source(_d: Any, _x: Float1, _u: float, _size: float) -> tuple[complex, complex]:
    """No source in the network."""
    return 0j, 0j


class OtherEnd(NamedTuple):
    """A device's port at a second bus: functions of the voltage there, for its states that depend on it.

    `between(d, x, first, second, dx)`, for states that depend on the voltages of both buses, p.u.
    """

    characteristic: Callable[..., tuple[complex, complex]]
    derivatives: Callable[..., None]
    between: Callable[..., None]


class Shown(NamedTuple):
    """What people see of a kind: name, setpoint and a positive one on its page, words in panels, marks in diagrams."""

    name: str = ""
    setpoint: str = ""
    positive: str = ""
    panel: str = "voltage"  # what setpoint and reference are
    state: str = ""  # what `truth` writes as `state`; none: it writes none
    marker: str = "h"  # of Matplotlib, in the one-line diagram
    outline: str = "M-1.2,0L-.6,-1H.6L1.2,0L.6,1H-.6Z"  # in the cockpit, a path of SVG from -1 to 1


class DeviceKind(NamedTuple):
    """A kind of device: fields of its table, names of its states, its initial state, its functions, and its words.

    A device has as many of the states, the first ones, as its start has.

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
    model: type[DeviceModel] | None = None  # its fields
    shown: Shown = Shown()
    new: Mapping[str, float] | None = None  # in `design`: its fields, per reactance of its line; None: it has none
    step: float = math.inf  # s, longest step of the integrator with it
