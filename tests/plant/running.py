"""What the tests of the plant share: systems, events and setpoints as data, and a run from instant to instant."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from facts_damping.case.loading import load_system
from facts_damping.devices.sssc import Sssc
from facts_damping.parameters.events import Scenario
from facts_damping.parameters.plant.system import System
from facts_damping.plant.build import Built, build
from facts_damping.plant.dynamics import derivatives
from facts_damping.plant.grid.network import series_devices
from facts_damping.plant.integration import advance
from facts_damping.plant.measurement import measure
from facts_damping.plant.model import copy, workspace
from facts_damping.signals import CHANNELS, DEVICE_TRUTH, MACHINE_TRUTH, SETPOINT, to_ns

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from numpy.typing import NDArray

    from facts_damping.parameters.events import Event

    # Effective time in s, value in p.u., and the device's index where it is not the first.
    Targets = Sequence[tuple[float, float] | tuple[float, float, int]]

FRAMES = 60  # frames/s
REFERENCES = Path(__file__).parents[2] / "config" / "references"


class Trace(NamedTuple):
    """A run at its instants; the first axis is time."""

    t: NDArray[np.float64]  # s
    x: NDArray[np.float64]
    reference: NDArray[np.float64]
    frames: NDArray[np.float64]
    machines: NDArray[Any]
    devices: NDArray[Any]
    sound: NDArray[np.bool_]

    @property
    def speeds(self) -> NDArray[np.float64]:
        """Speed deviations, p.u., (times, machines)."""
        return np.asarray(self.machines["speed_deviation"])


shipped = cache(load_system)


def changed(system: System, **fields: Any) -> System:
    """A system with other fields, checked as one that is read."""
    return System.model_validate({**system.model_dump(by_alias=True), **fields})


def with_device(name: str, **fields: Any) -> System:
    """two_area with other data of one of its devices."""
    rows = [device.model_dump(by_alias=True) for device in shipped("two_area").devices]
    return changed(shipped("two_area"), devices=[{**row, **fields} if row["name"] == name else row for row in rows])


def figures(name: str) -> NDArray[np.float64]:
    """A table of config/references."""
    return np.asarray(np.loadtxt(REFERENCES / name, delimiter=",", skiprows=1))


def ssscs(system: System) -> list[Sssc]:
    """The SSSCs of a system."""
    return [d for d in system.devices if isinstance(d, Sssc)]


def events(*rows: dict[str, Any]) -> list[Event]:
    """Events as a scenario's file lists them."""
    return Scenario.model_validate({"name": "test", "events": list(rows)}).events


def plant(system: System | str, *rows: dict[str, Any], installed: Sequence[str] | None = None) -> Built:
    """A plant with all series devices of its system installed, or those named."""
    system = shipped(system) if isinstance(system, str) else system
    return build(system, [d.name for d in series_devices(system)] if installed is None else installed, events(*rows))


def frame_times(end: float, rate: int = FRAMES) -> list[float]:
    """Times of frames up to `end`, s."""
    return [k / rate for k in range(round(end * rate) + 1)]


def table(targets: Targets) -> NDArray[Any]:
    """Setpoints as a link delivers them."""
    setpoints = np.zeros(len(targets), SETPOINT)
    for i, (time, value, *device) in enumerate(targets):
        setpoints[i]["effective_ns"], setpoints[i]["value"], setpoints[i]["device"] = to_ns(time), value, sum(device)
    return setpoints


def follow(built: Built, times: Iterable[float], targets: Targets = (), x: NDArray[np.float64] | None = None) -> Trace:
    """Advance a copy of a plant's start (or from `x`) from instant to instant, as a loop does tick by tick."""
    start = built.state.x if x is None else x
    state = copy(built.state)._replace(x=start.copy())
    work, setpoints = workspace(built.plant, state), table(targets)
    instants = np.array([to_ns(t) for t in times])
    n, pmus = len(instants), len(built.plant.pmu_machine)
    xs, references = np.zeros((n, len(state.x))), np.zeros((n, len(state.reference)))
    frames, sound = np.zeros((n, pmus, len(CHANNELS))), np.zeros(n, np.bool_)
    machines = np.zeros((n, len(built.plant.machines)), MACHINE_TRUTH)
    devices = np.zeros((n, len(built.plant.devices)), DEVICE_TRUTH)
    for k, now in enumerate(instants):
        if k:
            before = instants[k - 1]
            due = setpoints[(setpoints["effective_ns"] >= before) & (setpoints["effective_ns"] < now)]
            advance(built.plant, state, before, now, due, len(due), work)
        xs[k], references[k] = state.x, state.reference
        sound[k] = measure(built.plant, state, now, frames[k], machines[k], devices[k], work)
    return Trace(instants * 1e-9, xs, references, frames, machines, devices, sound)


def moved(built: Built, states: dict[str, float]) -> NDArray[np.float64]:
    """The start with other values of some states."""
    x = np.array(built.state.x)
    for name, value in states.items():
        x[built.state_names.index(name)] = value
    return x


def slopes(built: Built, x: NDArray[np.float64] | None = None, interval: int = 0) -> NDArray[np.float64]:
    """The derivatives dx/dt at the start, or at `x`."""
    x = built.state.x if x is None else x
    dx = np.zeros_like(x)
    state = copy(built.state)
    derivatives(built.plant, x, state.reference, state.source, interval, dx, workspace(built.plant, state))
    return dx
