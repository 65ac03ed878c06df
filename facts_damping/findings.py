"""The main results of a run in a few lines, for the terminal, notebooks and `print`."""

from __future__ import annotations

from itertools import combinations
from typing import TYPE_CHECKING, Any

import numpy as np

from facts_damping.analysis.indices import performance_indices
from facts_damping.analysis.measures import columns, speed_differences
from facts_damping.analysis.response import noisy, variance_ratio
from facts_damping.analysis.supervision import history_text
from facts_damping.analysis.verdict import DAMPED, GROWING
from facts_damping.case.loading import recorded_case
from facts_damping.errors import FactsDampingError, one_line
from facts_damping.parameters.events import ELEMENTS
from facts_damping.simulation import loop

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from facts_damping.analysis.summary import Summary
    from facts_damping.case.model import Case
    from facts_damping.record import Record

KINDS = {
    "fault": "fault",
    "brake": "braking",
    "line_out": "trip",
    "line_in": "reclosing",
    "load_step": "step",
    "mechanical_power_step": "mechanical power step",
    "generator_trip": "trip",
}  # common names of events; others keep their own
UNSAID = ("clear", "brake_out")  # events that titles leave out
EVENTS, CONTROLLERS, LINK, MEASUREMENT, SEED = range(5)  # parts of a title
MAXIMUM = 3  # elements with events in a title, at most
NO_CONTROL: dict[str, Any] = {"controllers": [], "supervision": None, "arm_at": None, "asked": None}


def findings(record: Record, summary: Summary, free: Record | FactsDampingError | None) -> list[str]:
    """Lines: title, verdict, index compared with no control, actions of supervisors, warnings.

    `summary`: of the record (`analysis.summarise`); `free`: its run without control (`run_to_compare`).
    """
    return [
        title(record),
        _verdict(summary),
        *_index(record, summary, free),
        *(f"supervisor of {history.controller}: {history_text(history)}" for history in summary.supervision),
        *(f"warning: {line}" for line in summary.warnings),
    ]


def run_to_compare(record: Record, summary: Summary) -> Record | FactsDampingError | None:
    """Simulate a record's run without control, or the error of that; None if there is no index to compare."""
    if not _has_index(record, summary) or not record.configuration.get("controllers"):
        return None
    try:
        return without_control(record)
    except FactsDampingError as error:
        return error


def title(record: Record) -> str:
    """Grid, events, controllers and link of a record as text."""
    run = record.configuration
    if not run:
        return "a recording without its run"
    what, who, link, *_ = _parts(record)
    return f"{what}: {who}{f' over {link}' if run.get('controllers') else ''}"


def names(records: Sequence[Record]) -> list[str]:
    """Short names of records: as few parts as distinguish them, numbered if none do; a single one gets its title."""
    if len(records) == 1:
        return [title(records[0])]
    rows = [_parts(record) if record.configuration else (title(record),) * 5 for record in records]
    for count in range(1, 6):
        for chosen in combinations((CONTROLLERS, LINK, EVENTS, MEASUREMENT, SEED), count):
            short_names = [", ".join(row[i] for i in chosen) for row in rows]
            if len(set(short_names)) == len(short_names):
                return short_names
    return [f"{i + 1} {row[CONTROLLERS]}" for i, row in enumerate(rows)]


def names_of_seeds(records: Sequence[Record]) -> list[str]:
    """Names of records; records that differ only in their seeds share one."""
    kinds = [tuple(sorted((key, repr(value)) for key, value in run.asked.items() if key != "seed")) for run in records]
    first = {kind: record for kind, record in reversed(list(zip(kinds, records, strict=True))) if kind}
    if len(first) == len(records) or not all(kinds):
        return names(records)
    short = dict(zip(first, names(list(first.values())), strict=True))
    return [f"{short[kind]} ({kinds.count(kind)} seeds)" if kinds.count(kind) > 1 else short[kind] for kind in kinds]


def _parts(record: Record) -> tuple[str, ...]:
    """Texts: grid and events, controllers, link, measurement, seed."""
    run = record.configuration
    grid = clause(run["system"])
    what = ", ".join([grid[0].upper() + grid[1:], *_events(run.get("scenario") or [])])
    named = isinstance(record.asked.get("link"), str)
    link = f"{clause(run['link']) or 'a link'}{'' if named else ', changed'}"
    who = _several([row["name"] for row in run.get("controllers") or []]) or "no control"
    return what, who, link, clause(run.get("measurement") or {}), f"seed {run.get('seed')}"


