"""A table that compares the summaries of several runs."""

from __future__ import annotations

import math
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple

from facts_damping.analysis import convergence, releases
from facts_damping.analysis.indices import INDICES
from facts_damping.analysis.supervision import history_text, probe_text
from facts_damping.analysis.verdict import Growth
from facts_damping.output import tables

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from facts_damping.analysis.summary import Summary
    from facts_damping.analysis.supervision import SupervisorHistory

WORDS = {True: "yes", False: "no", None: "-"}
Rows = list[tuple[str, list[str]]]  # label, and a text for each run


class FigureRow(NamedTuple):
    """A row of the table: label, value of a summary, its format, and its name in `Summary.step_change`."""

    label: str
    value: Callable[[Summary], Any]
    form: str = ""
    name: str = ""


def _index(name: str, summary: Summary) -> float | None:
    return summary.indices.get(name) if summary.indices else None


ROWS = (
    FigureRow("in synchronism", lambda s: s.stable),
    FigureRow("ended by", lambda s: s.instability),
    FigureRow("verdict", lambda s: s.verdict),
    FigureRow("growth, worst signal [1/s]", lambda s: s.growth_per_s, ".4f"),
    FigureRow("duration [s]", lambda s: s.duration_s, ".2f"),
    *(FigureRow(name, partial(_index, name), ".4g", name) for name in INDICES),
    FigureRow("settling time [s]", lambda s: s.settling_time_s, ".2f", "settling_time_s"),
    FigureRow("max injected voltage [p.u.]", lambda s: s.max_injected_voltage_pu, ".4f", "max_injected_voltage_pu"),
    FigureRow("roughness [p.u./s²]", lambda s: s.roughness, ".4g", "roughness"),
    FigureRow("strongest mode [Hz]", lambda s: s.modes[0].frequency_hz if s.modes else None, ".3f"),
    FigureRow("  its damping ratio", lambda s: s.modes[0].damping_ratio if s.modes else None, ".4f"),
    FigureRow("latency, mean [ms]", lambda s: s.latency_ms.mean, ".2f"),
    FigureRow("latency, 99 % [ms]", lambda s: s.latency_ms.p99, ".2f"),
    FigureRow("frames lost", lambda s: s.frames_lost, "d"),
)


def table(summaries: Sequence[tuple[str, Summary]]) -> str:
    """Text table for a terminal: one column per run (name, summary), one row per figure; no titles without names."""
    rows = [[row.label, *(row_text(summary, row) for _, summary in summaries)] for row in ROWS]
    rows += [[label, *cells] for label, cells in more_rows([summary for _, summary in summaries])]
    return "\n".join(tables.table(["", *(name for name, _ in summaries)], rows))


def more_rows(summaries: Sequence[Summary]) -> Rows:
    """Optional rows of a table of runs; each is there if one of the runs has a value for it."""
    rows: Rows = []
    if any(s.converged is not None for s in summaries):
        rows.append(("converged", [WORDS[s.converged] for s in summaries]))
    if any(s.indices_of_response for s in summaries):
        itae = [s.indices_of_response and s.indices_of_response["ITAE"] for s in summaries]
        rows.append(("ITAE of the response", [value_text(value, ".4g") for value in itae]))
    rows += _cycles(summaries) + supervision_rows([s.supervision for s in summaries])
    rows += releases.rows([releases.WatchdogActions(s.releases, s.refused_setpoints) for s in summaries])
    rows += releases.by_name(
        "joined", [[(node.node, releases.joined_text(node)) for node in s.joined] for s in summaries]
    )
    if any(s.latencies_left_out for s in summaries):
        rows.append(("impossible latencies", [str(s.latencies_left_out) for s in summaries]))
    if any(s.refused_messages for s in summaries):  # each node counts the messages that it received
        rows.append(("refused messages", [releases.refused_messages(s.refused_messages) or "-" for s in summaries]))
    return rows


def _cycles(summaries: Sequence[Summary]) -> Rows:
    """Amplitude of limit cycles, and fraction of time that devices are at their limits in them."""
    cycles = [s.limit_cycle for s in summaries]
    if not any(cycles):
        return []
    fractions = [cycle.saturation_duty if cycle else {} for cycle in cycles]
    duties = [", ".join(f"{device} {100 * part:.0f}" for device, part in parts.items()) for parts in fractions]
    return [
        ("limit cycle, amplitude [p.u.]", [f"{cycle.amplitude_pu:.3g}" if cycle else "-" for cycle in cycles]),
        ("  setpoints at their limit [%]", [duty or "-" for duty in duties]),
    ]


def supervision_rows(each: Sequence[Sequence[SupervisorHistory]]) -> Rows:
    """History of each supervised controller of each run, and its probe."""
    runs, rows = [{history.controller: history for history in histories} for histories in each], Rows()
    for name in dict.fromkeys(name for run in runs for name in run):
        histories = [run.get(name) for run in runs]
        rows.append((name, ["-" if history is None else history_text(history) for history in histories]))
        if any(history and history.probe for history in histories):
            rows.append((f"{name} probe", [probe_text(history.probe if history else None) for history in histories]))
    return rows


def row_text(summary: Summary, row: FigureRow) -> str:
    """A figure of the table; if the step was halved, with only the digits that hold."""
    value, change = row.value(summary), (summary.step_change or {}).get(row.name)
    if change is None or not isinstance(value, float):
        return value_text(value, row.form)
    return convergence.text(value, change, row.form)


def value_text(value: Any, form: str) -> str:
    """A figure of the table."""
    if isinstance(value, Growth):
        return f"{value.value:{form}} ({value.low:{form}} to {value.high:{form}}) {value.signal}"
    if value is None or isinstance(value, bool):
        return WORDS[value]
    return WORDS[None] if isinstance(value, float) and math.isnan(value) else format(value, form)
