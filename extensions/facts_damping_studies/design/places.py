"""Effect of device and PMU locations on modes: every line and bus for a device, every speed and flow as a signal.

For a mode with right and left eigenvectors v, w, w v = 1 and the fastest machine's speed in v equal to one,

    observability   F C v                a signal's swing, p.u. of it per p.u. of the fastest machine's speed
    controllability w B exp(-lambda Td)  the effect of a setpoint of one p.u., 1/s

F washouts, Td dead times; the residue is their product (Kundur 1994, 12.3.4). `tried` installs a device at its location
for the analysis, so its own dynamics and its effect on the power flow are included; `at_once` finds those worth it.
"""

from __future__ import annotations

from itertools import combinations
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from facts_damping.devices.base import AtInverter, AtMachine, AtUnit, Parallel, Series
from facts_damping.devices.table import KINDS, MODELS
from facts_damping.errors import FactsDampingError, check_known, one_line
from facts_damping.machine_controls.block_models import active_blocks
from facts_damping.machine_controls.blocks import terms
from facts_damping.parameters.plant.placement import place
from facts_damping.parameters.plant.pmus import Pmu, Signal
from facts_damping.plant.build import build
from facts_damping.plant.inverters.inverter import SETPOINTS
from facts_damping.small_signal import eigenmodes, linearisation
from facts_damping.small_signal.descriptor import Descriptor, eigenvalue_near

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from facts_damping.compiling.structs import Complex1, Complex2, Float1, Float2
    from facts_damping.fields import ParameterModel
    from facts_damping.parameters.plant.machines import Machine
    from facts_damping.parameters.plant.pmus import Channel
    from facts_damping.parameters.plant.system import Device, System
    from facts_damping.small_signal.eigenmodes import Eigenmode

NEW = "damper"  # name of a new device in the system
NEW_DEVICES = {name: kind.new for name, kind in KINDS.items() if kind.new is not None}
USUAL = ("sssc", "statcom")
LONGEST = 3.0  # p.u., largest reactance of a line for a device whose data are relative to it
SPEED: Channel = "speed_deviation"
FREQUENCY: Channel = "frequency"  # in place of speeds where PMUs report none
FLOW: Channel = "active_power"
MAX_AREAS = 8  # with more areas there are too many pairs
NEAR = 0.5  # largest `eigenmodes.unlike` of the same mode


class Place(NamedTuple):
    """A candidate location `at` a line, two buses, a bus, a machine, or an inverter's input, `IBR1.Paux`.

    `own`: an existing device of the system.
    """

    device: Device
    at: str
    own: bool

    @property
    def label(self) -> str:
        """Readable name."""
        where = "at" if isinstance(self.device, Parallel | AtUnit) else "in"
        return f"{self.device.kind} {where} {self.at}"

    @property
    def names(self) -> set[str]:
        """Accepted names: its line, bus or buses, machine, inverter and input, and the name of an existing device."""
        return {self.at, self.device.place, *([self.device.name] if self.own else [])}


class Tried(NamedTuple):
    """Analysis of a location; arrays over modes, NaN for a mode that is not found again with the device."""

    place: Place
    controllability: Complex1  # (modes,), 1/s per p.u.
    observability: Complex2  # (modes, signals), with the device installed
    why_not: str = ""  # reason if a device is impossible there; then the arrays are NaN

    @property
    def residue(self) -> Complex2:
        """(modes, signals), 1/s per p.u. of the setpoint and p.u. of the signal."""
        return self.controllability[:, None] * self.observability

    @property
    def strength(self) -> Float1:
        """Effect of the device with its full setpoint, 1/s, (modes,)."""
        return np.abs(self.controllability) * float(self.place.device.setpoint_max)


