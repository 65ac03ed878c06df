"""Builds a report's contents from recordings."""

from __future__ import annotations

from typing import TYPE_CHECKING

from facts_damping.analysis.supervision import trips
from facts_damping.signals import NANOSECONDS
from facts_damping_views.report import tables
from facts_damping_views.report.charts import charts, maps, modes
from facts_damping_views.report.contents import Report, Section, Tile

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence
    from typing import Any

    from facts_damping.analysis.summary import Summary
    from facts_damping.record import Record
    from facts_damping_views.report.contents import ReportedRun

# Pictures of `analysis.pictures` by section.
FIRST = ("tie_power", "differences")  # the first of these that has data opens the report
TIME = ("differences", "tie_power", "speeds", "voltage", "centre_of_angle")
LEARNT = ("jacobian", "learning_rate")
MAX_EVENTS = 12  # listed one by one
NONE = "-"


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
        Section("Over time", charts(runs, [stem for stem in TIME if stem not in [chart.key for chart in first]])),
        Section("Performance indices", charts(runs, ("indices",))),
        Section("Modes", [tables.modes(runs), *modes(runs), *maps(runs)]),
        Section("Control effort", [*charts(runs, ("injected_voltage", "device_state")), tables.effort(runs)]),
        Section("Supervision", [*charts(runs, ("supervision", "monitors")), *tables.supervision(runs)]),
        Section("Links", [tables.links(runs), *charts(runs, ("latency",))]),
        Section("Learning", charts(runs, LEARNT)),
        Section("Conditions", [tables.conditions(runs)]),
    ]
    names, what = [run.name for run in runs], " and ".join(unlike)
    warning = f"The runs differ in {what}: their figures cannot be compared, and none is marked as best."
    return Report(
        title=names[0] if len(names) == 1 else f"{len(names)} runs side by side",
        names=names,
        lead=lead(runs, baseline, not unlike),
        tiles=tiles(runs),
        remarks=[*([warning] if unlike else []), *(remark for run in runs for remark in _remarks(run))],
        events=sorted({event for run in runs for event in _events(run, f"{run.name}: " * (len(runs) > 1))}),
        sections=[section for section in sections if section.items],
    )


def differences(records: Sequence[Record]) -> list[str]:
    """Differences that make the runs' figures incomparable: system, scenario, duration."""
    compared = {
        "system": [record.asked.get("system") for record in records],
        "scenario": [record.asked.get("scenario") for record in records],
        "duration": [record.configuration.get("duration") for record in records],
    }
    return [name for name, values in compared.items() if any(value != values[0] for value in values)]


def _remarks(run: ReportedRun) -> list[str]:
    """Remarks that a reader needs before a run's figures."""
    notes = [f"{run.name}: {note}." for note in run.record.notes]
    if run.summary.stable is False:
        end = float(run.record.time_s[-1])
        notes.append(f"{run.name} is not stable: {run.summary.instability} at {end:.2f} s. It has no indices.")
    if run.summary.stable is None:
        notes.append(f"Whether {run.name} is stable is not known: {run.summary.verdict_because}. It has no indices.")
    return [*notes, *(f"{run.name}: {line}." for line in run.summary.warnings)]


def _events(run: ReportedRun, name: str) -> Iterator[tuple[float, str]]:
    """Time (s) and text of each grid event, trip, release, and start and end of a time in which a link loses all.

    `name`: of the run, where its trips and releases need it.
    """
    record = run.record
    for event in record.events:
        if event.time_ns <= record.time_ns[-1]:
            yield event.time_ns / NANOSECONDS, f"{event.kind.replace('_', ' ')} {event.element}".strip()
    for time, controller, cause in trips(run.summary.supervision):
        yield round(time, 3), f"{name}{controller} tripped by {cause}"
    for release in run.summary.releases:
        yield round(release.time_s, 3), f"{name}{release.device} released"
    for stage in _stages(record.configuration):
        if stage.get("loss") == 1.0 and stage.get("duration") is not None:
            for time, what in ((stage["start"], "cut"), (stage["start"] + stage["duration"], "back")):
                if time <= float(record.time_s[-1]):
                    yield round(time, 3), f"link {what}"


def _stages(configuration: Mapping[str, Any]) -> list[dict[str, Any]]:
    """All stages of the run's link and of controllers' own links."""
    links = [configuration.get("link"), *(row.get("link") for row in configuration.get("controllers") or ())]
    return [stage for link in links if isinstance(link, dict) for part in ("up", "down") for stage in link[part]]


# The opening: a sentence and three tiles


def lead(runs: Sequence[ReportedRun], baseline: int, comparable: bool) -> str:
    """Main result: of a single run, or of comparable runs against the baseline."""
    base, others = runs[baseline], [run for i, run in enumerate(runs) if i != baseline]
    if not comparable or not others:
        return " ".join(f"{_alone(run)}." for run in runs)
    clauses = [_alone(base)] if _ratio(base) is None else []
    clauses += [_beside(run, base, first=i == 0) for i, run in enumerate(others)]
    return f"{'; '.join(clauses)}."


def _alone(run: ReportedRun) -> str:
    """One run: whether it is damped, its damping, its swing."""
    if run.summary.stable is False:
        return _lost(run)
    parts = [f"{run.name}: {run.summary.verdict}"]
    if mode := run.summary.deciding_mode:
        parts.append(f"the {mode.frequency_hz:.2f} Hz mode has a damping ratio of {_percent(mode.damping_ratio)}")
    if run.summary.indices:
        parts.append(f"ITAE is {run.summary.indices['ITAE']:.3g}")
    return ", ".join(parts)


def _beside(run: ReportedRun, base: ReportedRun, *, first: bool) -> str:
    """A run against the baseline: change of damping and of ITAE."""
    if run.summary.stable is False:
        return _lost(run)
    now, before = _ratio(run), _ratio(base)
    if now is None or before is None:
        return _alone(run)
    verb = "raises" if now > before else "lowers"
    what = f"the damping ratio of {_mode(base)} from {_percent(before)}" if first else "it"
    text = f"{run.name} {verb} {what} to {_percent(now)}"
    less = (run.improvement_percent or {}).get("ITAE")
    return text if less is None else f"{text} and {'raises' if less < 0 else 'lowers'} ITAE by {abs(less):.0f} %"


def _lost(run: ReportedRun) -> str:
    return f"{run.name}: {run.summary.instability} at {float(run.record.time_s[-1]):.1f} s"


def _ratio(run: ReportedRun) -> float | None:
    return run.summary.modes[0].damping_ratio if run.summary.modes else None


def _mode(run: ReportedRun) -> str:
    return f"the {run.summary.modes[0].frequency_hz:.2f} Hz mode"


def _percent(value: float | None) -> str:
    return NONE if value is None else f"{100 * value:.1f} %"


def tiles(runs: Sequence[ReportedRun]) -> list[Tile]:
    """Damping, swing and path of each run."""
    return [
        Tile("Damping ratio of the strongest mode", [_percent(_ratio(run)) for run in runs]),
        Tile("ITAE of the speed differences", [_itae(run.summary) for run in runs]),
        Tile("Mean latency, measurement to device", [_latency(run.summary) for run in runs]),
    ]


def _itae(summary: Summary) -> str:
    return f"{summary.indices['ITAE']:.3g}" if summary.indices else NONE


def _latency(summary: Summary) -> str:
    mean, lost = summary.latency_ms.mean, summary.frames_lost
    text = NONE if mean is None else f"{mean:.0f} ms"
    return f"{text}, {lost} frames lost" if lost else text
