"""The files of users' programs on a card, so that it can be measured again from one file."""

from __future__ import annotations

from base64 import b64decode, b64encode
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

from facts_damping.errors import InputError
from facts_damping.input_files import FMU, read_bytes
from facts_damping.output.writing import replacing, write_whole

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

BINARY = "base64:"  # start of the content of a file that is no text


def files_of(rows: Sequence[Mapping[str, Any]], read: Sequence[str]) -> dict[str, str]:
    """Name: content, of the programs of controllers and of the files that they `read` beside them.

    Raises `InputError`.
    """
    paths = dict.fromkeys([*(path.resolve() for row in rows for path in _programs(row)), *map(Path, read)])
    names = [path.name for path in paths]
    if twice := sorted({name for name in names if names.count(name) > 1}):
        raise InputError(f"controllers: two files named {', '.join(twice)} given; allowed: names that differ")
    return {path.name: _content(path) for path in paths}


def _programs(row: Mapping[str, Any]) -> list[Path]:
    if row.get("policy"):
        place = str(row["policy"]).rpartition(":")[0]
        return [Path(place) if place.endswith(".py") else _of_module(place)]
    source = row.get("fmu") or row.get("linear")
    file = source.get("file") if isinstance(source, dict) else source
    return [Path(str(file))] if file else []


def _of_module(name: str) -> Path:
    """The file of a module, which is not imported."""
    module = find_spec(name)
    if module is None or not module.origin:
        raise InputError(f"policy: module '{name}' given; allowed: one with a file")
    return Path(module.origin)


def _content(path: Path) -> str:
    content = read_bytes(path, FMU)
    try:
        return content.decode("utf-8")
    except UnicodeDecodeError:
        return BINARY + b64encode(content).decode()


def unpacked(rows: Sequence[Mapping[str, Any]], files: Mapping[str, str], folder: Path) -> list[dict[str, Any]]:
    """Write the files of a card into a folder; return the rows with their places."""
    for name, content in files.items():
        path = folder / Path(name).name
        if content.startswith(BINARY):
            with replacing(path) as beside:
                beside.write_bytes(b64decode(content.removeprefix(BINARY)))
        else:
            write_whole(path, content)
    return [_placed(dict(row), folder) for row in rows]


def _placed(row: dict[str, Any], folder: Path) -> dict[str, Any]:
    if row.get("policy"):
        place, _, name = str(row["policy"]).rpartition(":")
        file = Path(place).name if place.endswith(".py") else f"{place.rpartition('.')[2]}.py"
        return {**row, "policy": f"{folder / file}:{name}"}
    for field in ("fmu", "linear"):
        source = row.get(field)
        if isinstance(source, dict) and source.get("file"):
            return {**row, field: {**source, "file": str(folder / Path(str(source["file"])).name)}}
        if isinstance(source, str):
            return {**row, field: str(folder / Path(source).name)}
    return row
