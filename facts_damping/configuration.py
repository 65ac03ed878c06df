"""From what the user wrote (YAML files, `--set`) to a checked case that everything else is built from."""

from __future__ import annotations

from copy import deepcopy
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from facts_damping import files
from facts_damping.checking import check, origin
from facts_damping.control import bank, identifier
from facts_damping.control.compensation import COMPENSATIONS, OF_IDENTIFIERS
from facts_damping.control.table import Parameter, Value, defaults, kind
from facts_damping.errors import InputError, check_known
from facts_damping.files import find, parse_set, read_table, read_value, set_field
from facts_damping.linking import mean_delays, open_own, read_links, with_own
from facts_damping.parameters.placement import place
from facts_damping.parameters.run import Controller, Run, Scenario, Tuned, Weights
from facts_damping.parameters.system import System
from facts_damping.plant.events import stages

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from facts_damping.parameters.link import Link

SPAN = 6.0  # frames of `identifier_span`, where an identifier predicts: with one value it does not know an oscillation
MOST_TICKS = 2_000_000  # of a run: all its signals are kept in memory


@dataclass(frozen=True)
class Case:
    """A checked run: what the user asked for, and the files it names, read.

    `controllers` are the run's with scheme, all parameters, weights and own link filled in. `links` are the run's,
    where it is used, then each controller's own; `used_links` says which one each controller uses.
    """

    run: Run
    controllers: list[Controller]
    system: System
    scenario: Scenario
    link: Link
    links: list[Link]
    used_links: list[int]

    @property
    def duration(self) -> float:
        """Simulated time, s."""
        return self.scenario.duration if self.run.duration is None else self.run.duration

    @property
    def ticks(self) -> int:
        """Number of PMU frames in the run."""
        return max(1, round(self.duration * self.run.frame_rate))

    def summary(self) -> dict[str, Any]:
        """The run with its names, as JSON output shows it."""
        return self.run.asked or {**self.run.model_dump(exclude={"asked"}), "duration": self.duration}

    def document(self) -> dict[str, Any]:
        """The run with everything it names inline: a run file by itself."""
        return {
            **self.run.model_dump(),
            "controllers": [controller.model_dump() for controller in self.controllers],
            "asked": self.summary(),
            "duration": self.duration,
            "system": self.system.model_dump(by_alias=True),
            "scenario": [event.model_dump() for event in self.scenario.events],
            "link": self.link.model_dump(),
        }


def load_system(name: str, sets: list[str] | None = None, scenario: str | None = None) -> System:
    """A system by name or path, with `--set` applied to its fields, and a scenario's dispatch."""
    path = find("systems", name)
    content = read_table(path)
    pairs = dict(parse_set(text) for text in sets or [])
    for key, value in pairs.items():
        set_field(content, key, read_value(value, f"--set {key}={value}"), f"--set {key}={value}")
    system = check(System, content, str(path), pairs)
    if scenario is not None:
        file = find("scenarios", scenario, f"{system.name}/")
        system = _dispatched(system, check(Scenario, read_table(file), str(file)), str(file))
    return place(system)


def installed(system: System, names: str | None) -> list[str]:
    """Devices by the names on a command line, `none` for none; by default those of a run, where the system has them."""
    have = [d.name for d in system.devices]
    if names is None:
        return [name for name in Run.model_fields["devices"].default if name in have]
    asked = [] if names == "none" else names.split(",")
    for i, name in enumerate(asked):
        check_known("--devices", name, [other for other in have if other not in asked[:i]])
    return asked


def load_case(name: str | None, sets: list[str] | None = None) -> Case:
    """A run by name or path (none: all defaults), with `--set` applied, and all that it names."""
    path = None if name is None else find("runs", name)
    content = {} if path is None else read_table(path)
    pairs = dict(parse_set(text) for text in sets or [])
    change(content, {key: read_value(value, f"--set {key}={value}") for key, value in pairs.items()}, pairs)
    return make_case(content, str(path or "defaults"), pairs)


