"""Changes of a run's content: fields set by path, names replaced by their files' content, profiles."""

from __future__ import annotations

from copy import deepcopy
from functools import partial
from json import dumps
from typing import TYPE_CHECKING, Any

from facts_damping.case.links import open_own
from facts_damping.case.named_files import checked, read_source
from facts_damping.errors import InputError
from facts_damping.parameters.events import Scenario
from facts_damping.parameters.field_errors import short
from facts_damping.parameters.files import each_path, find, is_path, read_table, set_field, shipped
from facts_damping.parameters.profile import Profile
from facts_damping.parameters.run import Controller, Run

if TYPE_CHECKING:
    from collections.abc import Collection, Mapping

# Fields of a run that may name a file, and the folders of the shipped files.
FOLDERS = {"system": "systems", "model": "systems", "scenario": "scenarios", "link": "links"}
FOLDERS |= {name: name for name in ("measurement", "supervision")}
STANDARD = "standard"  # supervision to start from when `--set` changes a field of one and the run has none
PROFILE = "profile"  # the field of a run that names a profile


def as_sets(values: Mapping[str, Any], form: str = "--set {path}={value}") -> dict[str, str]:
    """How each value was given, for error messages: as on a command line, or in another form."""
    return {path: form.format(path=path, value=dumps(value, default=str)) for path, value in values.items()}


def change(content: dict[str, Any], values: Mapping[str, Any], sets: Mapping[str, str]) -> None:
    """Set fields of a run's content by their paths; `sets`: how each was given, for error messages.

    Controllers without `signals` get those of the run's profile.
    """
    if values:
        content.pop("asked", None)  # the run is no longer the one that was asked for
    if "system" in values:
        content.pop("system_file", None)
    rows = content.get("controllers") if any(".parameters" in path for path in values) else None
    for row in rows if isinstance(rows, list) else []:
        row.pop("untuned", None)
    first = {name: values[name] for name in ("system", PROFILE) if name in values}
    content.update(deepcopy(first))
    if first.get(PROFILE) is not None:
        apply_profile(content, first[PROFILE], sets[PROFILE])
    # Set a name before the fields below it.
    for field_path in sorted((key for key in values if key not in first), key=lambda key: key.count(".")):
        for key in each_path(content, field_path, partial(_open_name, content)):
            set_field(content, key, deepcopy(values[field_path]), sets[field_path])
    if isinstance(content.get(PROFILE), str) and "controllers" in {path.partition(".")[0] for path in values}:
        _add_signals(content, read_profile(content[PROFILE]), only_usual=True)
    if "supervision" in values and off(content, "supervision") and "arm_at" not in values:
        content.pop("arm_at", None)


def off(content: Mapping[str, Any], field: str) -> bool:
    """Whether a field of a run's content is off."""
    return content.get(field) in ("off", False, None)


def _open_name(content: dict[str, Any], key: str) -> None:
    """If a `--set` path continues below a name (FOLDERS), replace the name by its file's content.

    A watchdog or load noise that is off is switched on.
    """
    top, _, below = key.partition(".")
    if not below:
        return
    if top == "controllers":
        content.setdefault(top, [{}])
        open_own(content, below)
    if top == "supervision" and off(content, top):
        content[top] = STANDARD
    if top in ("watchdog", "load_noise") and off(content, top):
        content[top] = {}
    if top not in FOLDERS:
        return
    named = content.get(top, Run.model_fields[top].default)
    if not isinstance(named, str):
        return
    if top == "scenario":
        system = content.get("system", Run.model_fields["system"].default)
        table = system if isinstance(system, dict) else read_table(find("systems", str(system)))
        scenario = read_table(find("scenarios", named, f"{table.get('name', '')}/"))
        content.setdefault("duration", scenario.get("duration", Scenario.model_fields["duration"].default))
        content[top] = scenario.get("events", [])
        if scenario.get("dispatch"):
            _open_name(content, "system.machines")
            for row in (*content["system"].get("machines", []), *content["system"].get("inverters", [])):
                row.update({"P": scenario["dispatch"].get(row.get("name"), row.get("P"))})
    else:
        content[top] = read_table(find(FOLDERS[top], named))
        if top == "system" and is_path(named):
            content["system_file"] = named


def read_profile(name: str) -> Profile:
    """A profile by name or path."""
    return checked(Profile, read_source("profiles", name, PROFILE))


def apply_profile(content: dict[str, Any], source: Any, where: str, fixed: Collection[str] = ()) -> None:
    """Set the fields of a profile in a run's content, except those in `fixed`, which the run sets itself.

    `where`: start of error messages.
    """
    if not isinstance(source, str):
        raise InputError(f"{where}: {short(source)} given; allowed: {', '.join(shipped('profiles'))}, or a YAML file")
    profile = read_profile(source)
    content[PROFILE] = source
    _open_name(content, "system.name")
    if not isinstance(content["system"], dict):
        system_text = short(content["system"])
        raise InputError(f"{where}: system: {system_text} given; allowed: a name, a YAML file, or a system")
    values = {**profile.set, **profile.systems.get(str(content["system"].get("name")), {})}
    for path in sorted(values, key=lambda key: key.count(".")):
        into_list = path.startswith("system.") and ".*" in path
        if path in fixed or (into_list and not content["system"].get(path.split(".")[1])):
            continue  # a path into a list needs a list with entries
        for key in each_path(content, path, partial(_open_name, content)):
            set_field(content, key, deepcopy(values[path]), f"{where}: {path}")
    _add_signals(content, profile, only_usual=PROFILE in fixed)
    if profile.fixed_model and "model" not in fixed:
        content["model"] = deepcopy(content["system"])


def _add_signals(content: dict[str, Any], profile: Profile, *, only_usual: bool) -> None:
    """Replace controllers' signals by those of a profile; `only_usual`: only where a controller names none."""
    rows = content.setdefault("controllers", [{}])
    for row in rows if isinstance(rows, list) else []:
        if isinstance(row, dict) and not (only_usual and "signals" in row):
            signals = row.get("signals", Controller().signals)
            row["signals"] = profile.given(signals) if isinstance(signals, list) else signals
