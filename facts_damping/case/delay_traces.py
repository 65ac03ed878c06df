"""Measured delays of a link from a table or a recording, for stages of model `trace`."""

from __future__ import annotations

import csv
from io import StringIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from facts_damping.errors import InputError, RecordingError
from facts_damping.input_files import read_text
from facts_damping.parameters.field_errors import check, short
from facts_damping.parameters.stages import Trace
from facts_damping.signals import NANOSECONDS

if TYPE_CHECKING:
    from collections.abc import Iterable

    from facts_damping.parameters.link import Link
    from facts_damping.record import Record

    Series = list[float | None]

ALL = "delay_s"  # the column that holds for all channels


def with_traces(link: Link) -> Link:
    """A link with the delays of its traces inline, read from the files that they name.

    Raises `InputError` for a file that cannot be read or holds no delays.
    """
    changed: dict[str, Any] = {}
    for way in ("up", "down"):
        for i, stage in enumerate(getattr(link, way)):
            if isinstance(stage, Trace) and stage.file is not None:
                here = f"{way}.{i}.file"
                content = {**stage.model_dump(), "file": None, "delays": _read(Path(stage.file), way, here)}
                changed.setdefault(way, list(getattr(link, way)))[i] = check(Trace, content, here)
    return link.model_copy(update=changed) if changed else link


def _read(path: Path, way: str, where: str) -> Series | dict[str, Series]:
    if path.suffix.lower() == ".csv":
        return _table(path, where)
    from facts_damping.recording.reader import load  # noqa: PLC0415 (bag libraries are slow to load)

    try:
        return of_record(load(path), way)
    except (InputError, RecordingError) as error:
        raise InputError(f"{where}: {error}; allowed: a CSV file or a recording") from error


def _table(path: Path, where: str) -> Series | dict[str, Series]:
    """Delays of a CSV file with a header: `delay_s`, or one column per channel; an empty cell means lost."""
    try:
        lines = [*csv.reader(StringIO(read_text(path))), []]
    except InputError as error:
        raise InputError(f"{where}: {error}") from error
    except csv.Error as error:
        raise InputError(f"{where}: {path}: cannot be read: {error}; allowed: a CSV file or a recording") from error
    names, rows = lines[0], lines[1:]
    while rows and not any(rows[-1]):
        rows.pop()
    if not rows:
        raise InputError(f"{where}: {path} given, which holds no delays; allowed: a line of names, then delays in s")
    cells = [[*row, *[""] * (len(names) - len(row))] for row in rows]
    columns = {name: [_number(row[i], name, k, where) for k, row in enumerate(cells)] for i, name in enumerate(names)}
    return columns.get(ALL, columns)


def _number(cell: str, name: str, k: int, where: str) -> float | None:
    text = cell.strip()
    try:
        return float(text) if text else None
    except ValueError as error:
        here = f"{where}: line {k + 2}, {name}"
        raise InputError(f"{here}: {short(text)} given; allowed: a delay in s, or nothing where it was lost") from error


def of_record(record: Record, way: str) -> dict[str, Series]:
    """Delays in a recording, s: of each PMU's entries (up) or each device's setpoints (down).

    None stands for a lost entry. Entries that may still be under way at the end are left out.
    """
    if way == "down":
        rows = record.applied[np.argsort(record.applied["issued_ns"], kind="stable")]
        late = (rows["effective_ns"] - rows["issued_ns"]) / NANOSECONDS
        return _kept((name, late[rows["device"] == d].tolist()) for d, name in enumerate(record.device_names))
    delays = []
    for s, name in enumerate(record.pmus):
        log = record.delivered[record.delivered["pmu"] == s]
        log = log[np.argsort(log["arrival_ns"], kind="stable")]
        measured, first = np.unique(log["measured_ns"], return_index=True)
        late = dict(zip(measured.tolist(), ((log["arrival_ns"][first] - measured) / NANOSECONDS).tolist(), strict=True))
        last = measured.max(initial=-1)
        delays.append((name, [late.get(int(time)) for time in record.time_ns if time <= last]))
    return _kept(delays)


def _kept(series: Iterable[tuple[str, Series]]) -> dict[str, Series]:
    nonempty = {name: delays for name, delays in series if delays}
    if not nonempty:
        raise InputError("nothing was delivered in this recording")
    return nonempty
