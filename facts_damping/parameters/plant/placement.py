"""Where devices stand that are placed by a line: at a bus of their own, next to an end of that line."""

from __future__ import annotations

from typing import TYPE_CHECKING

from facts_damping.devices.base import Series
from facts_damping.errors import InputError
from facts_damping.parameters.plant.grid import Bus

if TYPE_CHECKING:
    from facts_damping.parameters.plant.system import System

BESIDE = 0.15  # of its line, where the bus of a device stands in the one-line diagram


def place(system: System) -> System:
    """The system with every device in series between two buses.

    One that is placed by a line stands between that end of the line and a new bus, `LINE.DEVICE`, at which the
    line ends from then on. PMUs that measured the line's flow at this end measure the device's.
    """
    for device in system.devices:
        if isinstance(device, Series) and device.line is not None:
            system = _insert(system, device)
    return system


def _insert(system: System, device: Series) -> System:
    at = next(i for i, line in enumerate(system.lines) if line.name == device.line)
    line, name = system.lines[at], f"{device.line}.{device.name}"
    bus, side = (line.from_bus, "from_bus") if device.end == "from" else (line.to_bus, "to_bus")
    ends = (bus, name) if device.end == "from" else (name, bus)
    if name in {b.name for b in system.buses}:
        raise InputError(f"devices: {device.name}: makes a bus '{name}', which exists already; allowed: another name")
    voltage = next(b.nominal_voltage for b in system.buses if b.name == bus)
    places = {b.name: b.position for b in system.buses}
    near, far = places[bus], places[line.to_bus if device.end == "from" else line.from_bus]
    position = None if near is None or far is None else [a + BESIDE * (b - a) for a, b in zip(near, far, strict=True)]
    placed = device.model_copy(update={"line": None, "from_bus": ends[0], "to_bus": ends[1]})
    return system.model_copy(
        update={
            "buses": [*system.buses, Bus(name=name, nominal_voltage=voltage, position=position)],
            "lines": [*system.lines[:at], line.model_copy(update={side: name}), *system.lines[at + 1 :]],
            "devices": [placed if d.name == device.name else d for d in system.devices],
            "pmus": [
                s.model_copy(update={"branches": [device.name if b == line.name else b for b in s.branches]})
                if s.bus == bus
                else s
                for s in system.pmus
            ],
        }
    )