def change(content: dict[str, Any], values: Mapping[str, Any], sets: Mapping[str, str]) -> None:
    """Set fields of a run's content by their paths; `sets`: each value as the text that `--set` would take."""
    if values:
        content.pop("asked", None)  # no longer what was asked for
    for key in sorted(values, key=lambda key: key.count(".")):  # names before what lies below them
        _open_name(content, key)
        set_field(content, key, deepcopy(values[key]), f"--set {key}={sets[key]}")


def _open_name(content: dict[str, Any], key: str) -> None:
    """Where a `--set` goes below a name (system, scenario, link), put the named file's content in its place."""
    top, _, below = key.partition(".")
    if not below:
        return
    if top == "controllers":
        content.setdefault(top, [{}])
        open_own(content, below)
    if top not in ("system", "scenario", "link"):
        return
    named = content.get(top, Run.model_fields[top].default)
    if not isinstance(named, str):
        return
    if top == "scenario":
        system = content.get("system", Run.model_fields["system"].default)
        own = system if isinstance(system, dict) else read_table(find("systems", str(system)))
        within = own.get("name", "")
        scenario = read_table(find("scenarios", named, f"{within}/"))
        content.setdefault("duration", scenario.get("duration", Scenario.model_fields["duration"].default))
        content[top] = scenario.get("events", [])
        if scenario.get("dispatch"):
            _open_name(content, "system.machines")
            for row in content["system"].get("machines", []):
                row.update({"P": scenario["dispatch"].get(row.get("name"), row.get("P"))})
    else:
        content[top] = read_table(find(f"{top}s", named))


def make_case(content: Any, source: str, sets: dict[str, str] | None = None) -> Case:
    """A case from the content of a run file."""
    run = check(Run, content, source, sets)
    if isinstance(run.system, str):
        system_path = find("systems", run.system)
        system = check(System, read_table(system_path), str(system_path))
    else:
        system = check(System, run.system, source, sets, "system")
    if isinstance(run.scenario, str):
        path = find("scenarios", run.scenario, f"{system.name}/")
        scenario = check(Scenario, read_table(path), str(path))
    else:
        scenario = check(Scenario, {"name": "inline", "events": run.scenario}, source, sets, "scenario")
    link, links, used = read_links(run, source, sets)
    scenario_file = str(path) if isinstance(run.scenario, str) else ""
    placed = place(_dispatched(system, scenario, scenario_file))
    rows = [
        _filled(with_own(c, links[used[i]]), f"controllers.{i}", system, links[used[i]], source, sets)
        for i, c in enumerate(run.controllers)
    ]
    case = Case(run, rows, placed, scenario, link, links, used)
    _check_case(case, source, sets)
    _check_events(case, scenario_file, source, sets)
    return case


def _dispatched(system: System, scenario: Scenario, where: str) -> System:
    """The system with the active powers that a scenario starts from."""
    scheduled = [m.name for m in system.machines if not m.slack]
    for name in scenario.dispatch:
        check_known(f"{where}: dispatch", name, scheduled)
    machines = [
        m.model_copy(update={"P": scenario.dispatch[m.name]}) if m.name in scenario.dispatch else m
        for m in system.machines
    ]
    return system.model_copy(update={"machines": machines})


def _check_events(case: Case, scenario_file: str, source: str, sets: dict[str, str] | None) -> None:
    """Events that cannot happen, named by the scenario's file or by the run's own field."""
    try:
        stages(case.system, case.scenario.events)
    except InputError as error:
        text = str(error)
        if not text.startswith("events."):
            raise
        if scenario_file:
            raise InputError(f"{scenario_file}: {text}") from error
        place = text.removeprefix("events.")
        field = f"scenario.{place.split(':')[0].split(' ')[0]}"
        raise InputError(
            f"{origin(field, source, sets)}{place.removeprefix(field.removeprefix('scenario.'))}"
        ) from error