def places(system: System, kinds: Sequence[str] = USUAL) -> list[Place]:
    """The system's own devices, and new ones of some kinds of NEW_DEVICES at each place.

    In series in each line without a device, in parallel at each bus without machine, inverter or device, at each
    machine with an exciter, at each input that an inverter's controls use and that has none.
    """
    present = [Place(d, _at(d), True) for d in system.devices]
    in_series = {d.line for d in system.devices if isinstance(d, Series)}
    occupied = {row.bus for row in system.infinite_buses} | {unit.bus for unit in system.units}
    occupied |= {d.bus for d in system.devices if isinstance(d, Parallel)}
    names = {d.name for d in system.devices}
    name = next(n for n in (NEW, *(f"{NEW}_{i}" for i in range(2, 100))) if n not in names)
    lines = [line.name for line in system.lines if line.name not in in_series]
    reactance = {line.name: line.x * line.length for line in system.lines}
    buses = [bus.name for bus in system.buses if bus.name not in occupied]
    occupied_inputs = [(d.inverter, d.input) for d in system.devices if isinstance(d, AtInverter)]
    inputs = [(i.name, signal) for i in system.inverters for signal in setpoints(system, i.name)]
    inputs = [at for at in inputs if at not in occupied_inputs]
    free: dict[type, list[dict[str, str]]] = {
        Series: [{"line": line} for line in lines],
        Parallel: [{"bus": bus} for bus in buses],
        AtMachine: [{"machine": e.machine} for e in system.exciters],
        AtInverter: [{"inverter": inverter, "input": signal} for inverter, signal in inputs],
    }
    new = []
    for kind in kinds:
        model, relative = MODELS[kind], NEW_DEVICES[kind]
        for where in next(wheres for base, wheres in free.items() if issubclass(model, base)):
            scale = reactance[where["line"]] if relative else 1.0
            if not 0.0 < scale <= LONGEST:  # a line that is a series capacitor itself
                continue
            data = _usual_values(model) | {key: value * scale for key, value in relative.items()}
            device = model(name=name, kind=kind, **where, **data)
            new.append(Place(device, _at(device), False))
    return [*present, *new]


def _usual_values(model: type[ParameterModel]) -> dict[str, Any]:
    """Fields that are required and have a usual value, with that."""
    extras = {name: field.json_schema_extra for name, field in model.model_fields.items()}
    return {name: extra["usual"] for name, extra in extras.items() if isinstance(extra, dict) and "usual" in extra}


def _at(device: Device) -> str:
    return f"{device.inverter}.{device.input}" if isinstance(device, AtInverter) else device.place


def setpoints(system: System, inverter: str) -> list[str]:
    """The setpoints that an inverter's controls use."""
    rows: list[Any] = [row for row in system.inverters if row.name == inverter]
    rows += [row for row in system.inverter_controls if row.inverter == inverter and row.enabled]
    used = {term.signal for row in rows for block in active_blocks(row) for term in terms(block.inputs)}
    return [name for name in SETPOINTS if name in used]


def check_place(name: str | None, candidates: Sequence[Place]) -> None:
    """Raise `InputError` for a name that no candidate has; None: none is asked for."""
    if name is not None:
        check_known("--place", name, sorted({known for candidate in candidates for known in candidate.names}))


def merged(system: System) -> System:
    """The system with equal machines at one bus, equally loaded and controlled, as one machine, named as the first.

    The modes that are left are the same: nothing outside moves such machines against each other.
    """
    fixed = {device.machine for device in system.devices if isinstance(device, AtMachine)}
    fields = ("exciters", "stabilisers", "governors")
    controls: dict[str, list[str]] = {machine.name: [] for machine in system.machines}
    for row in (row for field in fields for row in getattr(system, field)):
        controls[row.machine].append(repr(row.model_copy(update={"machine": ""})))
    groups: dict[str, list[Machine]] = {}
    for machine in system.machines:
        load = None if machine.P is None else f"{machine.P / machine.rating:.9g}"
        alike = machine.model_copy(
            update={"name": machine.name if machine.name in fixed else "", "rating": 1.0, "P": 0}
        )
        groups.setdefault(f"{alike!r} {load} {controls[machine.name]}", []).append(machine)
    first = {machine.name: group[0].name for group in groups.values() for machine in group}
    machines = [
        group[0].model_copy(
            update={
                "rating": sum(machine.rating for machine in group),
                "P": None if group[0].P is None else sum(machine.P or 0.0 for machine in group),
            }
        )
        for group in groups.values()
    ]
    rows = {field: [row for row in getattr(system, field) if first[row.machine] == row.machine] for field in fields}
    pmus = [pmu.model_copy(update={"machine": first.get(pmu.machine or "", pmu.machine)}) for pmu in system.pmus]
    return system.model_copy(update={"machines": machines, "pmus": pmus, **rows})


