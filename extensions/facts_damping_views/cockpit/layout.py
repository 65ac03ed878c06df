"""What the page of a cockpit shows of a case: diagram, curves, charts, monitors, nodes."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from facts_damping.analysis.measures import measure_weights
from facts_damping.case import names
from facts_damping.devices.base import Series, Transmission
from facts_damping.devices.table import KINDS
from facts_damping.monitor_table import COUNTED, MONITORS
from facts_damping.parameters.supervision import watches
from facts_damping.plant.grid.network import Topology, admittance, at_rest, branches, device_section
from facts_damping_views.bus_places import places

if TYPE_CHECKING:
    from collections.abc import Mapping

    from facts_damping.case.model import Case
    from facts_damping.parameters.plant.system import Device, System

SMALL = 1e-6  # weights below are left out of a sum
ANGLES = 24  # most machines in the chart of angles
MEASURES = 4  # most differences of frequencies whose modes are estimated
PLANT, RECORDER = "plant_sim", "recorder"  # names of nodes that every graph has


class Curve(NamedTuple):
    """A value over time: a sum of columns of a record (`record.Record.arrays`, `samples.latencies`) by weight."""

    label: str
    unit: str
    group: str
    parts: Mapping[str, float]  # empty: not a sum, but estimated (`Mode.damping`)
    offset: float = 0.0


class Mode(NamedTuple):
    """A difference of frequencies whose modes are estimated while the run goes on; indices of two curves."""

    label: str
    signal: int
    damping: int


class Panel(NamedTuple):
    """What the page shows of one run: `shown` is the panel as the page gets it."""

    shown: dict[str, Any]
    curves: list[Curve]
    modes: list[Mode]
    frequency: float  # Hz, nominal


class _Curves:
    """Curves in order; `add` returns the index."""

    def __init__(self) -> None:
        self.all: list[Curve] = []

    def add(self, label: str, unit: str, group: str, parts: Mapping[str, float], offset: float = 0.0) -> int:
        self.all.append(Curve(label, unit, group, parts, offset))
        return len(self.all) - 1


def frequency_weights(system: System) -> dict[str, dict[str, float]]:
    """Weights of the PMUs' frequencies in the frequency of each bus: {bus: {PMU: weight}}.

    A bus with a PMU has the frequency that it measures. The others follow from these by the frequency divider,
    `f_u = -B_uu^-1 B_um f_m` with the susceptances of branches at the start; no weights where no path leads to a PMU.
    Source: F. Milano, A. Ortega, Frequency divider, IEEE Transactions on Power Systems 32, 2017, (17).
    """
    at: dict[str, str] = {}
    for pmu, bus in system.pmu_buses().items():
        at.setdefault(bus, pmu)
    buses = [bus.name for bus in system.buses]
    series = [device_section(d, complex(at_rest(d))) for d in system.devices if isinstance(d, Series)]
    series = [branch for branch in series if np.isfinite(branch.admittance).all()]
    row, column, value = admittance(
        {bus: i for i, bus in enumerate(buses)}, [*branches(system, Topology()), *series], []
    )
    matrix = np.zeros((len(buses), len(buses)))
    matrix[row, column] = value.imag
    matrix -= np.diag(matrix.sum(axis=1))  # susceptances between buses alone: shunts hold no frequency
    known = np.array([bus in at for bus in buses])
    weights_by_bus = {bus: {at[bus]: 1.0} if bus in at else {} for bus in buses}
    unknown = np.flatnonzero(~known)
    if not len(unknown) or not known.any():
        return weights_by_bus
    # Least squares: where no path leads to a PMU the matrix is singular, and the weights come out as zero.
    weights = np.linalg.lstsq(matrix[np.ix_(unknown, unknown)], -matrix[np.ix_(unknown, known)], rcond=None)[0]
    measured = [at[bus] for bus in buses if bus in at]
    for row, u in zip(weights, unknown, strict=True):
        if abs(row.sum() - 1.0) < 1e-3:
            weights_by_bus[buses[u]] = {p: float(w) for p, w in zip(measured, row, strict=True) if abs(w) > SMALL}
    return weights_by_bus


def panel(case: Case, name: str) -> Panel:
    """The panel of a case; `name`: its heading."""
    curves, system = _Curves(), case.system
    frequencies = {
        bus: curves.add(bus, "Hz", "frequency", {f"pmu.{pmu}.frequency_hz": w for pmu, w in weights.items()})
        for bus, weights in frequency_weights(system).items()
    }
    angles, powers = _machines(case, curves)
    powers |= _inverters(case, curves)
    setpoints, of_devices = _setpoints(case, curves)
    latencies, of_links = _latencies(case, curves)
    flows = _flows(case, curves)
    modes = _modes(case, curves)
    monitors = _monitors(case, curves)
    measured = [frequencies[bus] for bus in dict.fromkeys(system.pmu_buses().values())]
    charts = [
        _chart("frequency at PMUs", "Hz", measured),
        _chart("rotor angle against the centre of inertia", "deg", [angles[name] for name in largest(system)]),
        _chart("active power", "MW", flows),
        *of_devices,
        _chart("difference of frequencies", "mHz", [mode.signal for mode in modes]),
        _chart("damping ratio of its mode", "%", [mode.damping for mode in modes], 0.0),
        *of_links,
    ]
    shown = {
        "name": name,
        "diagram": _diagram(case, frequencies, angles, powers, setpoints, latencies),
        "curves": [{"label": curve.label, "unit": curve.unit, "group": curve.group} for curve in curves.all],
        "charts": [chart for chart in charts if chart["curves"]],
        "monitors": monitors,
        "nodes": [PLANT, *names.replaceable(case), RECORDER],
    }
    return Panel(shown, curves.all, modes, system.frequency)


def _chart(title: str, unit: str, curves: Any, limit: float | None = None) -> dict[str, Any]:
    return {"title": title, "unit": unit, "curves": list(curves), "limit": limit}


def _machines(case: Case, curves: _Curves) -> tuple[dict[str, int], dict[str, int]]:
    """Angles of machines against the centre of inertia (against the infinite bus, if there is one), and powers."""
    machines, base = case.system.machines, case.system.base_power
    inertias = {m.name: 0.0 if case.system.infinite_buses else m.rating * m.H for m in machines}
    total = sum(inertias.values()) or 1.0
    angles, powers = {}, {}
    for m in machines:
        shares = {name: -inertia / total for name, inertia in inertias.items() if inertia or name == m.name}
        shares[m.name] = shares[m.name] + 1.0
        parts = {f"machine.{name}.rotor_angle_rad": math.degrees(share) for name, share in shares.items()}
        angles[m.name] = curves.add(m.name, "deg", "angle", parts)
        powers[m.name] = curves.add(m.name, "MW", "machine power", {f"machine.{m.name}.electrical_power_pu": base})
    return angles, powers


def largest(system: System) -> list[str]:
    """Machines whose angles have curves: all, or if they are many, the largest of each of the largest plants."""
    if len(system.machines) <= ANGLES:
        return [machine.name for machine in system.machines]
    plants: dict[str, str] = {}
    for machine in sorted(system.machines, key=lambda machine: -machine.rating):
        plants.setdefault(machine.bus, machine.name)
    return list(plants.values())[:ANGLES]


def _inverters(case: Case, curves: _Curves) -> dict[str, int]:
    """Power of each inverter with a PMU."""
    base, inverters = case.system.base_power, [inverter.name for inverter in case.system.inverters]
    at = {pmu.machine: pmu.name for pmu in case.system.pmus}
    return {
        name: curves.add(name, "MW", "machine power", {f"pmu.{at[name]}.active_power_pu": base})
        for name in inverters
        if name in at
    }


def _flows(case: Case, curves: _Curves) -> list[int]:
    """Powers that PMUs measure in branches and at inverters, or at machines if there are none of these."""
    inverters = [inverter.name for inverter in case.system.inverters]
    flows = [pmu.name for pmu in case.system.pmus if pmu.branches or pmu.machine in inverters]
    chosen, base = flows or [pmu.name for pmu in case.system.pmus], case.system.base_power
    return [curves.add(name, "MW", "power", {f"pmu.{name}.active_power_pu": base}) for name in chosen]


def _setpoints(case: Case, curves: _Curves) -> tuple[dict[str, int], list[dict[str, Any]]]:
    """Setpoint in force of each device, and a chart of each: sent, passed on, delivered, applied."""
    by_name, charts, supervised = {}, [], names.supervisor_names(case)
    for name in case.run.devices:
        indices = []
        for c, (node, controller) in enumerate(zip(names.controller_names(case), case.controllers, strict=True)):
            if name not in controller.devices:
                continue
            ways = {"sent": "issued", "passed on": "supervised", "delivered": "applied"}
            if c not in supervised:
                del ways["passed on"]
            if controller.fallback_of is not None:
                ways = {"sent": "issued"}
            label = f" by {node}" if sum(name in user.devices for user in case.controllers) > 1 else ""
            for what, column in ways.items():
                indices.append(curves.add(f"{what}{label}", "p.u.", "setpoint", {f"{column}.{node}.{name}_pu": 1.0}))
        by_name[name] = curves.add(f"{name} in force", "p.u.", "setpoint", {f"device.{name}.setpoint_pu": 1.0})
        indices.append(curves.add("applied", "p.u.", "setpoint", {f"device.{name}.reference_pu": 1.0}))
        charts.append(_chart(f"setpoint of {name}", "p.u.", indices, case.system.device(name).setpoint_max))
    return by_name, charts


def _latencies(case: Case, curves: _Curves) -> tuple[list[int], list[dict[str, Any]]]:
    """Largest latency of each link's newest frames, and a chart of each link by channel."""
    largest, charts = [], []
    for i, address in enumerate(names.link_addresses(case)):
        largest.append(curves.add(f"{address}", "ms", "latency", {f"latency.{i}": 1.0}))
        rows = [(f"{pmu} to the controllers", f"up.{pmu}") for pmu in _pmus(case, i)]
        rows += [(f"measurement to {device}", f"down.{device}") for device in _devices(case, i)]
        indices = [curves.add(label, "ms", "latency", {f"latency.{i}.{column}": 1.0}) for label, column in rows]
        charts.append(_chart(f"latency of {address}", "ms", indices))
    return largest, charts