def _check_case(case: Case, source: str, sets: dict[str, str] | None) -> None:
    """What one file alone cannot tell: devices, controllers, signals and parameters that are not there."""
    run, system = case.run, case.system
    if case.ticks > MOST_TICKS:
        raise InputError(
            f"{origin('duration', source, sets)}: {case.duration:g} s at {run.frame_rate} frames/s given, "
            f"{case.ticks} frames; allowed: at most {MOST_TICKS} frames"
        )
    for i, device in enumerate(run.devices):
        check_known(origin(f"devices.{i}", source, sets), device, [d.name for d in system.devices])
        if device in run.devices[:i]:
            raise InputError(f"{origin(f'devices.{i}', source, sets)}: '{device}' given twice; allowed: each once")
    _check_channels(case, source, sets)
    commanded: set[str] = set()
    for c, controller in enumerate(run.controllers):
        here, row = f"controllers.{c}", kind(controller.name)

        def where(field: str, here: str = here) -> str:
            return origin(f"{here}.{field}", source, sets)

        for device in controller.devices:
            check_known(where("devices"), device, run.devices)
            if device in commanded:
                raise InputError(
                    f"{where('devices')}: '{device}' given, which is commanded already; allowed: each device once"
                )
            commanded.add(device)
        for signal in controller.signals:
            check_known(where("signals"), signal, list(system.signals))
            if controller.signals.count(signal) > 1:
                raise InputError(f"{where('signals')}: '{signal}' given twice; allowed: each once")
        if len(controller.signals) > row.signals:
            raise InputError(
                f"{where('signals')}: {len(controller.signals)} given; allowed: {row.signals} for {controller.name}"
            )


def _check_channels(case: Case, source: str, sets: dict[str, str] | None) -> None:
    """Stages of links name stations or signals on the way up, installed devices on the way down."""
    known = {"up": [*(s.name for s in case.system.stations), *case.system.signals], "down": case.run.devices}
    own = [f"controllers.{c}.link" for c, controller in enumerate(case.run.controllers) if controller.link is not None]
    fields = [*["link"][: len(case.links) - len(own)], *own]
    for field, link in zip(fields, case.links, strict=True):
        for way, names in known.items():
            for i, stage in enumerate(getattr(link, way)):
                for name in stage.channels or []:
                    check_known(origin(f"{field}.{way}.{i}.channels", source, sets), name, names)


def _filled(
    controller: Controller, here: str, system: System, link: Link, source: str, sets: dict[str, str] | None
) -> Controller:
    """A controller with scheme, all parameters and its weights: the table's, then the system's tuned, then its own."""

    def where(field: str) -> str:
        return origin(f"{here}.{field}", source, sets)

    row = kind(controller.name, where("name"))
    if row.network is None and controller.scheme is not None:
        raise InputError(f"{where('scheme')}: '{controller.scheme}' given; allowed: none for {controller.name}")
    scheme = None if row.network is None else controller.scheme or "indirect"
    if controller.compensation in OF_IDENTIFIERS and scheme != "indirect":
        raise InputError(
            f"{where('compensation')}: '{controller.compensation}' given; allowed: {', '.join(COMPENSATIONS)} for "
            f"{controller.name}{f' {scheme}' if scheme else ''}, or an indirect controller, whose identifier predicts"
        )
    counts = {"signal": len(controller.signals), "device": len(controller.devices)}
    for name, value in controller.parameters.items():
        check_parameter(where(f"parameters.{name}"), name, value, row.parameters, counts)
    known = tuned(system.name, controller.signals, controller.devices)
    if controller.name == "LLC-tuned" and (controller.name, None) not in known and not controller.parameters:
        raise InputError(
            f"{where('name')}: 'LLC-tuned' given, which is not tuned for {system.name} with these signals and devices; "
            f"allowed: LLC, or `facts-damping tune {system.name}` first"
        )
    own = defaults(row, controller.profile, *counts.values())
    values = {**own, **known.get((controller.name, scheme), {}), **controller.parameters}
    if controller.compensation in OF_IDENTIFIERS and "identifier_span" not in controller.parameters:
        values["identifier_span"] = SPAN
    order = identifier.past_values(values.get("identifier_span"))
    if order > 1 and "identifier" not in controller.parameters:
        values["identifier"] = "ANFTSI"  # whose consequents are then affine
    if values.get("identifier") == "ANFGuMoI" and max(*counts.values(), order) > 1:
        raise InputError(
            f"{where('parameters.identifier')}: 'ANFGuMoI' given; "
            "allowed: ANFTSI with several signals or devices, or an identifier_span"
        )
    whole, down = mean_delays(controller, system, link)
    if values.get("lag") == -1.0:
        values["lag"] = whole
    if values["down_delay"] == -1.0:
        values["down_delay"] = down
    weights = _weights(controller, scheme, values, where)
    return controller.model_copy(update={"scheme": scheme, "parameters": values, "weights": weights})


