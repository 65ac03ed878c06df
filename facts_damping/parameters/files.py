"""YAML files: where the shipped ones lie, reading and writing, each problem one line."""

from __future__ import annotations

import os
import pickle
import re
from copy import copy
from functools import cache, lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from facts_damping.errors import InputError, meant
from facts_damping.input_files import is_file, read_text, share_folder
from facts_damping.parameters.field_errors import short
from facts_damping.parameters.yaml_text import UNREADABLE, parse

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping

TAKEN_BY = {"runs": "simulate", "studies": "sweep", "campaigns": "campaign", "systems": "modes"}  # command by kind
MARKS = {"runs": "system", "studies": "sweep", "campaigns": "base_runs"}  # a field that files of a kind have
DEEPEST = 20  # levels of a file in which paths are looked for
# Fields that may name a file, and how a file is named in them.
PATHS = (
    *("system", "model", "scenario", "measurement", "link", "supervision", "profile", "run"),
    *("weights", "linear", "policy", "fmu", "file", "keys", "tuning"),
)
FILE = r"[^:\s]+\.(ya?ml|npz|mat|csv|mcap|fmu)|[^:\s]+\.py:\w+"


def shipped(kind: str) -> dict[str, Path]:
    """Names and files of what is shipped in a folder of `config`; scenarios as system/name."""
    return _named(share_folder() / "config" / kind)


@cache
def _named(folder: Path) -> dict[str, Path]:
    return {str(f.relative_to(folder).with_suffix("")): f for f in sorted(folder.rglob("*.yaml"))}


def copied(content: dict[str, Any]) -> dict[str, Any]:
    """A copy of what a file contains, in a third of the time of `deepcopy`."""
    return pickle.loads(pickle.dumps(content))  # type: ignore[no-any-return]  # noqa: S301 (our own)


def is_path(name: str) -> bool:
    """Whether what was given is a file, not the name of a shipped one."""
    return name.endswith((".yaml", ".yml")) or "/" in name


def find(kind: str, name: str, within: str = "") -> Path:
    """File of a shipped name (a scenario's within its system), or of a path."""
    path = Path(name)
    if is_path(name):
        if not is_file(path):
            raise InputError(f"{path}: no such file; allowed: an existing YAML file")
        return path
    folder = share_folder() / "config" / kind
    if name.isidentifier() and len(name) < 100 and (plain := folder / f"{within}{name}.yaml").is_file():
        return plain  # without a look at all the others: a sweep asks often
    known = {n.removeprefix(within): f for n, f in shipped(kind).items() if n.startswith(within)}
    if name not in known:
        other = next((kind_name for kind_name in TAKEN_BY if kind_name != kind and name in shipped(kind_name)), None)
        hint = f", one of the {other}, which `facts-damping {TAKEN_BY[other]}` takes" if other else meant(name, known)
        allowed = f"{', '.join(known) or 'none'}, or the path of a YAML file"
        raise InputError(f"{kind}: '{name}' given{hint}; allowed: {allowed}")
    return known[name]


def check_kind(kind: str, content: Mapping[str, Any], source: str) -> None:
    """Raise `InputError` where a file is one of another kind that another command takes."""
    other = next((kind_name for kind_name, field in MARKS.items() if kind_name != kind and field in content), None)
    if other is not None and MARKS[kind] not in content:
        takes = f"which `facts-damping {TAKEN_BY[other]}` takes"
        raise InputError(f"{source}: one of the {other} given, {takes}; allowed: one of the {kind}")


def read_yaml(path: Path) -> Any:
    """Content of a YAML file; `InputError` where it cannot be read."""
    text = read_text(path)
    try:
        return pickle.loads(_parsed(text))  # noqa: S301 (what was just read)
    except UNREADABLE as error:
        mark = getattr(error, "problem_mark", None)
        last = len(text.splitlines())  # what is missing at the end is found on the line after it
        line = f"line {min(mark.line + 1, last)}: " if mark is not None else ""
        problem = getattr(error, "problem", None) or str(error).splitlines()[0] or type(error).__name__
        raise InputError(f"{path}: {line}unreadable YAML: {problem}; allowed: YAML 1.2") from error


@lru_cache(maxsize=64)
def _parsed(text: str) -> bytes:
    """Content of YAML text, parsed once: of a system that takes longer than a run. Pickled: quick to copy."""
    return pickle.dumps(parse(text))


def read_table(path: Path) -> dict[str, Any]:
    """Content of a YAML file that is a mapping with text keys; `extends` builds on another file of the folder."""
    content = read_yaml(path)
    if not isinstance(content, dict) or not all(isinstance(key, str) for key in content):
        raise InputError(f"{path}: {short(content)} given; allowed: a mapping of names to values")
    if "extends" in content:
        base = content.pop("extends")
        file = path.parent / f"{base}.yaml"
        if not isinstance(base, str) or not is_file(file) or file.resolve() == path.resolve():
            raise InputError(f"{path}: extends: {short(base)} given; allowed: the name of another file in its folder")
        parent = read_yaml(file)
        if not isinstance(parent, dict) or "extends" in parent:
            raise InputError(f"{path}: extends: '{base}' given; allowed: a file that does not extend another itself")
        content = {**parent, **content}
    stored = content.get("asked") is not None  # a run that was loaded before: files as seen from where that was
    return content if stored else dict(anchored(content, path.parent))