def _pmus(case: Case, link: int) -> list[str]:
    """PMUs whose frames the controllers of a link use; all if it has none."""
    used = {pmu for c in names.served(case, link) for pmu in controller_pmus(case, c)}
    return [pmu.name for pmu in case.system.pmus if pmu.name in used or not used]


def _devices(case: Case, link: int) -> list[str]:
    used = {name for c in names.served(case, link) for name in case.controllers[c].devices}
    return [name for name in case.run.devices if name in used]


def controller_pmus(case: Case, c: int) -> list[str]:
    """PMUs from which the signals of a controller are computed."""
    used = {pmu for signal in case.controllers[c].signals for pmu in case.system.signals[signal].weights}
    return [pmu.name for pmu in case.system.pmus if pmu.name in used]


def _modes(case: Case, curves: _Curves) -> list[Mode]:
    """Differences of frequencies between areas, else the local ones, in mHz, and the damping ratio of each in %."""
    system, modes = case.system, []
    weights = measure_weights({"system": system.model_dump(by_alias=True)})
    for name in (system.measures.interarea or system.measures.local or list(weights))[:MEASURES]:
        parts = {f"pmu.{pmu}.frequency_hz": 1e3 * weight for pmu, weight in weights[name].items()}
        signal = curves.add(name, "mHz", "difference", parts, -system.frequency * sum(parts.values()))
        modes.append(Mode(name, signal, curves.add(name, "%", "damping", {})))
    return modes


