"""The tables of a report."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from facts_damping.analysis.details import JUDGED, together
from facts_damping.analysis.indices import INDICES
from facts_damping.analysis.latency import HOPS, alike, hops_ms, statistics
from facts_damping.analysis.modes.ringdown import COVERED
from facts_damping.analysis.summary import ROWS, find, more_rows, row_text
from facts_damping.analysis.supervision import cause_text, probe_text
from facts_damping.digest import digest
from facts_damping.findings import clause
from facts_damping.monitor_table import STATES
from facts_damping.report.contents import Cell, ReportTable

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray

    from facts_damping.report.contents import Mark, ReportedRun

# Rows of the summary in which runs are compared, and whether the largest value is best. Low device effort and
# low link latency do not count as best.
LARGEST_IS_BEST = {
    "in synchronism": True,
    "verdict": True,
    **dict.fromkeys(INDICES, False),
    "settling time [s]": False,
    "  its damping ratio": True,
}
JUDGED_BY = {"verdict": ("damped",)}  # paths of the compared values, if not those shown in the row
STATISTICS = {"mean": "mean [ms]", "p50": "median [ms]", "p99": "99 % [ms]", "max": "max [ms]"}
NONE = "-"
UNMARKED: Mark = ""


def summary(runs: Sequence[ReportedRun], comparable: bool) -> ReportTable:
    """Figures of all runs; if comparable, with the best and worst of each row marked."""
    rows = []
    for label, path, form in ROWS:
        texts = [row_text(run.summary, path, form) for run in runs]
        if all(text == NONE for text in texts):
            continue
        judged = comparable and label in LARGEST_IS_BEST
        worth = [find(run.summary, JUDGED_BY.get(label, path)) for run in runs]
        marks = ranked(worth, LARGEST_IS_BEST[label]) if judged else [UNMARKED] * len(runs)
        cells = [Cell(text, mark) for text, mark in zip(texts, marks, strict=True)]
        rows.append([Cell(label.strip()), *cells])
    rows += [[Cell(label), *map(Cell, cells)] for label, cells in more_rows([run.summary for run in runs])]
    sentence = "All figures of the runs side by side; those that no run has are left out."
    if comparable and len(runs) > 1:
        sentence += " ▲ is the best of a row, ▼ the worst; a dash is a figure that the run does not have."
    return ReportTable("summary", "Summary", sentence, ["", *(run.name for run in runs)], rows, runs=True)


def ranked(values: Sequence[float | bool | None], largest_is_best: bool) -> list[Mark]:
    """Mark of each run's value: `best`, `worst` or neither. None is worst; a tie of all runs gets no mark."""
    sign = 1.0 if largest_is_best else -1.0
    worth = [-np.inf if value is None else sign * float(value) for value in values]
    if len(set(worth)) < 2:
        return [UNMARKED] * len(values)
    words: dict[float, Mark] = {min(worth): "worst", max(worth): "best"}
    return [words.get(one, UNMARKED) for one in worth]


def improvements(runs: Sequence[ReportedRun], baseline: int) -> list[ReportTable]:
    """Improvement of the other runs over the baseline; empty unless two runs have the figures."""
    parts = [run.summary.get("improvement_percent") for run in runs]
    if sum(part is not None for part in parts) < 2:
        return []
    name = runs[baseline].name
    rows = [[Cell(figure), *(Cell(_number((part or {}).get(figure), ".1f")) for part in parts)] for figure in JUDGED]
    sentence = (
        f"By how much each figure is below that of {name}, in % of it: 100 would be no deviation at all, a negative "
        "number is worse."
    )
    head = ["[%]", *(run.name for run in runs)]
    return [ReportTable("improvement", f"Improvement on {name}", sentence, head, rows, runs=True)]


def modes(runs: Sequence[ReportedRun]) -> ReportTable:
    """Modes of all runs with their intervals."""
    rows = [
        [Cell(run.name), *_mode(mode), Cell(_number(find(run.summary, ("ringdown", "snr_db")), ".0f"))]
        for run in runs
        for mode in run.summary["modes"]
    ]
    without = [run.name for run in runs if not run.summary["modes"]]
    sentence = (
        "Modes of 0.1 to 2.5 Hz in the ringdown after the last event, or in the noise of a run without one, the "
        "strongest of each run first, with intervals of 95 %. A damping ratio below zero is an oscillation that grows."
    )
    if without:
        sentence += f" None was found in: {', '.join(without)}."
    head = ["run", "frequency [Hz]", "damping ratio [%]", "amplitude [10⁻³ p.u.]", "signal to noise [dB]"]
    return ReportTable("mode_table", "Mode table", sentence, head, rows)


def _mode(mode: Mapping[str, Any]) -> list[Cell]:
    return [
        Cell(_interval(mode["frequency_hz"], mode["frequency_error_hz"], 1.0, ".3f")),
        Cell(_interval(mode["damping_ratio"], mode["damping_ratio_error"], 100.0, ".2f")),
        Cell(format(1e3 * max(mode["amplitude"]), ".3g")),
    ]


def effort(runs: Sequence[ReportedRun]) -> ReportTable:
    """Setpoints and effort of each device."""
    rows = []
    for run in runs:
        table, duty = run.record.devices, run.summary["saturation_duty"]
        for i, device in enumerate(run.record.device_names):
            setpoint = table["setpoint"][:, i]
            figures = np.abs(setpoint).max(), np.sqrt(np.mean(setpoint**2))
            fraction = duty.get(device)
            rows.append([
                Cell(run.name), Cell(device), *(Cell(format(one, ".4f")) for one in figures),
                Cell(_number(None if fraction is None else 100 * fraction, ".1f")),
            ])  # fmt: skip
    head = ["run", "device", "largest setpoint [p.u.]", "root mean square [p.u.]", "at the limit [% of frames]"]
    sentence = (
        "How much each device is used: one that is often at its limit has no more to give, and a setpoint near zero "
        "leaves it unused."
    )
    return ReportTable("effort", "Use of the devices", sentence, head, rows)


