"""Loads a case: reads the user's input (YAML files, `--set`) and all files it names, and checks them."""

from __future__ import annotations

from copy import deepcopy
from typing import TYPE_CHECKING, Any

from facts_damping.caching import shared
from facts_damping.case.changes import PROFILE, STANDARD, apply_profile, as_sets, change, off
from facts_damping.case.checks import check_case, check_events
from facts_damping.case.controllers import filled
from facts_damping.case.links import beside, check_felt, links_of, signed
from facts_damping.case.model import Case
from facts_damping.case.named_files import checked, read_source, resolve
from facts_damping.case.supervision import check_fallbacks, supervision_of
from facts_damping.errors import check_known
from facts_damping.input_files import naming_no_files
from facts_damping.measurement.filters import reference_filter
from facts_damping.parameters.events import Scenario
from facts_damping.parameters.field_errors import FieldError, check, check_field, worded
from facts_damping.parameters.files import check_kind, copied, each_path, find, read_sets, read_table, set_field
from facts_damping.parameters.measurement import Measurement
from facts_damping.parameters.plant.placement import place
from facts_damping.parameters.plant.system import System
from facts_damping.parameters.run import Run

if TYPE_CHECKING:
    from collections.abc import Mapping

    from facts_damping.case.named_files import Source

_stored: dict[str, Case] = {}
_systems: dict[str, System] = {}  # by their content
ARM_AT = 0.5  # s; used if the command line asks for supervision


def read_system(name: str, sets: list[str] | None = None) -> System:
    """A system by name or path, as its file has it, with `--set` applied."""
    return check(System, *_system_content(name, sets))


def _system_content(name: str, sets: list[str] | None) -> tuple[dict[str, Any], str, dict[str, str]]:
    """A system's content with `--set` applied, its file, and what gave the fields that were set."""
    path = find("systems", name)
    content = read_table(path)
    values, origins = read_sets(sets or [])
    for field_path, value in values.items():
        for key in each_path(content, field_path):
            set_field(content, key, value, origins[field_path])
    return content, str(path), origins


def load_system(name: str, sets: list[str] | None = None, scenario: str | None = None) -> System:
    """A system by name or path, with `--set`, a scenario's dispatch and the devices applied."""
    content, path, origins = _system_content(name, sets)
    system = check(System, content, path, origins)
    if scenario is not None:
        source = read_source("scenarios", scenario, "scenario", f"{system.name}/")
        content = _dispatched(content, checked(Scenario, source), source.file)
        system = check(System, content, path, origins)
    return place(system)


def installed(system: System, names: str | None) -> list[str]:
    """Devices named on a command line (`none` for none); default: those of a run that the system has."""
    have = [d.name for d in system.devices]
    if names is None:
        return [name for name in Run.model_fields["devices"].default if name in have]
    asked = [] if names == "none" else names.split(",")
    for i, name in enumerate(asked):
        check_known("--devices", name, [other for other in have if other not in asked[:i]])
    return asked


def load_case(name: str | None, sets: list[str] | None = None, supervised: str | None = None) -> Case:
    """A run by name or path (None: all defaults), with `--set` applied, and all files that it names.

    `supervised`: name or path of a supervision; empty: the run's own, else `standard`. The controllers are then armed
    at `ARM_AT`, unless the run sets a time or a probe comes first.
    """
    content, source = read_run(name)
    values, origins = read_sets(sets or [])
    if supervised is not None:
        content["supervision"] = supervised or (STANDARD if off(content, "supervision") else content["supervision"])
        content.pop("asked", None)
    change(content, values, origins)
    case = make_case(content, source, origins)
    if supervised is None or case.supervision is None or case.supervision.arming.probe or case.run.arm_at is not None:
        return case
    return make_case({**content, "arm_at": ARM_AT}, source, origins)


def read_run(run: str | dict[str, Any] | None) -> tuple[dict[str, Any], str]:
    """Content of a run by name, path or inline (None: all defaults), and its source for messages.

    The fields of its profile are set, except for a stored run, which already has them.
    """
    if run is None:
        return {}, "defaults"
    if isinstance(run, dict):
        content, source = deepcopy(run), "run"
    else:
        path = find("runs", run)
        content, source = read_table(path), str(path)
        check_kind("runs", content, source)
    if content.get(PROFILE) is not None and content.get("asked") is None:
        apply_profile(content, content[PROFILE], f"{source}: {PROFILE}", list(content))
    return content, source


