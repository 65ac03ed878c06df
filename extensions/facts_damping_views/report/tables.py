"""The tables of a report."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from facts_damping.analysis.indices import INDICES
from facts_damping.analysis.latency import HOPS, alike, hops_ms, statistics
from facts_damping.analysis.modes.ringdown import COVERED
from facts_damping.analysis.summary_table import ROWS, more_rows, row_text
from facts_damping.analysis.supervision import actions, cause_text, probe_text
from facts_damping.digest import digest
from facts_damping.findings import clause
from facts_damping.monitor_table import STATES
from facts_damping_views.analysis.details import JUDGED, together
from facts_damping_views.report.contents import SENTENCES, Cell, ReportTable

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from facts_damping.analysis.summary import ModeFit
    from facts_damping_views.report.contents import Mark, ReportedRun

# Rows of the summary in which runs are compared, and whether the largest value is best. Low device effort and
# low link latency do not count as best.
LARGEST_IS_BEST = dict.fromkeys(("in synchronism", "verdict", "  its damping ratio"), True)
LARGEST_IS_BEST |= dict.fromkeys((*INDICES, "settling time [s]"), False)
STATISTICS = {"mean": "mean [ms]", "p50": "median [ms]", "p99": "99 % [ms]", "max": "max [ms]"}
NONE = "-"
UNMARKED: Mark = ""


def summary(runs: Sequence[ReportedRun], comparable: bool) -> ReportTable:
    """Figures of all runs; if comparable, with the best and worst of each row marked."""
    rows = []
    for row in ROWS:
        texts = [row_text(run.summary, row) for run in runs]
        if all(text == NONE for text in texts):
            continue
        marks = [UNMARKED] * len(runs)
        if comparable and row.label in LARGEST_IS_BEST:
            worth = [run.summary.damped if row.label == "verdict" else row.value(run.summary) for run in runs]
            marks = ranked(worth, LARGEST_IS_BEST[row.label])
        rows.append([Cell(row.label.strip()), *map(Cell, texts, marks)])
    rows += [[Cell(label), *map(Cell, cells)] for label, cells in more_rows([run.summary for run in runs])]
    sentence = SENTENCES["summary"] + SENTENCES["summary_marks"] * (comparable and len(runs) > 1)
    return ReportTable("summary", "Summary", sentence, ["", *(run.name for run in runs)], rows, runs=True)


def ranked(values: Sequence[float | bool | None], largest_is_best: bool) -> list[Mark]:
    """Mark of each run's value: `best`, `worst` or neither. None is worst; a tie of all runs gets no mark."""
    sign = 1.0 if largest_is_best else -1.0
    worth = [-np.inf if value is None else sign * float(value) for value in values]
    if len(set(worth)) < 2:
        return [UNMARKED] * len(values)
    marks: dict[float, Mark] = {min(worth): "worst", max(worth): "best"}
    return [marks.get(value, UNMARKED) for value in worth]


def improvements(runs: Sequence[ReportedRun], baseline: int) -> list[ReportTable]:
    """Improvement of the other runs over the baseline; empty unless two runs have the figures."""
    parts = [run.improvement_percent for run in runs]
    if sum(part is not None for part in parts) < 2:
        return []
    name = runs[baseline].name
    rows = [[Cell(figure), *(Cell(_number((part or {}).get(figure), ".1f")) for part in parts)] for figure in JUDGED]
    sentence = SENTENCES["improvement"].format(baseline=name)
    head = ["[%]", *(run.name for run in runs)]
    return [ReportTable("improvement", f"Improvement on {name}", sentence, head, rows, runs=True)]


def modes(runs: Sequence[ReportedRun]) -> ReportTable:
    """Modes of all runs with their intervals."""
    rows = [
        list(map(Cell, [run.name, *_mode(mode), _number(run.summary.ringdown and run.summary.ringdown.snr_db, ".0f")]))
        for run in runs
        for mode in run.summary.modes
    ]
    without = [run.name for run in runs if not run.summary.modes]
    sentence = SENTENCES["mode_table"]
    if without:
        sentence += SENTENCES["mode_table_none"].format(runs=", ".join(without))
    head = ["run", "frequency [Hz]", "damping ratio [%]", "amplitude [10⁻³ p.u.]", "signal to noise [dB]"]
    return ReportTable("mode_table", "Mode table", sentence, head, rows)


def _mode(mode: ModeFit) -> list[str]:
    frequency = _interval(mode.frequency_hz, mode.frequency_error_hz, 1.0, ".3f")
    ratio = _interval(mode.damping_ratio, mode.damping_ratio_error, 100.0, ".2f")
    return [frequency, ratio, format(1e3 * max(mode.amplitude), ".3g")]


