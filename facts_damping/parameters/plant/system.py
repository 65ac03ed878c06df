"""A power system as data: the tables of a file under `config/systems`, and what their rows say of each other."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any, Literal, Union

from pydantic import Field, model_validator

from facts_damping.devices.base import AtInverter, AtMachine, Parallel, Series, Transmission
from facts_damping.devices.table import MODELS
from facts_damping.fields import PHYSICAL, Name, ParameterModel, quantity
from facts_damping.parameters.plant.grid import Bus, InfiniteBus, Line, Load, Shunt, Transformer
from facts_damping.parameters.plant.inverter_shares import InverterShare, replaced
from facts_damping.parameters.plant.inverters import Inverter, InverterControl, Meter
from facts_damping.parameters.plant.machines import Exciter, Governor, Machine, Stabiliser
from facts_damping.parameters.plant.pmus import Measures, Pmu, Signal

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    Device = Series | Parallel | Transmission | AtMachine | AtInverter
else:
    Device = Annotated[Union[tuple(MODELS.values())], Field(discriminator="kind")]  # noqa: UP007 (made from the table)


class System(ParameterModel):
    """A power system: all that does not change from run to run. See [system files](system_files.md)."""

    name: Name = Field(..., description="name of the system; shipped scenarios are found under this name")
    description: str = Field("", description="text that `facts-damping list systems` and `modes` show")
    base_power: float = quantity(100.0, "MVA", "system base", gt=0, le=1e5)
    frequency: float = quantity(60.0, "Hz", "nominal frequency", ge=10, le=400)
    line_model: Literal["pi", "distributed"] = Field(
        "pi", description="model of lines; `distributed`: with the correction for long lines"
    )
    ranges: Literal["usual", "physical"] = Field("usual", description="`physical`: only what equations need")
    step: float = quantity(1 / 480, "s", "longest step of the integrator", ge=1e-5, le=0.02)
    buses: list[Bus] = Field(..., min_length=1, description="nodes of the network, at least one")
    lines: list[Line] = Field([], description="transmission lines")
    transformers: list[Transformer] = Field([], description="two-winding transformers")
    loads: list[Load] = Field([], description="loads that depend on voltage and frequency")
    shunts: list[Shunt] = Field([], description="capacitors and reactors")
    infinite_buses: list[InfiniteBus] = Field([], description="buses of constant voltage")
    machines: list[Machine] = Field([], description="synchronous machines")
    inverters: list[Inverter] = Field([], description="inverters of solar, wind and battery plants")
    inverter_controls: list[InverterControl] = Field([], description="controls of inverters")
    inverter_shares: list[InverterShare] = Field([], description="shares of machines that inverters replace")
    exciters: list[Exciter] = Field([], description="excitation systems, at most one per machine")
    stabilisers: list[Stabiliser] = Field([], description="power system stabilisers, at most one per machine")
    governors: list[Governor] = Field([], description="turbines with governors, at most one per machine")
    devices: list[Device] = Field([], description="devices that a run can install")
    pmus: list[Pmu] = Field(..., min_length=1, description="PMUs, at least one")
    signals: dict[Name, Signal] = Field({}, description="name: signal that controllers may receive")
    measures: Measures = Field(Measures(), description="speed differences for the performance indices")

    @model_validator(mode="wrap")
    @classmethod
    def _consistent(cls, content: Any, validated: Callable[[Any], System]) -> System:
        before = PHYSICAL.set(isinstance(content, dict) and content.get("ranges") == "physical")
        try:
            system = validated(content)._with_inverters()  # noqa: SLF001 (its own)
        finally:
            PHYSICAL.reset(before)
        _check_references(system)
        return system

    def _with_inverters(self) -> System:
        """The system with machines and inverters as its shares say, and without shares."""
        if not self.inverter_shares:
            return self
        new = replaced(self.machines, self.inverter_shares)
        rows = {
            **{field: [row for row in getattr(self, field) if row.machine not in new.gone]
               for field in ("exciters", "stabilisers", "governors")},
            "inverter_shares": [],
            "machines": new.machines,
            "inverters": [*self.inverters, *new.inverters],
            "inverter_controls": [*self.inverter_controls, *new.controls],
            "devices": [d for d in self.devices if getattr(d, "inverter", None) not in new.absent],
            "pmus": [p.model_copy(update={"machine": new.gone.get(str(p.machine), p.machine)})
                     for p in self.pmus if p.machine not in new.absent],
        }  # fmt: skip
        moved = {p.name for p in self.pmus if p.machine in new.gone}  # to where there is no rotor, but a frequency
        seen = {name: s.model_copy(update={"channel": "frequency"}) for name, s in self.signals.items()
                if s.channel == "speed_deviation" and moved & set(s.weights)}  # fmt: skip
        return self.model_copy(update={**rows, "signals": self.signals | seen})

    @property
    def units(self) -> list[Any]:
        """Machines, then inverters."""
        return [*self.machines, *self.inverters]

    @property
    def meters(self) -> list[Meter]:
        """Where plant controls of inverters measure, apart from the inverters' terminals."""
        at = [(c, c.bus) for c in self.inverter_controls if c.enabled]
        return [Meter(c.inverter, bus, [c.branch] if c.branch else []) for c, bus in at if bus is not None]

    def branch_ends(self) -> list[tuple[str, tuple[str, str]]]:
        """Name of each line, transformer and device in series, and its buses."""
        joined: list[Line | Transformer] = [*self.lines, *self.transformers]
        ends = [(row.name, (row.from_bus, row.to_bus)) for row in joined]
        return ends + [(d.name, d.ends) for d in self.devices if isinstance(d, Series)]

    def pmu_buses(self) -> dict[str, str]:
        """The bus at which each PMU measures, by its name."""
        buses = {unit.name: unit.bus for unit in self.units}
        return {s.name: s.bus or buses[s.machine or ""] for s in self.pmus}

    def device(self, name: str) -> Device:
        """The device of a name."""
        return next(device for device in self.devices if device.name == name)

    def buses_of(self, device: Device) -> list[str]:
        """The buses at or between which a device stands; that of its machine or inverter."""
        if isinstance(device, Series):
            return list(device.ends)
        return device.buses or [unit.bus for unit in self.units if unit.name == device.place]