def clause(table: Mapping[str, Any]) -> str:
    """Start of the description of a shipped table; else its name."""
    begins = str(table.get("description") or "").partition(",")[0].partition(" (")[0].strip()
    return begins or str(table.get("name", "")).replace("_", " ")


def _events(events: Sequence[Mapping[str, Any]]) -> list[str]:
    """Events grouped by element: `fault and trip of line 3`."""
    by_element: dict[str, list[str]] = {}
    for event in sorted(events, key=lambda event: float(event["time"])):
        if event["kind"] not in UNSAID:
            element = next((str(event[name]) for name in ELEMENTS if event.get(name) is not None), "")
            kind = KINDS.get(event["kind"], event["kind"].replace("_", " "))
            kinds = by_element.setdefault(element.replace("_", " "), [])
            kinds += [] if kind in kinds else [kind]
    texts = [f"{_several(kinds)} of {element}" for element, kinds in by_element.items()]
    more = [f"{len(texts) - MAXIMUM} more"] if len(texts) > MAXIMUM else []
    return [_several([*texts[:MAXIMUM], *more])] if texts else []


def _several(words: Sequence[str]) -> str:
    """Words joined by commas and `and`."""
    return " and ".join([", ".join(words[:-1]), words[-1]]) if len(words) > 1 else "".join(words)


def _verdict(summary: Summary) -> str:
    """The verdict with its reason."""
    mode, growth = summary.deciding_mode, summary.growth_per_s
    if summary.verdict not in (DAMPED, GROWING) or mode is None:
        rate = f" by {growth.value:.3g} 1/s in {growth.signal}" if growth and summary.verdict == GROWING else ""
        return f"{summary.verdict}: {summary.verdict_because}{rate}"
    return f"{summary.verdict}; damping ratio {100 * mode.damping_ratio:.1f} % at {mode.frequency_hz:.2f} Hz"


def _has_index(record: Record, summary: Summary) -> bool:
    return summary.indices is not None and bool(record.configuration.get("scenario") or noisy(record.configuration))


def _index(record: Record, summary: Summary, free: Record | FactsDampingError | None) -> list[str]:
    """ITAE of a run with an event, or the variance in noise alone, beside the same run without control."""
    if not _has_index(record, summary):
        return []
    event = bool(record.configuration.get("scenario"))
    index = itae(record) if event else _rms(record)
    text = f"ITAE {index:.3g}" if event else f"rms of the speed differences in noise {index:.3g}"
    if free is None:
        return [text]
    if isinstance(free, FactsDampingError):
        return [f"{text}; the run without control fails: {one_line(free)}"]
    if not free.in_synchronism.all():
        return [f"{text}; without control synchronism is lost at {free.time_s[-1]:.1f} s"]
    other = itae(free) if event else _rms(free)
    if not other:  # nothing has happened yet
        return [f"{text}, without control 0"]
    change = _change(index / other) if event else f"variance {_variance(record, free, (index / other) ** 2)}"
    return [f"{text}, without control {other:.3g}: {change}"]


def _variance(record: Record, free: Record, whole: float) -> str:
    """The change of the variance in noise, with its interval where the run is long enough; `whole`: ratio without."""
    ratio = variance_ratio(record.time_s, *(columns(speed_differences(run)) for run in (record, free)))
    if ratio is None:
        return f"{_change(whole)} (no interval: run shorter than a minute)"
    return f"{_change(ratio[0])} (90 % interval: {_change(ratio[1])} to {_change(ratio[2])})"


def _change(ratio: float) -> str:
    """A ratio as a change in percent."""
    change = round(100.0 * (ratio - 1.0))
    return f"{abs(change)} % {'more' if change > 0 else 'less'}" if change else "the same"


def itae(record: Record) -> float:
    """ITAE of the speed differences, p.u. s^2."""
    return float(performance_indices(record.time_s, columns(speed_differences(record)))["ITAE"])


def _rms(record: Record) -> float:
    """Root mean square of all speed differences, p.u."""
    return float(np.sqrt(np.mean(columns(speed_differences(record)) ** 2)))


def without_control(record: Record) -> Record:
    """The record's run without controllers, simulated in process over the same time. Raises `FactsDampingError`."""
    over = {"duration": len(record.time_ns) / record.frame_rate}
    return loop.run(uncontrolled({**record.configuration, **over}))


def uncontrolled(configuration: Mapping[str, Any]) -> Case:
    """The case of a record's configuration without controllers and supervision. Raises `FactsDampingError`."""
    return recorded_case({**configuration, **NO_CONTROL}, "without control")
