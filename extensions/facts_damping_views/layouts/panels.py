"""Panels of a case: groups of topics' fields, independent of the viewer's file format."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from facts_damping.case import names as case_names
from facts_damping.case.supervision import reserves
from facts_damping.control.bank import controller_network
from facts_damping.devices.base import Series as SeriesDevice
from facts_damping.devices.table import KINDS
from facts_damping.monitor_table import MONITORS
from facts_damping.neurofuzzy.start import groups
from facts_damping.parameters.supervision import Supervision, watches
from facts_damping.simulation.assembly import identifier_network

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from facts_damping.case.model import Case

PLOT, STATES, TABLE, MESSAGE, DIAGNOSTICS = "plot", "states", "table", "message", "diagnostics"

DEADLINE_MISSES = 'status[:].values[:]{key=="deadline_misses"}.value'


class Curve(NamedTuple):
    """A value over time: topic, path of the field below it, label; `number`: numeric, not text."""

    topic: str
    path: str
    label: str
    number: bool = True


class Panel(NamedTuple):
    """Curves that share an axis. Panels of the kinds after STATES show one topic, or a field of it, unchanged."""

    title: str
    curves: list[Curve]
    kind: str = PLOT


class Tab(NamedTuple):
    """Panels shown together."""

    title: str
    panels: list[Panel]


def tabs(case: Case, namespace: str = "/") -> list[Tab]:
    """All panels of a case whose graph is in the given namespace."""

    def full(topic: str) -> str:
        return f"{namespace.rstrip('/')}/{topic}"

    controllers, identifiers = case_names.controller_addresses(case), case_names.identifier_addresses(case)
    all_tabs = [_grid(case, full), _devices(case, full)]
    all_tabs += [_controller(case, c, full(str(address))) for c, address in enumerate(controllers)]
    all_tabs += [_identifier(case, c, full(str(address))) for c, address in identifiers.items()]
    for c, address in case_names.supervisor_addresses(case).items():
        senders = {who: full(topic) for who, topic in _senders(case, c).items()}
        all_tabs += _supervisor(case, c, full(str(address)), senders)
    all_tabs += [_link(case, full(link.namespace).rstrip("/"), str(link)) for link in case_names.link_addresses(case)]
    health = Panel("deadline misses", [Curve("/diagnostics", DEADLINE_MISSES, full("plant_sim").lstrip("/"))])
    all_tabs.append(Tab("health", [Panel("diagnostics", [Curve("/diagnostics", "", "")], DIAGNOSTICS), health]))
    return [Tab(tab.title, [panel for panel in tab.panels if panel.curves]) for tab in all_tabs if tab.panels]


def _each(topic: str, path: str, labels: Sequence[str]) -> list[Curve]:
    """One curve per entry of an array; `#` in `path` stands for the index."""
    return [Curve(topic, path.replace("#", str(i)), label) for i, label in enumerate(labels)]


def _grid(case: Case, full: Callable[[str], str]) -> Tab:
    """Machines, PMUs at buses, events."""
    state, frames, events = full("plant/state"), full("pmu/frames"), full("plant/events")
    machines = [machine.name for machine in case.system.machines]
    buses = {i: pmu.name for i, pmu in enumerate(case.system.pmus) if pmu.machine not in machines}  # and at inverters

    def at_buses(field: str) -> list[Curve]:
        return [Curve(frames, f"frames[{i}].{field}", name) for i, name in buses.items()]

    changes = [Curve(events, name, name, number=False) for name in ("kind", "element")]
    return Tab(
        "grid",
        [
            Panel("speed deviation, p.u.", _each(state, "machines[#].speed_deviation_pu", machines)),
            Panel("rotor angle, rad", _each(state, "machines[#].rotor_angle_rad", machines)),
            Panel("active power at buses, p.u.", at_buses("active_power_pu")),
            Panel("voltage at buses, p.u.", at_buses("voltage_magnitude_pu")),
            Panel("events", [*changes, Curve(state, "in_synchronism", "in synchronism")], STATES),
            Panel("newest event", [Curve(events, "", "")], MESSAGE),
        ],
    )


def _devices(case: Case, full: Callable[[str], str]) -> Tab:
    """Each device: its setpoint and its response."""
    state, panels, names = full("plant/state"), [], case.run.devices
    for i, name in enumerate(names):
        device = case.system.device(name)
        kind, series = KINDS[device.kind], isinstance(device, SeriesDevice)
        voltages = ["setpoint", "reference", *(["injected_voltage"] if series else [])]
        for what, fields in (
            (kind.shown.panel, voltages),
            *([(kind.shown.state, ["state"])] if kind.shown.state else []),
            ("current and power", ["current", "active_power", "reactive_power"]),
        ):
            curves = [Curve(state, f"devices[{i}].{field}_pu", field.replace("_", " ")) for field in fields]
            panels.append(Panel(f"{name}: {what}, p.u.", curves))
    panels.append(Panel("blocked", _each(state, "devices[#].blocked", names), STATES))
    panels.append(Panel("released", _each(state, "devices[#].released", names), STATES))
    return Tab("devices", panels)


def _controller(case: Case, c: int, here: str) -> Tab:
    """One controller: inputs, outputs, and how its network learns."""
    controller, topic = case.controllers[c], f"{here}/state"
    signals, devices, net = controller.signals, controller.devices, controller_network(controller)
    parts, adapts = groups(net), controller.scheme is not None
    outputs = []
    for i, name in enumerate(devices):
        outputs.append(Curve(topic, f"outputs[{i}]", name))
        outputs.append(Curve(topic, f"unlimited_outputs[{i}]", f"{name}, without limit"))
    states = [Curve(topic, "fresh", "fresh"), *_each(topic, "saturated[#]", [f"{name} saturated" for name in devices])]
    panels = [
        Panel("inputs, p.u.", _each(topic, "inputs[#]", signals)),
        Panel("outputs, p.u.", outputs),
        Panel("states", [*states, *([Curve(topic, "learnt", "learnt")] if adapts else [])], STATES),
    ]
    if adapts:
        rules = [f"rule {r}" for r in range(net.rules)]
        panels += [
            Panel("firing strengths", _each(topic, "firing_strengths[#]", rules)),
            Panel("adaptation errors", _each(topic, "adaptation_errors[#]", devices)),
            Panel("parameter norms", _each(topic, "parameter_norms[#]", parts)),
            *_learning(topic, devices, parts),
        ]
    return Tab(here.rpartition("/")[2], panels)


def _identifier(case: Case, c: int, here: str) -> Tab:
    """One identifier: estimated Jacobian, prediction, and how it learns."""
    controller, topic = case.controllers[c], f"{here}/estimate"
    signals = controller.signals
    derivatives = [f"{signal} by {device}" for signal in signals for device in controller.devices]
    return Tab(
        here.rpartition("/")[2],
        [
            Panel("Jacobian, p.u. per p.u.", _each(topic, "jacobian[#]", derivatives)),
            Panel("prediction, p.u.", _each(topic, "prediction[#]", signals)),
            Panel("prediction minus measurement, p.u.", _each(topic, "error[#]", signals)),
            *_learning(topic, signals, groups(identifier_network(controller))),
        ],
    )


def _senders(case: Case, c: int) -> dict[str, str]:
    """Topics with setpoints for a supervised controller's devices, by sender."""
    places, reserve = case_names.controller_addresses(case), reserves(case.run).get(c)
    senders = {
        "supervised": f"{case_names.supervisor_addresses(case)[c]}/{case_names.SUPERVISED}",
        "issued": f"{places[c]}/setpoints",
    }
    return senders | ({} if reserve is None else {"of the fallback": f"{places[reserve]}/setpoints"})