def _unique(field: str, names: Iterable[str]) -> set[str]:
    """The names as a set; a name that stands twice is an error."""
    unique: set[str] = set()
    for name in names:
        if name in unique:
            raise ValueError(f"{field}: '{name}' stands twice; allowed: each name once")
        unique.add(name)
    return unique


def _known(field: str, name: str, allowed: Iterable[str]) -> None:
    """Raise `ValueError` where a name is not among those that are there."""
    if name not in allowed:
        raise ValueError(f"{field}: '{name}' given; allowed: {', '.join(sorted(allowed)) or 'none'}")


def _check_references(system: System) -> None:
    """Raise `ValueError` where a row names a bus, machine, branch, PMU or signal that is not there."""
    buses = _unique("buses", [b.name for b in system.buses])
    for field in ("loads", "shunts", "infinite_buses", "machines", "inverters"):
        _unique(field, [row.name for row in getattr(system, field)])
        for row in getattr(system, field):
            _known(f"{field}: {row.name}.bus", row.bus, buses)
    holding = [unit for unit in system.units if unit.V is not None]
    _unique("machines, inverters", [unit.name for unit in system.units])
    _unique("infinite_buses", [i.bus for i in system.infinite_buses])
    _unique("machines, infinite_buses", [*{m.bus for m in holding}, *(i.bus for i in system.infinite_buses)])
    at: dict[str, list[Any]] = {}
    for m in holding:
        at.setdefault(m.bus, []).append(m)
    for bus, here in at.items():
        if len({m.V for m in here}) > 1:
            voltages = ", ".join(f"{m.V:g} of {m.name}" for m in here)
            raise ValueError(f"machines.*.V: {voltages} given at bus {bus}; allowed: one voltage")
    joined: list[Line | Transformer] = [*system.lines, *system.transformers]
    _unique("lines, transformers, devices", [row.name for row in (*joined, *system.devices)])
    for branch in joined:
        _check_ends(f"lines, transformers: {branch.name}", branch.from_bus, branch.to_bus, buses)
    _check_devices(system, buses)
    _check_machines(system)
    _check_inverters(system, buses)
    _check_measurements(system, buses)


def _check_ends(field: str, from_bus: str, to_bus: str, buses: set[str]) -> None:
    _known(f"{field}.from", from_bus, buses)
    _known(f"{field}.to", to_bus, buses)
    if from_bus == to_bus:
        raise ValueError(f"{field}.to: '{to_bus}' given twice; allowed: two different buses")


def _check_devices(system: System, buses: set[str]) -> None:
    lines = {line.name for line in system.lines}
    devices: dict[tuple[str, ...], str] = {}  # by place
    for device in system.devices:
        if isinstance(device, Transmission):
            _check_ends(f"devices: {device.name}", device.from_bus, device.to_bus, buses)
            continue
        if isinstance(device, AtMachine):
            _known(f"devices: {device.name}.machine", device.machine, {m.name for m in system.machines})
            _check_excited(f"devices: {device.name}.machine", device.machine, {e.machine for e in system.exciters})
            continue
        if isinstance(device, AtInverter):
            _known(f"devices: {device.name}.inverter", device.inverter, {i.name for i in system.inverters})
            continue
        if not isinstance(device, Series):
            _known(f"devices: {device.name}.bus", device.bus, buses)
            continue
        if device.line is not None:
            _known(f"devices: {device.name}.line", device.line, lines)
            place: tuple[str, ...] = (device.line,)
        else:
            _check_ends(f"devices: {device.name}", *device.ends, buses)
            place = tuple(sorted(device.ends))
        if place in devices:
            problem = f"'{' to '.join(place)}' given, where {devices[place]} stands already"
            raise ValueError(f"devices: {device.name}: {problem}; allowed: one device in a line, or between two buses")
        devices[place] = device.name


