"""Builds a report's contents from recordings."""

from __future__ import annotations

from typing import TYPE_CHECKING

from facts_damping.analysis.supervision import trips
from facts_damping.report import tables
from facts_damping.report.charts import charts, modes
from facts_damping.report.contents import Report, Section
from facts_damping.report.lead import lead, tiles
from facts_damping.report.maps import maps
from facts_damping.signals import NANOSECONDS

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from typing import Any

    from facts_damping.report.contents import ReportedRun
    from facts_damping.signals import Record

# Pictures of `analysis.pictures` by section.
FIRST = ("tie_power", "differences")  # the first of these that has data opens the report
TIME = ("differences", "tie_power", "speeds", "voltage", "centre_of_angle")
LEARNT = ("jacobian", "learning_rate")
MAX_EVENTS = 12  # listed one by one


def build(runs: Sequence[ReportedRun], baseline: int = 0) -> Report:
    """The report's contents in reading order; empty sections are left out.

    `baseline`: index of the run that improvement refers to.
    """
    unlike = differences([run.record for run in runs])
    improvements = [] if unlike else tables.improvements(runs, baseline)
    first = charts(runs, FIRST)[:1]
    sections = [
        Section("What happened", first),
        Section("Summary", [tables.summary(runs, not unlike), *improvements]),
        Section("Over time", charts(runs, [stem for stem in TIME if stem not in [one.key for one in first]])),
        Section("Performance indices", charts(runs, ("indices",))),
        Section("Modes", [tables.modes(runs), *modes(runs), *maps(runs)]),
        Section("Control effort", [*charts(runs, ("injected_voltage",)), tables.effort(runs)]),
        Section("Supervision", [*charts(runs, ("supervision", "monitors")), *tables.supervision(runs)]),
        Section("Links", [tables.links(runs), *charts(runs, ("latency",))]),
        Section("What was learnt", charts(runs, LEARNT)),
        Section("Conditions", [tables.conditions(runs)]),
    ]
    names = [run.name for run in runs]
    return Report(
        title=names[0] if len(names) == 1 else f"{len(names)} runs side by side",
        names=names,
        lead=lead(runs, baseline, not unlike),
        tiles=tiles(runs),
        remarks=[*_unlike(unlike), *(remark for run in runs for remark in _remarks(run))],
        events=sorted({*_events([run.record for run in runs]), *_trips(runs), *_releases(runs), *_cuts(runs)}),
        sections=[section for section in sections if section.items],
    )


def differences(records: Sequence[Record]) -> list[str]:
    """Differences that make the runs' figures incomparable: system, scenario, duration."""
    found = {
        "system": [record.asked.get("system") for record in records],
        "scenario": [record.asked.get("scenario") for record in records],
        "duration": [record.configuration.get("duration") for record in records],
    }
    return [name for name, values in found.items() if any(value != values[0] for value in values)]


def _unlike(unlike: Sequence[str]) -> list[str]:
    if not unlike:
        return []
    return [f"The runs differ in {' and '.join(unlike)}: their figures cannot be compared, and none is marked as best."]


def _remarks(run: ReportedRun) -> list[str]:
    """Remarks that a reader needs before a run's figures."""
    found = [f"{run.name}: {note}." for note in run.record.notes]
    if run.summary["stable"] is False:
        end = float(run.record.time_s[-1])
        found.append(f"{run.name} is not stable: {run.summary['instability']} at {end:.2f} s. It has no indices.")
    if run.summary["stable"] is None:
        found.append(f"Whether {run.name} is stable is not known: {run.summary['verdict_because']}. It has no indices.")
    return found


def _trips(runs: Sequence[ReportedRun]) -> list[tuple[float, str]]:
    """Time (s) and text of each trip of a controller."""
    several = len(runs) > 1
    return [
        (round(time, 3), f"{run.name}: " * several + f"{controller} tripped by {cause}")
        for run in runs
        for time, controller, cause in trips(run.summary.get("supervision") or ())
    ]


def _releases(runs: Sequence[ReportedRun]) -> list[tuple[float, str]]:
    """Time (s) and text of each release of a device by its watchdog."""
    several = len(runs) > 1
    return [
        (round(one["time_s"], 3), f"{run.name}: " * several + f"{one['device']} released")
        for run in runs
        for one in run.summary.get("releases") or ()
    ]


def _cuts(runs: Sequence[ReportedRun]) -> list[tuple[float, str]]:
    """Start and end (s) of the times in which a link loses everything."""
    found = {
        (round(time, 3), f"link {what}")
        for run in runs
        for stage in _stages(run.record.configuration)
        if stage.get("loss") == 1.0 and stage.get("duration") is not None
        for time, what in ((stage["start"], "cut"), (stage["start"] + stage["duration"], "back"))
        if time <= float(run.record.time_s[-1])
    }
    return sorted(found)


def _stages(configuration: Mapping[str, Any]) -> list[dict[str, Any]]:
    """All stages of the run's link and of controllers' own links."""
    links = [configuration.get("link"), *(one.get("link") for one in configuration.get("controllers") or ())]
    return [stage for link in links if isinstance(link, dict) for part in ("up", "down") for stage in link[part]]


def _events(records: Sequence[Record]) -> list[tuple[float, str]]:
    """Time (s), kind and element of the grid events within the runs, without duplicates."""
    found = {
        (event.time_ns / NANOSECONDS, f"{event.kind.replace('_', ' ')} {event.element}".strip())
        for record in records
        for event in record.events
        if event.time_ns <= record.time_ns[-1]
    }
    return sorted(found)
