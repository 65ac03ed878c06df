"""From what the user wrote (YAML files, `--set`) to a checked case that everything else is built from."""

from __future__ import annotations

import io
import re
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, TypeVar

from pydantic import ValidationError
from ruamel.yaml import YAML
from ruamel.yaml.error import YAMLError

from facts_damping.control.table import CONTROLLERS
from facts_damping.errors import InputError
from facts_damping.parameters.base import Model
from facts_damping.parameters.run import Link, Run, Scenario
from facts_damping.parameters.system import System

M = TypeVar("M", bound=Model)

KINDS = ("systems", "scenarios", "links", "runs")
MAX_FILE_BYTES = 10_000_000


@dataclass(frozen=True)
class Case:
    """A checked run: what the user asked for, and the files it names, read."""

    run: Run
    system: System
    scenario: Scenario
    link: Link

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
            "asked": self.summary(),
            "duration": self.duration,
            "system": self.system.model_dump(by_alias=True),
            "scenario": [event.model_dump() for event in self.scenario.events],
            "link": self.link.model_dump(),
        }


@cache
def share_folder() -> Path:
    """Folder that holds `config`: a checkout, or `share/facts_damping` of an installation."""
    for parent in Path(__file__).resolve().parents:
        for folder in (parent, parent / "share" / "facts_damping"):
            if (folder / "package.xml").is_file() and (folder / "config").is_dir():
                return folder
    raise InputError(f"no config folder found above {Path(__file__).resolve().parent}; allowed: a checkout or an installation")


def shipped(kind: str) -> dict[str, Path]:
    """Names and files of what is shipped: `systems`, `scenarios` (as system/name), `links`, `runs`."""
    folder = share_folder() / "config" / kind
    return {str(f.relative_to(folder).with_suffix("")): f for f in sorted(folder.rglob("*.yaml"))}


def find(kind: str, name: str, within: str = "") -> Path:
    """File of a shipped name (a scenario's within its system), or of a path."""
    path = Path(name)
    if path.suffix in (".yaml", ".yml") or "/" in name:
        if not path.is_file():
            raise InputError(f"{path}: no such file; allowed: an existing YAML file")
        return path
    known = {n.removeprefix(within): f for n, f in shipped(kind).items() if n.startswith(within)}
    if name not in known:
        raise InputError(f"{kind}: '{name}' given; allowed: {', '.join(known) or 'none'}, or the path of a YAML file")
    return known[name]


