"""From recordings to what a report says."""

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
FIRST = ("tie_power", "differences")  # of these the first that there is
TIME = ("differences", "tie_power", "speeds", "voltage", "centre_of_angle")
LEARNT = ("jacobian", "learning_rate")
MOST_EVENTS = 12  # that are named one by one


def build(runs: Sequence[ReportedRun], baseline: int = 0) -> Report:
    """What is said of the runs, in the order in which it is read; a section that would be empty is left out.

    `baseline`: index of the run that improvement counts from.
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
    """In what the runs differ so that their figures say nothing about each other: system, scenario, duration."""
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
    """What a reader has to know of a run before its figures."""
    found = [f"{run.name}: {note}." for note in run.record.notes]
    if run.summary["stable"] is False:
        end = float(run.record.time_s[-1])
        found.append(f"{run.name} is not stable: {run.summary['instability']} at {end:.2f} s. It has no indices.")
    if run.summary["stable"] is None:
        found.append(f"Whether {run.name} is stable is not known: {run.summary['verdict_because']}. It has no indices.")
    return found


def _trips(runs: Sequence[ReportedRun]) -> list[tuple[float, str]]:
    """Time (s) of each trip of a controller, in words."""
    several = len(runs) > 1
    return [
        (round(time, 3), f"{run.name}: " * several + f"{controller} tripped by {cause}")
        for run in runs
        for time, controller, cause in trips(run.summary.get("supervision") or ())
    ]


def _releases(runs: Sequence[ReportedRun]) -> list[tuple[float, str]]:
    """Time (s) of each release of a device by its watchdog."""
    several = len(runs) > 1
    return [
        (round(one["time_s"], 3), f"{run.name}: " * several + f"{one['device']} released")
        for run in runs
        for one in run.summary.get("releases") or ()
    ]


def _cuts(runs: Sequence[ReportedRun]) -> list[tuple[float, str]]:
    """Begin and end (s) of the times in which a link loses everything."""
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
    """All stages of a run's links, those of controllers too."""
    links = [configuration.get("link"), *(one.get("link") for one in configuration.get("controllers") or ())]
    return [stage for link in links if isinstance(link, dict) for part in ("up", "down") for stage in link[part]]


def _events(records: Sequence[Record]) -> list[tuple[float, str]]:
    """Time (s), kind and element of what happened to the grid within the runs, each once."""
    found = {
        (event["time_ns"] / NANOSECONDS, f"{event['kind'].replace('_', ' ')} {event['element']}".strip())
        for record in records
        for event in record.events
        if event["time_ns"] <= record.time_ns[-1]
    }
    return sorted(found)
