"""The opening of a report: a sentence and three tiles."""

from __future__ import annotations

from typing import TYPE_CHECKING

from facts_damping.report.contents import Tile

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from typing import Any

    from facts_damping.report.contents import ReportedRun

NONE = "-"


def lead(runs: Sequence[ReportedRun], baseline: int, comparable: bool) -> str:
    """Main result: of a single run, or of comparable runs against the baseline."""
    base, others = runs[baseline], [run for i, run in enumerate(runs) if i != baseline]
    if not comparable or not others:
        return " ".join(f"{_alone(run)}." for run in runs)
    told = [_beside(run, base, first=i == 0) for i, run in enumerate(others)]
    start = f"{_alone(base)}; " if _ratio(base) is None else ""
    return f"{start}{'; '.join(told)}."


def _alone(run: ReportedRun) -> str:
    """One run: whether it is damped, its damping, its swing."""
    if run.summary["stable"] is False:
        return _lost(run)
    parts = [f"{run.name}: {run.summary['verdict']}"]
    if run.summary["modes"]:
        parts.append(f"{_mode(run)} has a damping ratio of {_percent(_ratio(run))}")
    if run.summary["indices"]:
        parts.append(f"ITAE is {run.summary['indices']['ITAE']:.3g}")
    return ", ".join(parts)


def _beside(run: ReportedRun, base: ReportedRun, *, first: bool) -> str:
    """A run against the baseline: change of damping and of ITAE."""
    if run.summary["stable"] is False:
        return _lost(run)
    now, before = _ratio(run), _ratio(base)
    if now is None or before is None:
        return _alone(run)
    verb = "raises" if now > before else "lowers"
    what = f"the damping ratio of {_mode(base)} from {_percent(before)}" if first else "it"
    told = f"{run.name} {verb} {what} to {_percent(now)}"
    part = run.summary.get("improvement_percent") or {}
    if part.get("ITAE") is None:
        return told
    change = -part["ITAE"]
    return f"{told} and {'raises' if change > 0 else 'lowers'} ITAE by {abs(change):.0f} %"


def _lost(run: ReportedRun) -> str:
    return f"{run.name}: {run.summary['instability']} at {float(run.record.time_s[-1]):.1f} s"


def _ratio(run: ReportedRun) -> float | None:
    return run.summary["modes"][0]["damping_ratio"] if run.summary["modes"] else None


def _mode(run: ReportedRun) -> str:
    return f"the {run.summary['modes'][0]['frequency_hz']:.2f} Hz mode"


def _percent(value: float | None) -> str:
    return NONE if value is None else f"{100 * value:.1f} %"


def tiles(runs: Sequence[ReportedRun]) -> list[Tile]:
    """Damping, swing and path of each run."""
    return [
        Tile("Damping ratio of the strongest mode", [_percent(_ratio(run)) for run in runs]),
        Tile("ITAE of the speed differences", [_number((run.summary["indices"] or {}).get("ITAE")) for run in runs]),
        Tile("Mean latency, measurement to device", [_latency(run.summary) for run in runs]),
    ]


def _number(value: float | None) -> str:
    return NONE if value is None else f"{value:.3g}"


def _latency(summary: Mapping[str, Any]) -> str:
    mean = (summary.get("latency_ms") or {}).get("mean")
    lost = summary.get("frames_lost") or 0
    told = NONE if mean is None else f"{mean:.0f} ms"
    return f"{told}, {lost} frames lost" if lost else told