def anchored(content: Any, folder: Path) -> Any:
    """Content of a file in a folder, whose relative paths begin there, down to DEEPEST.

    What YAML's aliases share stays shared, also with itself.
    """
    anchored_of: dict[tuple[int, str], Any] = {}  # by the content, and the field of which that is the value

    def of(part: Any, field: str, depth: int) -> Any:
        if isinstance(part, str):
            return str(folder / part) if field in PATHS and re.fullmatch(FILE, part) else part
        if not isinstance(part, (dict, list)) or depth > DEEPEST:
            return part
        key = id(part), field
        if key not in anchored_of:
            anchored_of[key] = part  # for what contains itself
            if isinstance(part, list):
                anchored_of[key] = [of(item, field, depth + 1) for item in part]
            else:
                axis = str(part.get("field", "")).rpartition(".")[2]  # of a study: its values are of that field
                last = {name: axis if name == "values" else str(name).rpartition(".")[2] for name in part}
                anchored_of[key] = {name: of(value, last[name], depth + 1) for name, value in part.items()}
        return anchored_of[key]

    return of(content, "", 0)


def new_folder(path: Path) -> Path:
    """A folder for results, made where it is not there yet."""
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"--out {path}: {error.strerror}; allowed: a folder that can be written") from error
    return path


def check_writable(target: str | None, option: str = "--json", *, standard: bool = True) -> None:
    """Refuse a file for results that cannot be written, before any work is done; `standard`: `-` is standard output."""
    if target is None or (standard and target == "-"):
        return
    path = Path(str(target))
    device = path.exists() and not path.is_file()
    if target == "-" or path.is_dir() or not os.access(path if device else path.resolve().parent, os.W_OK):
        also = ", or -" if standard else ""
        raise InputError(f"{option} {path}: cannot be written; allowed: a file in an existing folder{also}")


FIELD_PATH = r"[A-Za-z_0-9]+(\.([A-Za-z_0-9+-]+|\*))*"


def each_path(content: Any, key: str, opening: Callable[[str], None] = lambda _: None) -> list[str]:
    """A path with `*` in it as the paths of every entry that a list has there; another one as it is.

    `opening` is told each path before it is followed, up to and with its `*`: names on it may stand for content.
    """
    before, star, after = key.partition(".*")
    opening(before + star)
    if not star:
        return [key]
    here = content
    for part in before.split("."):
        if isinstance(here, list):
            here = here[int(part)] if part.isdigit() and int(part) < len(here) else None
        else:
            here = here.get(part) if isinstance(here, dict) else None
    if not isinstance(here, list) or not here:
        raise InputError(f"{key}: '*' given; allowed: where {before} is a list with entries")
    return [path for i in range(len(here)) for path in each_path(content, f"{before}.{i}{after}", opening)]


def read_sets(texts: Iterable[str]) -> tuple[dict[str, Any], dict[str, str]]:
    """Values of `--set key.path=value`, and what gave them, by their paths."""
    values, sets = {}, {}
    for text in texts:
        path, equals, value = text.partition("=")
        if not equals or not re.fullmatch(FIELD_PATH, path):
            raise InputError(f"--set {text}: given; allowed: key.path=value")
        sets[path] = f"--set {text}"
        values[path] = read_value(value, sets[path])
    return values, sets


def set_field(content: dict[str, Any], key: str, value: Any, where: str) -> None:
    """Set a field by its path; of a list's indices one past its end or `+` appends a row, `-1` is the last one."""
    here: Any = content
    parts = key.split(".")
    for i, key_part in enumerate(parts):
        last, part = i == len(parts) - 1, key_part
        if isinstance(here, list):
            part = {"+": str(len(here)), "-1": str(len(here) - 1)}.get(key_part, key_part)
            if not part.isdigit() or int(part) > len(here):
                path = ".".join(parts[: i + 1])
                raise InputError(f"{where}: {path}: '{part}' given; allowed: an index from 0 to {len(here)}")
            if int(part) == len(here):
                here.append({})
            index: Any = int(part)
        elif isinstance(here, dict):
            index = part
            if not last and part not in here:
                here[part] = {}
        else:
            lacks = f"{'.'.join(parts[:i])}: {short(here)} given, which has no fields"
            raise InputError(f"{where}: {lacks}; allowed: a section")
        if last:
            here[index] = value
        else:
            here[index] = here = copy(here[index])  # which an alias of YAML may have elsewhere, too


def read_value(text: str, where: str) -> Any:
    """A value as YAML reads it."""
    try:
        return parse(text)
    except UNREADABLE as error:
        raise InputError(f"{where}: unreadable value; allowed: a YAML value") from error
