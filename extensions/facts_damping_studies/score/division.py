"""What a controller knows of the grid: the division in which it is ranked."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from facts_damping.control.table import kind_of
from facts_damping.devices.base import Series

if TYPE_CHECKING:
    from collections.abc import Mapping

    from facts_damping.case.model import Case
    from facts_damping.parameters.plant.system import System
    from facts_damping.parameters.run import Controller

OPEN, MODEL, LOCAL = "open", "model", "local"


def division_of(case: Case, *, reads_plant: bool) -> str:
    """`model` if controllers are designed or tuned on it, else `open`; `local` if their signals are from a device.

    `reads_plant`: a user's class has read `spec.plant`. Numbers that a user has tuned on the model do not show.
    """
    knows = MODEL if reads_plant or any(_designed(controller) for controller in case.controllers) else OPEN
    return f"{knows}, {LOCAL}" if all(_is_local(case.system, controller) for controller in case.controllers) else knows


def _designed(controller: Controller) -> bool:
    """Whether a shipped controller has anything of the model: its design, residues, or tuned parameters."""
    tuned = "@" in controller.name
    return bool(tuned or controller.scheme or kind_of(controller).design or controller.compensation != "none")


def _is_local(system: System, controller: Controller) -> bool:
    """Whether all PMUs of its signals are at one place of its devices, or a branch away from there."""
    units = {unit.name: unit.bus for unit in system.units}
    branches: list[Any] = [*system.lines, *system.transformers]
    ends = [{branch.from_bus, branch.to_bus} for branch in branches]
    bus_of = {pmu.name: pmu.bus or units[pmu.machine or ""] for pmu in system.pmus}
    seen = {bus_of[name] for signal in controller.signals for name in system.signals[signal].weights}
    places = [place for name in controller.devices for place in _places(system.device(name), units)]
    return any(seen <= place.union(*(pair for pair in ends if pair & place)) for place in places)


def _places(device: Any, units: Mapping[str, str]) -> list[set[str]]:
    """Buses of each place at which a device stands: an HVDC link has two."""
    if isinstance(device, Series):
        return [set(device.ends)]
    return [{bus} for bus in device.buses or [units[device.place]]]