def with_place(system: System, chosen: Place) -> System:
    """The system with a device at a location."""
    if chosen.own:
        return system
    return system.model_copy(update={"devices": [*system.devices, chosen.device]})


def with_signals(system: System, modes: Sequence[Eigenmode], channel: Channel = SPEED) -> System:
    """The system with the usual signals for wide-area damping control, and the PMUs that they need.

    For each mode it adds the speed difference of the two machines or grid-forming inverters with the largest opposite
    swing (or the speed of the fastest, if none is opposite). It also adds the differences of areas' mean speeds,
    weighted by inertia, and the active power of each line. Existing signals are not duplicated. `channel`: SPEED, or
    FREQUENCY in its place.
    """
    letter = "w" if channel == SPEED else "f"
    pmus = {s.machine: s.name for s in system.pmus if s.machine is not None}
    used = {s.name for s in system.pmus}
    more: list[Pmu] = []
    for unit in system.units:
        if unit.forming and unit.name not in pmus:
            pmus[unit.name] = free_name(unit.name, used)
            more.append(Pmu(name=pmus[unit.name], machine=unit.name))
    weights = {
        "_".join([letter, *names]): dict(zip([pmus[name] for name in names], (1.0, -1.0), strict=False))
        for names in _opposed(modes)
    }
    means = _mean_speeds(system, pmus)
    for a, b in combinations(means, 2) if len(means) <= MAX_AREAS else ():
        weights[f"{letter}_{a}_{b}"] = {**means[a], **{pmu: -w for pmu, w in means[b].items()}}
    there = [s.weights for s in system.signals.values() if s.channel == channel]
    there += [{pmu: -w for pmu, w in combination.items()} for combination in there]
    named = set(system.signals)
    new = {
        free_name(name, named): Signal(channel=channel, weights=combination)
        for name, combination in weights.items()
        if combination not in there
    }
    measured = _measured_flows(system)
    for line in system.lines:
        if line.name not in measured:
            own_name = free_name(f"P_{line.name}", used)
            more.append(Pmu(name=own_name, bus=line.from_bus, branches=[line.name]))
            flow = Signal(channel=FLOW, weights={own_name: 1.0}, deviation=True)
            new[free_name(f"p_{line.name}", named)] = flow
    return system.model_copy(update={"pmus": [*system.pmus, *more], "signals": {**system.signals, **new}})


def _measured_flows(system: System) -> set[str]:
    """The lines whose active power is already a single signal."""
    alone = {s.name: s.branches[0] for s in system.pmus if len(s.branches) == 1}
    flows = [s for s in system.signals.values() if s.channel == FLOW and len(s.weights) == 1]
    return {alone[pmu] for flow in flows for pmu in flow.weights if pmu in alone}


def only(system: System, signals: Sequence[str], original: System) -> System:
    """The system with only these signals, without PMUs needed only by others, except those of `original`."""
    remaining = {name: system.signals[name] for name in signals}
    used = {pmu for signal in remaining.values() for pmu in signal.weights} | {s.name for s in original.pmus}
    pmus = [s for s in system.pmus if s.name in used]
    return system.model_copy(update={"signals": remaining, "pmus": pmus})


def free_name(name: str, used: set[str]) -> str:
    """An unused name, which is then added to `used`."""
    while name in used:
        name += "_"
    used.add(name)
    return name


def _opposed(modes: Sequence[Eigenmode]) -> list[tuple[str, ...]]:
    """For each mode the fastest machine or inverter, and the one with the largest opposite swing, if any."""
    pairs: dict[tuple[str, ...], None] = {}
    for mode in modes:
        first = max(mode.shape, key=lambda name: abs(mode.shape[name]))
        against = {name: (value / mode.shape[first]).real for name, value in mode.shape.items()}
        other = min(against, key=lambda name: against[name])
        pairs[(first, other) if against[other] < 0.0 else (first,)] = None
    return list(pairs)