def changed_case(
    content: dict[str, Any], source: str, values: Mapping[str, Any], sets: dict[str, str] | None = None
) -> Case:
    """A case from a copy of the content of a run file after setting fields. `sets`: how each was given."""
    content, sets = copied(content), as_sets(values) if sets is None else sets
    change(content, values, sets)
    return make_case(content, source, sets)


def make_case(content: Any, source: str, sets: dict[str, str] | None = None) -> Case:
    """A case from the content of a run file; one that was stored names no other files, so all nodes have the same."""
    with worded(source, sets):
        if not isinstance(content, dict) or content.get("asked") is None:
            return _made(content, sets or {})
        return shared(_stored, repr(content), lambda: _made(content, sets or {}), maximum=8)


def _made(content: Any, sets: dict[str, str]) -> Case:
    run = check_field(Run, content, "")
    system_source = read_source("systems", run.system, "system")
    system = _system(system_source)
    model = None if run.model is None else _model(_system(read_source("systems", run.model, "model")), system)
    sources = resolve(run, system.name)
    scenario, scenario_file = checked(Scenario, sources.scenario), sources.scenario.file
    measurement = checked(Measurement, sources.measurement)
    link, links, used = links_of(sources)
    for i, field in enumerate(["link", *(f"controllers.{c}.link" for c in range(len(run.controllers)))]):
        check_felt(link if i == 0 else links[used[i - 1]], field, measurement, sets)
    links = [beside(signed(run_link) if run.security else run_link, measurement) for run_link in links]
    dispatched = system_source._replace(content=_dispatched(system_source.content, scenario, scenario_file))
    placed = place(checked(System, dispatched) if scenario.dispatch else system)
    latency = reference_filter(measurement, system.frequency, run.frame_rate).delay / run.frame_rate
    controllers, settings = [], (run.frame_rate, latency, measurement.filter, run.tuning)
    for i, controller in enumerate(run.controllers):
        if controller.link is not None:
            controller = controller.model_copy(update={"link": links[used[i]].model_dump()})  # noqa: PLW2901
        controllers.append(filled(controller, f"controllers.{i}", system, links[used[i]], *settings))
    supervision = supervision_of(run, sources.supervision)
    case = Case(run, controllers, placed, scenario, measurement, link, links, used, supervision, model)
    check_case(case)
    check_fallbacks(case)
    check_events(case, scenario_file)
    return case


def _system(source: Source) -> System:
    """A source's system, checked once: runs of a sweep mostly have the same."""
    return shared(_systems, repr(source.content), lambda: checked(System, source), maximum=8)


def recorded_case(content: Any, source: str) -> Case:
    """A case from the content in a recording, which is complete: files that it names are not opened."""
    with naming_no_files(f"the recording {source}"):
        return make_case(content, source)


def _model(model: System, system: System) -> System:
    """The system for controller design, if not the plant; devices that only the plant has are known there, too."""
    known = {d.name for d in model.devices}
    if others := [device for device in system.devices if device.name not in known]:
        model = model.model_copy(update={"devices": [*model.devices, *others]})
    for field, model_names, other in (
        ("devices", [d.name for d in model.devices], [d.name for d in system.devices]),
        ("pmus", [s.name for s in model.pmus], [s.name for s in system.pmus]),
        ("signals", list(model.signals), list(system.signals)),
    ):
        if model_names != other:
            allowed = f"those of the system, {', '.join(other) or 'none'}"
            raise FieldError("model", f"{field} {', '.join(model_names) or 'none'} given; allowed: {allowed}")
    return place(model)


def _dispatched(content: dict[str, Any], scenario: Scenario, where: str) -> dict[str, Any]:
    """A system's content with a scenario's powers of machines and inverters, before shares of machines are replaced."""
    dispatch, tables = scenario.dispatch, {name: content.get(name, []) for name in ("machines", "inverters")}
    for name in dispatch:
        scheduled = [row["name"] for rows in tables.values() for row in rows if not row.get("slack")]
        check_known(f"{where}: dispatch", name, scheduled)
    rows_of = {name: [{**row, "P": dispatch.get(row["name"], row.get("P"))} for row in rows]
               for name, rows in tables.items()}  # fmt: skip
    return {**content, **rows_of}