def _check_excited(field: str, machine: str, excited: set[str]) -> None:
    """Raise `ValueError` for a machine without exciter."""
    if machine not in excited:
        allowed = ", ".join(sorted(excited)) or "none"
        raise ValueError(f"{field}: '{machine}' given, which has no exciter; allowed: {allowed}")


def _check_machines(system: System) -> None:
    machines = {m.name for m in system.machines}
    for field in ("exciters", "stabilisers", "governors"):
        _unique(field, [row.machine for row in getattr(system, field)])
        for i, row in enumerate(getattr(system, field)):
            _known(f"{field}.{i}.machine", row.machine, machines)
    excited = {e.machine for e in system.exciters}
    for i, stabiliser in enumerate(system.stabilisers):
        if stabiliser.enabled:
            _check_excited(f"stabilisers.{i}.machine", stabiliser.machine, excited)
    wound = {m.name for m in system.machines if m.model != "classical"}
    for i, exciter in enumerate(system.exciters):
        _known(f"exciters.{i}.machine", exciter.machine, wound)
    if len({unit.area is None for unit in system.units if unit.forming}) > 1:
        allowed = "for all, and all grid-forming inverters, or for none"
        raise ValueError(f"machines.*.area: given for some machines; allowed: {allowed}")
    if not machines and not system.infinite_buses and not any(i.forming for i in system.inverters):
        raise ValueError("machines: none given; allowed: at least one, an infinite bus, or a grid-forming inverter")
    slack = [unit.name for unit in system.units if unit.slack]
    if len(slack) != (0 if system.infinite_buses else 1):
        problem = f"{len(slack)} slack machines given ({', '.join(slack)})"
        raise ValueError(f"machines.*.slack: {problem}; allowed: exactly one, or none beside an infinite bus")


def _check_inverters(system: System, buses: set[str]) -> None:
    inverters, at = {i.name for i in system.inverters}, _branches_at(system)
    by_signal: dict[tuple[str, str], str] = {}  # the model that gives it
    for i, row in enumerate(system.inverter_controls):
        field = f"inverter_controls.{i}"
        _known(f"{field}.inverter", row.inverter, inverters)
        for signal in row.signals if row.enabled else ():
            if other := by_signal.get((row.inverter, signal)):
                problem = f"{row.model} given for {row.inverter}, which has {other}"
                raise ValueError(f"{field}: {problem}; allowed: one control of each sort")
            by_signal[row.inverter, signal] = row.model
        if row.bus is not None:
            _known(f"{field}.bus", row.bus, buses)
        if row.branch is not None:
            _known(f"{field}.branch", row.branch, at.get(row.bus, set()))
    slack = {unit.bus for unit in system.units if unit.slack}
    for inverter in system.inverters:
        if inverter.P is None and inverter.bus not in slack:
            raise ValueError(f"inverters: {inverter.name}.P: none given; allowed: at the bus of the slack")


def _branches_at(system: System) -> dict[str | None, set[str]]:
    """Names of the branches at each bus."""
    at: dict[str | None, set[str]] = {}
    for name, ends in system.branch_ends():
        for bus in ends:
            at.setdefault(bus, set()).add(name)
    return at


def _check_measurements(system: System, buses: set[str]) -> None:
    machines = {unit.name for unit in system.units}
    pmus, at = _unique("pmus", [s.name for s in system.pmus]), _branches_at(system)
    places, rotors = machines | buses, {m.name for m in system.machines}
    turning = {pmu.name for pmu in system.pmus if pmu.machine in rotors}
    for pmu in system.pmus:
        _known(f"pmus: {pmu.name}", pmu.machine or pmu.bus or "", places)
        for branch in pmu.branches:
            _known(f"pmus: {pmu.name}.branches", branch, at.get(pmu.bus, set()))
    for name, signal in system.signals.items():
        for pmu_name in signal.weights:
            _known(f"signals: {name}.weights", pmu_name, pmus)
        for pmu_name in (backup for backups in signal.backups.values() for backup in backups):
            _known(f"signals: {name}.backups", pmu_name, pmus)
        if signal.channel == "speed_deviation":
            for pmu_name in signal.weights:
                _known(f"signals: {name} (speed_deviation).weights", pmu_name, turning)
    speeds = {name for name, signal in system.signals.items() if signal.channel in ("speed_deviation", "frequency")}
    for name in (*system.measures.local, *system.measures.interarea):
        _known("measures", name, speeds)
