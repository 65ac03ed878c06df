"""What a controller knows of the grid: the division in which it is ranked."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from facts_damping.control.table import kind_of
from facts_damping.devices.base import Series

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from facts_damping.case.model import Case
    from facts_damping.parameters.plant.system import System
    from facts_damping.parameters.run import Controller

OPEN, MODEL, LOCAL = "open", "model", "local"


def division_of(case: Case, *, reads_plant: bool) -> str:
    """`model` if controllers are designed or tuned on the grid's model, else `open`; `local` if their signals are near.

    `reads_plant`: a user's class has read `spec.plant`. Numbers that a user has tuned on the model do not show.
    """
    knows = MODEL if reads_plant or any(_designed(controller) for controller in case.controllers) else OPEN
    return f"{knows}, {LOCAL}" if all(_is_local(case.system, controller) for controller in case.controllers) else knows


def _designed(controller: Controller) -> bool:
    """Whether a shipped controller has anything of the model: its design, residues, or tuned parameters."""
    tuned = "@" in controller.name
    return bool(tuned or controller.scheme or kind_of(controller).design or controller.compensation != "none")


def _is_local(system: System, controller: Controller) -> bool:
    """Whether all PMUs of its signals are at its devices, or one branch away."""
    units = {unit.name: unit.bus for unit in system.units}
    at = {bus for name in controller.devices for bus in _buses(system.device(name), units)}
    branches: list[Any] = [*system.lines, *system.transformers]
    ends = [{branch.from_bus, branch.to_bus} for branch in branches]
    near = at.union(*(pair for pair in ends if pair & at))
    pmus = {pmu.name: pmu.bus or units[pmu.machine or ""] for pmu in system.pmus}
    return {pmus[name] for signal in controller.signals for name in system.signals[signal].weights} <= near


def _buses(device: Any, units: Mapping[str, str]) -> Sequence[str]:
    """Where a device stands: in series between two buses, at buses, or at a unit's."""
    if isinstance(device, Series):
        return device.ends
    return device.buses or [units[device.place]]
