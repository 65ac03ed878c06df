"""Linear models of new devices, each alone behind the response that its place in the grid has at rest."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from facts_damping.compiling.structs import Table
from facts_damping.devices.base import Series
from facts_damping.devices.kind import Site
from facts_damping.errors import FactsDampingError, one_line
from facts_damping.numerics.phasors import exponentials
from facts_damping.plant.converters import dispatch
from facts_damping.plant.converters.site import DEVICE, PORT
from facts_damping.plant.model import PlantState
from facts_damping.plant.watchdog import initial_watch, line
from facts_damping.small_signal import descriptor

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from facts_damping.compiling.structs import Complex1, Complex3, Float1, Float2, Float3
    from facts_damping.parameters.plant.system import Device
    from facts_damping.plant.model import Plant

AT_ONCE = 100  # devices in one plant
# Tables of a plant: of its units, and of intervals by units.
OF_UNITS = (
    *("machines", "exciters", "stabilisers", "governors", "blocks", "controls", "inverters", "loads"),
    *("oscillations", "infinite", "pmu_machine"),
)
BY_UNIT = ("mechanical_power", "online", "island", "load_scale")


class Alone(NamedTuple):
    """dx = A x + B r + b u, s = C x + D r + d u of devices of a kind; r, s: response and source, real and imaginary.

    `D` contains the impedance of a device in series, so s is its whole voltage drop.
    """

    A: Float3  # (devices, states, states)
    B: Float3  # (devices, states, 2)
    b: Float2  # (devices, states)
    C: Float3  # (devices, 2, states)
    D: Float3  # (devices, 2, 2)
    d: Float2  # (devices, 2)
    dead_time: Float1  # (devices,), s

    def at(self, s: Complex1) -> tuple[Complex3, Complex3]:
        """Transfer functions from response and from setpoint to source, each device at its own s (1/s)."""
        turned = s[:, None, None] * np.eye(self.A.shape[1]) - self.A
        answer: Complex3 = self.C @ np.linalg.solve(turned, np.concatenate([self.B, self.b[:, :, None]], axis=2))
        late = exponentials(-s * self.dead_time)
        from_response: Complex3 = self.D + answer[:, :, :2]
        return from_response, (self.d[:, :, None] + answer[:, :, 2:]) * late[:, None, None]


class AtRest(NamedTuple):
    """A device at rest, or why it cannot stand where it was to stand."""

    row: np.void
    states: list[float]
    minimum: float = 0.0
    maximum: float = np.inf
    why_not: str = ""


def at_rest(device: Device, response: complex, omega_0: float, base_power: float) -> AtRest:
    """A device behind a response of its port (p.u.)."""
    row, size = np.zeros(1, dispatch.DEVICE), abs(response)
    try:
        start = dispatch.install(row[0], device, Site(0, omega_0, size, size, base_power, angle=0.0))
    except FactsDampingError as error:
        return AtRest(row[0], [], why_not=one_line(error))
    lag = [0.0] if device.response_time > 0.0 else []
    return AtRest(row[0], [*start.states, *lag], start.minimum, start.maximum)


def linear(plant: Plant, devices: Sequence[Device], rest: Sequence[AtRest], responses: Complex1) -> Alone:
    """Devices of a kind that can stand at their places, in a grid of this plant."""
    batches = [
        _linear(plant, devices[i : i + AT_ONCE], rest[i : i + AT_ONCE], responses[i : i + AT_ONCE])
        for i in range(0, len(devices), AT_ONCE)
    ]
    return Alone(*(np.concatenate(matrices) for matrices in zip(*batches, strict=True)))


def _linear(plant: Plant, devices: Sequence[Device], rest: Sequence[AtRest], responses: Complex1) -> Alone:
    many, n = len(devices), len(rest[0].states)
    placed = np.array([each.row for each in rest])
    of_kind, first = placed[devices[0].kind], n * np.arange(many)
    for table, field in ((placed, "offset"), (placed, "lag"), (of_kind, "offset")):
        table[field] += first
    placed["port"] = np.arange(many)
    ports = np.array([(DEVICE, i, each.minimum, each.maximum) for i, each in enumerate(rest)], PORT)
    state = PlantState(
        np.array([value for each in rest for value in each.states]),
        *(np.zeros(many), np.zeros(many), initial_watch(many)),
        *(np.zeros(many, np.complex128), np.zeros((3, many), np.complex128)),
        *line([0.0] * many),
    )
    jacobian, _ = descriptor.local_parts(_of_devices(plant, placed, ports), state, responses)
    at, both = np.arange(many)[:, None], np.arange(2)
    of_states, of_ports = n * at + np.arange(n), n * many + many * both + at
    rows, columns = np.hstack([of_states, of_ports]), np.hstack([of_states, of_ports, (n + 2) * many + at])
    whole = jacobian.toarray()[rows[:, :, None], columns[:, None, :]]
    D = whole[:, n:, n : n + 2] + np.array([_impedance(device) for device in devices])
    dead = np.array([device.dead_time for device in devices])
    B, b = whole[:, :n, n : n + 2], whole[:, :n, n + 2]
    return Alone(whole[:, :n, :n], B, b, whole[:, n:, :n], D, whole[:, n:, n + 2], dead)


def _of_devices(plant: Plant, placed: NDArray[Any], ports: NDArray[Any]) -> Plant:
    """The plant with these devices alone."""
    units = {name: getattr(plant, name)[:0] for name in OF_UNITS}
    by_unit = {name: getattr(plant, name)[:1, :0] for name in BY_UNIT}
    return plant._replace(
        **units,
        **by_unit,
        placed=placed,
        devices=placed,
        ports=ports,
        interval_start_ns=plant.interval_start_ns[:1],
        load_noise=plant.load_noise[:, :0],
        sparse_networks=Table([]),
    )


def _impedance(device: Device) -> Float2:
    """Of a device in series, by real and imaginary part, p.u."""
    rs, xs = (device.rs, device.xs) if isinstance(device, Series) else (0.0, 0.0)
    return np.array([[rs, -xs], [xs, rs]])