def _mean_speeds(system: System, pmus: Mapping[str, str]) -> dict[str, dict[str, float]]:
    """By area, the inertia weights of the mean speed of its machines and forming inverters; empty without areas."""
    of_units, inertia = eigenmodes.inertias(system), dict[str, dict[str, float]]()
    for unit in system.units:
        if unit.area is not None and unit.forming:
            inertia.setdefault(unit.area, {})[pmus[unit.name]] = of_units[unit.name]
    return {area: {s: w / sum(inertias.values()) for s, w in inertias.items()} for area, inertias in inertia.items()}


def seen(system: System, modes: Sequence[Eigenmode]) -> Complex2:
    """The observability of all signals of a system without devices, (modes, signals)."""
    return _tried(system, [], modes, [mode.eigenvalue for mode in modes])[1]


class Trial(NamedTuple):
    """Input of an analysis: a location, the system with its signals, and the modes."""

    system: System
    place: Place
    modes: Sequence[Eigenmode]


def tried(trial: Trial, near: Sequence[complex] | None = None) -> Tried:
    """Analyse a location. `near`: eigenvalues of the modes with the device, about; None: all modes are found."""
    try:
        analysed = _tried(with_place(trial.system, trial.place), [trial.place.device.name], trial.modes, near)
    except FactsDampingError as error:
        return not_tried(trial, one_line(error))
    return Tried(trial.place, analysed[0][:, 0], analysed[1])


def not_tried(trial: Trial, why_not: str) -> Tried:
    """A location where a device is impossible."""
    none = np.full((len(trial.modes), 1 + len(trial.system.signals)), np.nan + 0j)
    return Tried(trial.place, none[:, 0], none[:, 1:], why_not)


def _tried(
    system: System, devices: Sequence[str], modes: Sequence[Eigenmode], near: Sequence[complex] | None = None
) -> tuple[Complex2, Complex2]:
    """Controllability (modes, devices) and observability (modes, signals) of the modes, found again with devices."""
    system = place(system)
    built = build(system, devices, [], sparse=len(devices) > 0 and near is not None)
    model = linearisation.linear_model(built, system.signals, [s.name for s in system.pmus])
    control = np.full((len(modes), len(devices)), np.nan + 0j)
    observe = np.full((len(modes), len(system.signals)), np.nan + 0j)
    vectors = _beside(model.matrix, near, exact=not devices)
    for i, wanted in enumerate(modes):
        best = _again(wanted, vectors, built.state_names, system)
        if best is None and near is not None:
            vectors = eigenmodes.eigenvectors(model.matrix)
            best = _again(wanted, vectors, built.state_names, system)
        if best is None:
            continue
        value, v, w = vectors[0][best], vectors[2][:, best], vectors[1][:, best]
        v = v / max(eigenmodes.speeds(value, v, built.state_names, system).values(), key=abs)
        w = w / (w @ v)
        observe[i] = model.gain(value) * (model.seen[0] @ v)
        control[i] = (w @ model.B) * model.late(value) if len(devices) else control[i]
    return control, observe


def _beside(
    matrix: Float2 | Descriptor, near: Sequence[complex] | None, exact: bool
) -> tuple[Complex1, Complex2, Complex2]:
    """As `eigenmodes.eigenvectors`, of a large grid the modes nearest some values; twice if these are not exact."""
    if near is None or not isinstance(matrix, Descriptor):
        return eigenmodes.eigenvectors(matrix)
    nearest = [eigenvalue_near(matrix, guess if exact else eigenvalue_near(matrix, guess)[0]) for guess in near]
    values, right, left = (np.array(part) for part in zip(*nearest, strict=True))
    return values, left.T, right.T


def _again(
    wanted: Eigenmode, vectors: tuple[Complex1, Complex2, Complex2], names: Sequence[str], system: System
) -> int | None:
    """Index of a mode that is found again among eigenvalues and their vectors; None: it is not."""
    values, left, right = vectors
    near = np.flatnonzero((values.imag > 0.0) & (np.abs(values - wanted.eigenvalue) < NEAR * abs(wanted.eigenvalue)))
    modes = [eigenmodes.mode(values[k], right[:, k], left[:, k], names, system) for k in near.tolist()]
    apart = eigenmodes.unlike([wanted], modes)[0]
    return None if apart.min(initial=1.0) > NEAR else int(near[np.argmin(apart)])