def effort(runs: Sequence[ReportedRun]) -> ReportTable:
    """Setpoints and effort of each device."""
    rows = []
    for run in runs:
        table, duty = run.record.devices, run.summary.saturation_duty
        for i, device in enumerate(run.record.device_names):
            setpoint = table["setpoint"][:, i]
            figures = np.abs(setpoint).max(), np.sqrt(np.mean(setpoint**2))
            fraction = _number(100 * duty[device] if device in duty else None, ".1f")
            rows.append(list(map(Cell, [run.name, device, *(format(figure, ".4f") for figure in figures), fraction])))
    head = ["run", "device", "largest setpoint [p.u.]", "root mean square [p.u.]", "at the limit [% of frames]"]
    return ReportTable("effort", "Use of the devices", SENTENCES["effort"], head, rows)


def supervision(runs: Sequence[ReportedRun]) -> list[ReportTable]:
    """Actions of supervisors and their causes; empty without supervisors."""
    histories = [(run.name, history) for run in runs for history in run.summary.supervision]
    if not histories:
        return []
    fractions = [
        [
            run,
            history.controller,
            *(f"{100 * part:.1f}" for part in history.fractions.values()),
            probe_text(history.probe),
        ]
        for run, history in histories
    ]
    changes = [
        [run, history.controller, f"{action.time_s:.2f}", action.state, cause_text(action) or NONE]
        for run, history in histories
        for action in actions(history)
    ]
    head = ["run", "controller"]
    states, causes = [*head, *(f"{state} [%]" for state in STATES), "probe"], [*head, "time [s]", "state", "cause"]
    return [
        ReportTable(key, title, SENTENCES[key], titles, [list(map(Cell, row)) for row in rows])
        for key, title, titles, rows in (
            ("supervisors", "Time in each state", states, fractions),
            ("changes", "Changes of state", causes, changes),
        )
    ]


def links(runs: Sequence[ReportedRun]) -> ReportTable:
    """Latency of each hop, and frames lost."""
    rows = [
        list(map(Cell, [run.name, HOPS[hop], together(names), *texts]))
        for run in runs
        for hop, parts in hops_ms(run.record).items()
        for texts, names in alike({name: _latencies(values) for name, values in parts.items()}).items()
    ]
    lost = ", ".join(f"{run.name} {run.summary.frames_lost}" for run in runs)
    sentence = SENTENCES["links"].format(lost=lost) + "".join(map(_modelled_twice, runs))
    head = ["run", "hop", "of", "n", *STATISTICS.values()]
    return ReportTable("links", "Link statistics", sentence, head, rows)


def _modelled_twice(run: ReportedRun) -> str:
    """Parts of a link's delay that are left out because the run's PMUs have their own filter."""
    measurement, link = (run.record.configuration.get(field) or {} for field in ("measurement", "link"))
    stages = [stage for stage in link.get("up") or () if (stage["stage"], stage["model"]) == ("pmu", "constant")]
    delay = sum(stage["delay"] for stage in stages)
    if not delay or measurement.get("filter", "ideal") == "ideal":
        return ""
    names = {"run": run.name, "link": clause(link) or "the link", "filter": measurement["filter"]}
    return SENTENCES["links_twice"].format(**names, delay_ms=1e3 * delay)


def _latencies(values: NDArray[np.float64]) -> tuple[str, ...]:
    return str(len(values)), *(_number(value, ".2f") for value in statistics(values))


def conditions(runs: Sequence[ReportedRun]) -> ReportTable:
    """Conditions of the runs."""
    fields = ["system", "scenario", "devices", "controllers", "link", "frame_rate", "duration", "seed"]
    fields += [field for field in ("supervision", "arm_at") if any(run.record.asked.get(field) for run in runs)]
    rows = [[field.replace("_", " "), *(_field_text(run.record.asked.get(field)) for run in runs)] for field in fields]
    versions = [", ".join(f"{name} {version}" for name, version in run.record.versions.items()) for run in runs]
    rows += [
        ["recording", *(run.path for run in runs)],
        ["digest", *(digest(run.record) for run in runs)],
        ["versions", *(text or NONE for text in versions)],
    ]
    head, cells = ["", *(run.name for run in runs)], [list(map(Cell, row)) for row in rows]
    return ReportTable("conditions", "Conditions", SENTENCES["conditions"], head, cells, runs=True)


def _field_text(value: Any) -> str:
    if isinstance(value, list):
        return ", ".join(map(_field_text, value)) or "none"
    if isinstance(value, dict):
        return " ".join(str(value[key]) for key in ("name", "scheme", "kind") if value.get(key)) or "custom"
    return NONE if value is None else str(value)


def _interval(value: float, error: float | None, factor: float, form: str) -> str:
    spread = "" if error is None else f" ± {COVERED * factor * error:.1g}"
    return f"{factor * value:{form}}{spread}"


def _number(value: float | None, form: str) -> str:
    return NONE if value is None else format(value, form)