def _supervisor(case: Case, c: int, here: str, senders: dict[str, str]) -> list[Tab]:
    """One supervisor: setpoints passed on, and causes; for each group of monitors, values beside their limits."""
    topic, name = f"{here}/state", here.rpartition("/")[2]
    words = [Curve(topic, field, field, number=False) for field in ("state", "cause", "refused")]
    probe = {"probe_gain": "gain", "probe_phase_rad": "phase, rad", "probe_coherence": "coherence"}
    worth = {"added_damping_per_s": "added damping, 1/s", "phase_margin_rad": "phase margin, rad"}
    worth["gain_margin"] = "gain margin, a factor"
    panels = [
        Panel("state", words, STATES),
        Panel("fraction of the ramp", [Curve(topic, "fraction", "fraction")]),
        Panel("probe: response relative to the model", [Curve(topic, field, label) for field, label in probe.items()]),
        Panel("probe: damping and margins", [Curve(topic, field, label) for field, label in worth.items()]),
    ]
    for device in case.controllers[c].devices:
        path = f'setpoints[:]{{device=="{device}"}}.value_pu'
        curves = [Curve(sender, path, who) for who, sender in senders.items()]
        panels.append(Panel(f"{device}: setpoints, p.u.", curves))
    watched = watches(case.supervision or Supervision())
    by_group: dict[str, list[Panel]] = {row.group: [] for row in MONITORS.values()}
    for i, (monitor, row) in enumerate(MONITORS.items()):
        if watched[monitor].follows:
            pair = [Curve(topic, f"values[{i}]", monitor), Curve(topic, f"limits[{i}]", f"{monitor}: limit")]
            by_group[row.group].append(Panel(f"{monitor}, {row.unit}", pair))
    return [
        Tab(name, panels),
        *(Tab(f"{name}: {group}", panels_of_group) for group, panels_of_group in by_group.items()),
    ]