def check_parameter(where: str, name: str, value: Value, table: dict[str, Parameter], counts: dict[str, int]) -> None:
    """Raise `InputError` for a parameter that is not in a kind's table, or a value that it must not have.

    `counts`: how many signals and devices the controller has.
    """
    check_known(where, name, list(table))
    p = table[name]
    if isinstance(value, list) and (not p.each or len(value) != counts[p.each]):
        allowed = f"a number, or {counts[p.each]}, one a {p.each}" if p.each else "one value"
        raise InputError(f"{where}: {len(value)} numbers given; allowed: {allowed}")
    for one in value if isinstance(value, list) else [value]:
        if p.choices:
            check_known(where, str(one), p.choices)
        elif isinstance(one, str) or not p.low <= one <= p.high or (p.whole and one != round(one)):
            shown, whole = one if isinstance(one, str) else f"{one:g}", "whole numbers, " if p.whole else ""
            raise InputError(f"{where}: {shown} given; allowed: {whole}{p.low:g} to {p.high:g} {p.unit}")


def _weights(
    controller: Controller, scheme: str | None, values: dict[str, Value], where: Callable[[str], str]
) -> Weights | None:
    """The weights that a controller starts from, read if they are named by a file."""
    if controller.weights is None:
        return None
    found = controller.weights
    if isinstance(found, str):
        path = Path(found)
        if not path.is_file():
            raise InputError(f"{where('weights')}: {path}: no such file; allowed: weights that a run has saved")
        found = check(Weights, files.read_table(path), str(path))
    if (found.name, found.scheme) != (controller.name, scheme):
        raise InputError(
            f"{where('weights')}: weights of {found.name} ({found.scheme}) given; "
            f"allowed: those of {controller.name} ({scheme})"
        )
    wanted = {"controller": bank.network_of(controller).size, "identifier": 0}
    if scheme == "indirect":
        kind_of_identifier = str(values["identifier"])
        counts = len(controller.signals), len(controller.devices)
        order = identifier.past_values(values["identifier_span"])
        wanted["identifier"] = identifier.network_of(kind_of_identifier, *counts, order).size
    for part, size in wanted.items():
        given = getattr(found, part)
        if given is not None and len(given) != size:
            raise InputError(f"{where('weights')}: {part}: {len(given)} numbers given; allowed: {size}")
    return found


def tuned(
    system: str, signals: list[str] | None = None, devices: list[str] | None = None
) -> dict[tuple[str, str | None], dict[str, Value]]:
    """Parameters that `facts-damping tune` chose for a system, by controller and scheme.

    Known for the signals and devices alone that they were chosen with, by default those of a run; a lead-lag takes
    the first of the signals.
    """
    own = Controller()
    signals, devices = signals or own.signals, devices or own.devices
    found: dict[tuple[str, str | None], dict[str, Value]] = {}
    for path in files.shipped("controllers").values():
        file = _read_tuned(path)
        for row in file.controllers:
            most = kind(row.name).signals
            if (file.system, file.devices, file.signals[:most]) == (system, devices, signals):
                found[row.name, row.scheme] = row.parameters
    return found


@cache
def _read_tuned(path: Path) -> Tuned:
    return check(Tuned, files.read_table(path), str(path))
