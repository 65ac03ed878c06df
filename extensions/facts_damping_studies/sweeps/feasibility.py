"""Check of a study before its first run: each different run is built once, and all that is refused is told together."""

from __future__ import annotations

import json
from functools import partial
from typing import TYPE_CHECKING, Any

from facts_damping.errors import InputError
from facts_damping.output.tables import some_of
from facts_damping_studies.sweeps.batch import refusal
from facts_damping_studies.sweeps.results import label, varying

if TYPE_CHECKING:
    from collections.abc import Collection, Sequence

    from facts_damping_studies.sweeps.batch import Base, RunRequest
    from facts_damping_studies.sweeps.pool import Each


def check(base: Base, requests: Sequence[RunRequest], random: Collection[str], each: Each) -> None:
    """Raise `InputError` that names all different runs whose input is refused; `random`: columns that do not count."""
    todo = different(requests, random)
    refused = {key: error for key, error in each(partial(refusal, base), todo) if error is not None}
    if not refused:
        return
    columns = [{name: value for name, value in task.columns.items() if name not in random} for task in todo]
    names, labels = varying(columns, ()), dict[str, list[str]]()
    for task in todo:
        if task.key in refused:
            error = refused[task.key].removeprefix(f"{base.source}: ")
            labels.setdefault(error, []).append(label(task.columns, names))
    reasons = [f"{some_of(who)}: {error}" if any(who) else error for error, who in labels.items()]
    count = f"{len(refused)} of {len(todo)} different runs cannot be made (--only leaves runs out)"
    raise InputError(f"{base.source}: {count}: {'; '.join(reasons)}")


def different(requests: Sequence[RunRequest], random: Collection[str]) -> list[RunRequest]:
    """Runs that differ in more than numbers, or have a number that none before has; random columns do not count."""
    seen: set[tuple[str, ...]] = set()
    todo: list[RunRequest] = []
    for task in requests:
        columns = {name: value for name, value in task.columns.items() if name not in random}
        numbers = {name: value for name, value in columns.items() if _is_number(value)}
        fields = [(name, value) for name, value in (columns | task.changes).items() if not _is_number(value)]
        features = {(json.dumps(fields, default=str),), *((name, str(value)) for name, value in numbers.items())}
        if not features <= seen:
            seen |= features
            todo.append(task)
    return todo


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)