def _learning(topic: str, outputs: Sequence[str], parts: Sequence[str]) -> list[Panel]:
    """Learning rates and Lyapunov function of a controller's or an identifier's network."""
    rates = [f"{output}, {part}" for output in outputs for part in parts]
    return [
        Panel("learning rates", _each(topic, "learning_rates[#]", rates)),
        Panel("Lyapunov function", [Curve(topic, "lyapunov", "V"), Curve(topic, "lyapunov_fall", "fall")]),
    ]


def _link(case: Case, here: str, name: str) -> Tab:
    """One link: delays and losses of its channels, and the delivered speeds or frequencies."""
    topic, pmus = f"{here}/link/statistics", [pmu.name for pmu in case.system.pmus]
    with_speed = [machine.name for machine in case.system.machines]
    channels = {"up": pmus, "down": case.run.devices}
    turning, title = "speed_deviation_pu", "speed deviation as delivered, p.u."
    if case.measurement.filter != "ideal" or not with_speed:
        turning, title = "frequency_hz", "frequency as delivered, Hz"
        with_speed = [unit.name for unit in case.system.units]
    turned = [pmu.name for pmu in case.system.pmus if pmu.machine in with_speed]

    def of_all(field: str) -> list[Curve]:
        labels = {way: [f"{way} {name}" for name in names] for way, names in channels.items()}
        return [curve for way, each in labels.items() for curve in _each(topic, f"{way}[#].{field}", each)]

    speeds = [Curve(f"{here}/pmu/delivered", f'frames[:]{{pmu=="{pmu}"}}.{turning}', pmu) for pmu in turned]
    return Tab(
        name,
        [
            Panel("mean delay, s", of_all("delay_mean_s")),
            Panel("largest delay, s", of_all("delay_max_s")),
            Panel("lost", of_all("lost")),
            Panel("in flight", of_all("in_flight")),
            Panel(title, speeds),
            *(Panel(f"channels {way}", [Curve(topic, way, "")], TABLE) for way, names in channels.items() if names),
        ],
    )