def _monitors(case: Case, curves: _Curves) -> list[dict[str, Any]]:
    """Monitors of each supervisor that have a consequence."""
    if case.supervision is None:
        return []
    monitors, watched, controllers = [], watches(case.supervision), names.controller_names(case)
    for c in names.supervisor_names(case):
        for name, watch in watched.items():
            if watch.follows:
                row = MONITORS[name]
                parts = {f"supervision.{controllers[c]}.{name}": 1.0}
                unit = "-" if name in COUNTED else row.unit
                curve = curves.add(name, unit, "monitor", parts)
                more = {"name": name, "unit": unit, "limit": watch.limit, "description": row.description}
                monitors.append({**more, "controller": controllers[c], "follows": watch.follows, "curve": curve})
    return monitors


def _diagram(
    case: Case,
    frequencies: Mapping[str, int],
    angles: Mapping[str, int],
    powers: Mapping[str, int],
    setpoints: Mapping[str, int],
    latencies: list[int],
) -> dict[str, Any]:
    system, at = case.system, places(case.system)
    measured = set(system.pmu_buses().values())
    drawn: list[tuple[str, Any]] = [("line", row) for row in system.lines]
    drawn += [("transformer", row) for row in system.transformers]
    drawn += [("hvdc", d) for d in system.devices if isinstance(d, Transmission)]
    controllers, links = names.controller_addresses(case), names.link_addresses(case)
    acting = [c for c, controller in enumerate(case.controllers) if controller.fallback_of is None]
    return {
        "buses": [
            {
                "name": bus.name,
                "x": round(float(at[bus.name][0]), 4),
                "y": round(float(at[bus.name][1]), 4),
                "pmu": bus.name in measured,
                "frequency": frequencies[bus.name],
            }
            for bus in system.buses
        ],
        "branches": [{"name": row.name, "kind": kind, "from": row.from_bus, "to": row.to_bus} for kind, row in drawn],
        "machines": [
            {"name": unit.name, "bus": unit.bus, "angle": angles.get(unit.name), "power": powers.get(unit.name)}
            for unit in system.units  # an inverter has no angle
        ],
        "devices": [_device(system, system.device(name), setpoints[name]) for name in case.run.devices]
        + [_device(system, d, None) for d in system.devices if isinstance(d, Series) and d.name not in setpoints],
        "links": [
            {
                "name": str(links[case.used_links[c]]),
                "controller": str(controllers[c]),
                "buses": sorted({system.pmu_buses()[pmu] for pmu in controller_pmus(case, c)}),  # of its PMUs
                "devices": list(case.controllers[c].devices),
                "latency": latencies[case.used_links[c]],
            }
            for c in acting
        ],
        "controllers": [{"name": str(controllers[c])} for c in acting],
    }


def _device(system: System, device: Device, setpoint: int | None) -> dict[str, Any]:
    """A device: between two buses, or at one; `setpoint` None: not installed, drawn as a branch."""
    drawn = {
        "name": device.name,
        "kind": device.kind,
        "outline": KINDS[device.kind].shown.outline,
        "setpoint": setpoint,
    }
    if isinstance(device, Transmission):
        return drawn | {"from": device.from_bus, "to": device.to_bus}
    first, *others = system.buses_of(device)
    return drawn | ({"from": first, "to": others[0]} if others else {"bus": first})