def read_yaml(path: Path) -> Any:
    """Content of a YAML file; `InputError` where it cannot be read."""
    try:
        if path.stat().st_size > MAX_FILE_BYTES:
            raise InputError(f"{path}: {path.stat().st_size} bytes; allowed: at most {MAX_FILE_BYTES}")
        return YAML(typ="safe", pure=True).load(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: cannot be read: {error}") from error
    except (YAMLError, ValueError, TypeError, RecursionError, AttributeError, KeyError, IndexError) as error:
        mark = getattr(error, "problem_mark", None)
        line = f"line {mark.line + 1}: " if mark is not None else ""
        problem = getattr(error, "problem", None) or str(error).splitlines()[0] or type(error).__name__
        raise InputError(f"{path}: {line}unreadable YAML: {problem}; allowed: YAML 1.2") from error


def read_table(path: Path) -> dict[str, Any]:
    """Content of a YAML file that is a mapping with text keys; `extends` builds on another file of the folder."""
    content = read_yaml(path)
    if not isinstance(content, dict) or not all(isinstance(key, str) for key in content):
        raise InputError(f"{path}: {_short(content)} given; allowed: a mapping of names to values")
    if "extends" in content:
        base = content.pop("extends")
        file = path.parent / f"{base}.yaml"
        if not isinstance(base, str) or not file.is_file() or file.resolve() == path.resolve():
            raise InputError(f"{path}: extends: {_short(base)} given; allowed: the name of another file in its folder")
        parent = read_yaml(file)
        if not isinstance(parent, dict) or "extends" in parent:
            raise InputError(f"{path}: extends: '{base}' given; allowed: a file that does not extend another itself")
        content = {**parent, **content}
    return content


def _short(value: Any) -> str:
    text = " ".join(repr(value).split())
    return text if len(text) <= 60 else text[:57] + "..."


def _place(error_location: tuple[int | str, ...], content: Any) -> list[str]:
    """An error's location as keys of the content: without pydantic's own tags."""
    found: list[str] = []
    for i, part in enumerate(error_location):
        last = i == len(error_location) - 1
        if isinstance(content, dict) and part in content:
            content = content[part]
        elif isinstance(content, list) and isinstance(part, int) and part < len(content):
            content = content[part]
        elif not (last and isinstance(content, dict)) or (isinstance(part, str) and re.search(r"[\[\]-]", part)):
            continue
        found.append(str(part))
    return found


def _allowed_keys(model: type[Model], location: tuple[int | str, ...]) -> str:
    """Keys that are allowed at a location of a model."""
    here: Any = model
    for part in location[:-1]:
        schema = here.model_fields if isinstance(here, type) and issubclass(here, Model) else {}
        by_key = {field.alias or name: field for name, field in schema.items()}
        if part in by_key:
            here = by_key[part].annotation
        while not (isinstance(here, type) and issubclass(here, Model)):
            inside = [a for a in getattr(here, "__args__", ()) if a is not type(None)]
            tagged = [a for a in inside if isinstance(a, type) and issubclass(a, Model) and _has_tag(a, location)]
            if not inside:
                break
            here = (tagged or inside)[-1]
    if isinstance(here, type) and issubclass(here, Model):
        return ", ".join(field.alias or name for name, field in here.model_fields.items())
    return "none"


def _has_tag(model: type[Model], location: tuple[int | str, ...]) -> bool:
    kind = model.model_fields.get("kind")
    return kind is not None and any(part in getattr(kind.annotation, "__args__", ()) for part in location)


def check(model: type[M], content: Any, source: str, sets: dict[str, str] | None = None, under: str = "") -> M:
    """Content as a model; the first error as one line: source, field, value, what is allowed."""
    try:
        return model.model_validate(content)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
    location, given = first["loc"], first["input"]
    keys = _place(location, content)
    field = ".".join([under, *keys] if under else keys)
    changed = next((f"--set {k}={v}" for k, v in (sets or {}).items() if field == k or field.startswith(f"{k}.")), None)
    where = f"{changed or source}: {field}" if field else changed or source
    message = re.sub(r"^Value error, ", "", first["msg"])
    if first["type"] == "extra_forbidden":
        raise InputError(f"{where}: unknown key; allowed: {_allowed_keys(model, location)}")
    if first["type"] == "missing":
        raise InputError(f"{where}: missing; allowed: a value of this field")
    if first["type"] == "value_error":
        raise InputError(f"{where}: {message}")
    allowed = re.sub(r"^(Input should be|Input should have|.* should have|.* should match) ", "", message)
    raise InputError(f"{where}: {_short(given)} given; allowed: {allowed}")


def parse_set(text: str) -> tuple[str, str]:
    """`key.path=value` as its two parts."""
    key, equals, value = text.partition("=")
    if not equals or not re.fullmatch(r"[A-Za-z_0-9]+(\.[A-Za-z_0-9+-]+)*", key):
        raise InputError(f"--set {text}: given; allowed: key.path=value")
    return key, value


def set_field(content: dict[str, Any], key: str, value: Any, where: str) -> None:
    """Set a field by its path; an index one past a list's end appends a row."""
    here: Any = content
    parts = key.split(".")
    for i, part in enumerate(parts):
        last = i == len(parts) - 1
        if isinstance(here, list):
            if not part.isdigit() or int(part) > len(here):
                raise InputError(f"{where}: {'.'.join(parts[: i + 1])}: '{part}' given; allowed: an index from 0 to {len(here)}")
            if int(part) == len(here):
                here.append({})
            index: Any = int(part)
        elif isinstance(here, dict):
            index = part
            if not last and part not in here:
                here[part] = {}
        else:
            raise InputError(f"{where}: {'.'.join(parts[:i])}: {_short(here)} given, which has no fields; allowed: a section")
        if last:
            here[index] = value
        else:
            here = here[index]


def _value(text: str, where: str) -> Any:
    try:
        return YAML(typ="safe", pure=True).load(text)
    except (YAMLError, ValueError, TypeError, RecursionError) as error:
        raise InputError(f"{where}: unreadable value; allowed: a YAML value") from error


def load_system(name: str, sets: list[str] | None = None) -> System:
    """A system by name or path, with `--set` applied to its fields."""
    path = find("systems", name)
    content = read_table(path)
    pairs = dict(parse_set(text) for text in sets or [])
    for key, value in pairs.items():
        set_field(content, key, _value(value, f"--set {key}={value}"), f"--set {key}={value}")
    return check(System, content, str(path), pairs)


def load_case(name: str | None, sets: list[str] | None = None) -> Case:
    """A run by name or path (none: all defaults), with `--set` applied, and all that it names."""
    path = None if name is None else find("runs", name)
    content = {} if path is None else read_table(path)
    pairs = dict(parse_set(text) for text in sets or [])
    if pairs:
        content.pop("asked", None)  # no longer what was asked for
    ordered = sorted(pairs.items(), key=lambda pair: pair[0].count("."))  # names before what lies below them
    for key, value in ordered:
        where = f"--set {key}={value}"
        _open_name(content, key, where)
        set_field(content, key, _value(value, where), where)
    return make_case(content, str(path or "defaults"), pairs)


def _open_name(content: dict[str, Any], key: str, where: str) -> None:
    """Where a `--set` goes below a name (system, scenario, link), put the named file's content in its place."""
    top, _, below = key.partition(".")
    if not below:
        return
    if top == "controllers":
        content.setdefault(top, [{}])
    if top not in ("system", "scenario", "link"):
        return
    named = content.get(top, Run.model_fields[top].default)
    if not isinstance(named, str):
        return
    if top == "scenario":
        system = content.get("system", Run.model_fields["system"].default)
        within = system.get("name", "") if isinstance(system, dict) else load_system(str(system)).name
        scenario = read_table(find("scenarios", named, f"{within}/"))
        content.setdefault("duration", scenario.get("duration", Scenario.model_fields["duration"].default))
        content[top] = scenario.get("events", [])
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
    if isinstance(run.link, str):
        path = find("links", run.link)
        link = check(Link, read_table(path), str(path))
    else:
        link = check(Link, run.link, source, sets, "link")
    case = Case(run, system, scenario, link)
    _check_case(case, source)
    return case


def _known(where: str, name: str, allowed: list[str]) -> None:
    if name not in allowed:
        raise InputError(f"{where}: '{name}' given; allowed: {', '.join(allowed) or 'none'}")


def _check_case(case: Case, source: str) -> None:
    """What one file alone cannot tell: devices, controllers, signals and parameters that are not there."""
    run, system = case.run, case.system
    for i, device in enumerate(run.devices):
        _known(f"{source}: devices.{i}", device, [d.name for d in system.devices])
    if len(run.devices) > 1:
        raise InputError(f"{source}: devices: {len(run.devices)} given; allowed: one device at most")
    commanded: set[str] = set()
    for c, controller in enumerate(run.controllers):
        where = f"{source}: controllers.{c}"
        _known(f"{where}.name", controller.name, list(CONTROLLERS))
        kind = CONTROLLERS[controller.name]
        for device in controller.devices:
            _known(f"{where}.devices", device, run.devices)
            if device in commanded:
                raise InputError(f"{where}.devices: '{device}' given, which is commanded already; allowed: each device once")
            commanded.add(device)
        for signal in controller.signals:
            _known(f"{where}.signals", signal, list(system.signals))
        for field, count in (("signals", kind.signals), ("devices", kind.devices)):
            if len(getattr(controller, field)) != count:
                raise InputError(f"{where}.{field}: {len(getattr(controller, field))} given; allowed: {count} for {controller.name}")
        for name, value in controller.parameters.items():
            _known(f"{where}.parameters", name, list(kind.parameters))
            p = kind.parameters[name]
            if not p.low <= value <= p.high:
                raise InputError(f"{where}.parameters.{name}: {value:g} given; allowed: {p.low:g} to {p.high:g} {p.unit}")


def dump(content: Any) -> str:
    """Content as YAML text."""
    stream = io.StringIO()
    writer = YAML(typ="safe", pure=True)
    writer.default_flow_style = False
    writer.dump(content, stream)
    return stream.getvalue()