def supervision(runs: Sequence[ReportedRun]) -> list[ReportTable]:
    """Actions of supervisors and their causes; empty without supervisors."""
    told = [(run.name, one) for run in runs for one in run.summary.get("supervision") or ()]
    if not told:
        return []
    fractions = [
        [
            run,
            one["controller"],
            *(f"{100 * fraction:.1f}" for fraction in one["fractions"].values()),
            probe_text(one["probe"]),
        ]
        for run, one in told
    ]
    changes = [
        [run, one["controller"], f"{row['time_s']:.2f}", row.get("state", "not armed"), cause_text(row) or NONE]
        for run, one in told
        for row in sorted([*one["changes"], *one["refusals"]], key=lambda row: float(row["time_s"]))
    ]
    return [
        ReportTable(
            "supervisors", "Time in each state",
            "Fraction of the run's frames in each state, and what the newest probe says: how the plant answers, beside "
            "how it should.",
            ["run", "controller", *(f"{state} [%]" for state in STATES), "probe"],
            [list(map(Cell, r)) for r in fractions],
        ),
        ReportTable(
            "changes", "Changes of state",
            "Every change of a supervisor's state with its cause: who asked for it, or the monitor that was beyond its "
            "limit. A run begins in shadow.",
            ["run", "controller", "time [s]", "state", "cause"], [list(map(Cell, row)) for row in changes],
        ),
    ]  # fmt: skip


def links(runs: Sequence[ReportedRun]) -> ReportTable:
    """Latency of each hop, and frames lost."""
    rows = [
        [Cell(run.name), Cell(HOPS[hop]), Cell(together(names)), *(Cell(one) for one in told)]
        for run in runs
        for hop, parts in hops_ms(run.record).items()
        for told, names in alike(_latencies(parts)).items()
    ]
    lost = ", ".join(f"{run.name} {run.summary['frames_lost']}" for run in runs)
    sentence = (
        "Latency of each hop from the measurement to the device, in simulated time, by PMU, controller or device; "
        "n is how many were delivered to each. A setpoint rests on the newest frames that are there: late ones count "
        f"in the first hop, and not in the whole. Entries of frames that the link lost: {lost}."
    )
    sentence += "".join(_modelled_twice(run) for run in runs)
    head = ["run", "hop", "of", "n", *STATISTICS.values()]
    return ReportTable("links", "Link statistics", sentence, head, rows)


def _modelled_twice(run: ReportedRun) -> str:
    """Parts of a link's delay that are left out because the run's PMUs have their own filter."""
    measurement, link = (run.record.configuration.get(field) or {} for field in ("measurement", "link"))
    stages = [one for one in link.get("up") or () if (one["stage"], one["model"]) == ("pmu", "constant")]
    delay = sum(one["delay"] for one in stages)
    if not delay or measurement.get("filter", "ideal") == "ideal":
        return ""
    told = f"of {clause(link) or 'the link'} {1e3 * delay:g} ms stand for PMUs and do not count"
    return f" {run.name}: {told}, as the run's PMUs have a filter of their own, {measurement['filter']}."


def _latencies(parts: Mapping[str, NDArray[np.float64]]) -> dict[str, tuple[str, ...]]:
    """Number of values and their statistics, by name."""
    return {
        who: (str(len(values)), *(_number(one, ".2f") for one in statistics(values).values()))
        for who, values in parts.items()
    }


def conditions(runs: Sequence[ReportedRun]) -> ReportTable:
    """Conditions of the runs."""
    fields = ["system", "scenario", "devices", "controllers", "link", "frame_rate", "duration", "seed"]
    fields += [field for field in ("supervision", "arm_at") if any(run.record.asked.get(field) for run in runs)]
    rows = [
        [Cell(field.replace("_", " ")), *(Cell(_said(run.record.asked.get(field))) for run in runs)] for field in fields
    ]
    rows.append([Cell("recording"), *(Cell(run.path) for run in runs)])
    rows.append([Cell("digest"), *(Cell(digest(run.record)) for run in runs)])
    rows.append([Cell("versions"), *(Cell(_versions(run.record.versions)) for run in runs)])
    sentence = "The runs by the names in their files; what stands inline without a name is called custom."
    return ReportTable("conditions", "Conditions", sentence, ["", *(run.name for run in runs)], rows, runs=True)


def _versions(found: Mapping[str, str]) -> str:
    return ", ".join(f"{name} {version}" for name, version in found.items()) or NONE


def _said(value: Any) -> str:
    """Short text of a field of a run."""
    if isinstance(value, list):
        return ", ".join(map(_said, value)) or "none"
    if isinstance(value, dict):
        return " ".join(str(value[key]) for key in ("name", "scheme", "kind") if value.get(key)) or "custom"
    return NONE if value is None else str(value)


def _interval(value: float, error: float | None, factor: float, form: str) -> str:
    spread = "" if error is None else f" ± {COVERED * factor * error:.1g}"
    return f"{factor * value:{form}}{spread}"


def _number(value: float | None, form: str) -> str:
    return NONE if value is None else format(value, form)
