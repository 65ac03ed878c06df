"""What commands say about runs: figures as JSON, tables, pictures; and whether a run ended well."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

from facts_damping.digest import digest
from facts_damping.errors import DegradedError
from facts_damping.output.tables import with_counts
from facts_damping.output.terminal import note, show
from facts_damping.output.writing import write_json

if TYPE_CHECKING:
    import argparse
    from collections.abc import Callable, Mapping, Sequence
    from pathlib import Path

    from facts_damping.analysis.summary import Summary
    from facts_damping.nodes.launching.graph import Outcome
    from facts_damping.record import Record
    from facts_damping.simulation.programs.policies import StepTimes

    Named = list[tuple[str, Record]]


@dataclass(frozen=True)
class RunResult:
    """Figures of a run as a command reports them (docs/results_json.md); `more`: of its own, ready for JSON."""

    summary: Summary
    digest: str
    versions: Mapping[str, str]
    wall_s: float | None = None
    recording: str | None = None
    more: Mapping[str, Any] = field(default_factory=dict)

    def as_json(self) -> dict[str, Any]:
        """One object, whose keys are those of the summary and its own."""
        from facts_damping.analysis.summary import as_json

        columns = {"digest": self.digest, "versions": self.versions, "wall_s": self.wall_s, "recording": self.recording}
        return {**as_json(self.summary), **columns, **self.more}


def say(arguments: argparse.Namespace, *texts: str) -> None:
    """Print texts, each on lines of its own, unless standard output is used for JSON."""
    for text in texts if arguments.json != "-" else ():
        show(text)


def run_result(
    record: Record, wall_s: float | None = None, recording: str | None = None, method: str = "auto"
) -> RunResult:
    """Figures of a record. `recording`: its path; `method`: of its modes (`summarise`)."""
    from facts_damping.analysis.summary import summarise
    from facts_damping.simulation.twins import twin_of

    summary = summarise(record, method=method, twin=twin_of(record))
    return RunResult(summary, digest(record), record.versions, wall_s, recording)


def report(
    arguments: argparse.Namespace, named: Named, results: Sequence[RunResult], folder: Path | None, *more: str
) -> None:
    """Write files first, then print the table: a closed pipe then loses no result. `folder`: exists, or None."""
    from facts_damping import findings
    from facts_damping.analysis.summary_table import table

    contents = [result.as_json() for result in results]
    content = contents if arguments.command == "analyze" else contents[0]
    names, records = zip(*named, strict=True)
    pictures = []
    if folder is not None:
        from facts_damping.analysis.plotting.plots import plot_comparison

        labels = findings.names_of_seeds(records)
        pictures = plot_comparison(list(zip(labels, records, strict=True)), folder)
        write_json(str(folder / "result.json"), content)
    write_json(arguments.json, content)
    for name, record in named:
        for line in with_counts(record.notes):
            note(f"{name}: {line}")
    for record, result in zip(records, results, strict=True):
        free = findings.run_to_compare(record, result.summary)
        say(arguments, *findings.findings(record, result.summary, free), "")
    heads = names if len(named) > 1 else [""]
    summaries = [(head, result.summary) for head, result in zip(heads, results, strict=True)]
    say(arguments, table(summaries), *(f"plot: {path}" for path in pictures), *more)
    if getattr(arguments, "digest", False):
        several = len(named) > 1
        pairs = zip(names, results, strict=True)
        say(arguments, *(f"digest: {result.digest}" + f", {name}" * several for name, result in pairs))


def step_times_report(took: Mapping[str, StepTimes], frame_rate: int) -> tuple[dict[str, Any], list[str]]:
    """Durations of programs' steps, for JSON and as lines; empty if there are none. `frame_rate`: frames a second."""
    slow = f": slower than a frame ({1e3 / frame_rate:.1f} ms); as a node in real time it would miss its deadlines"
    lines = [f"{name}: {times}{slow * (times.mean_s * frame_rate > 1.0)}" for name, times in took.items()]
    return {"step_times": dict(took)} if took else {}, lines


def _missing(outcome: Outcome, record: Record) -> int:
    """Ticks of a graph that its record lacks, also those after the last message that was recorded."""
    return max(0, outcome.ticks - len(record.time_ns))


def check_ended_well(summary: Summary, record: Record, outcome: Outcome | None = None) -> None:
    """Raise `DegradedError` if a run ended but was degraded; `outcome`: of its graph."""
    from facts_damping.analysis.releases import joined_text, refused_messages, released_text
    from facts_damping.analysis.supervision import tripped_texts
    from facts_damping.record import RefusedMessages

    flaws = [
        *tripped_texts(summary.supervision),
        *(f"{release.device} was released {released_text(release)}" for release in summary.releases),
        *(f"{joined.node} joined {joined_text(joined)}" for joined in summary.joined),
    ]
    if outcome is not None:
        flaws += outcome.fallen
        refusals = [
            RefusedMessages(node, topic, cause, source, count)
            for (node, cause, topic, source), count in outcome.messages_refused.items()
        ]
        refused = refused_messages(summary.refused_messages or refusals)  # as in the table; nodes count to their end
        flaws += [f"refused messages: {refused}"] if refused else []
        flaws += [f"the recorder lost {record.messages_lost} messages"] if record.messages_lost else []
        missing = _missing(outcome, record)
        flaws += [f"{missing} of {outcome.ticks} ticks were not recorded"] if missing else []
        flaws += [f"of tick {record.gap_tick} not all was recorded"] if record.gap_tick is not None else []
    if flaws:
        raise DegradedError(f"the run ended, but: {'; '.join(flaws)}")


def tell_graph(
    arguments: argparse.Namespace,
    name: str,
    outcome: Outcome,
    folder: Path,
    more: Callable[[Record], tuple[dict[str, Any], list[str]]] | None = None,
) -> None:
    """Report a graph's results: JSON, table, pictures; `more`: further results from its record, with their lines."""
    from facts_damping.recording import seal

    record = seal(outcome.recording)
    counts = {"deadline_misses": outcome.deadline_misses, "messages_lost": record.messages_lost}
    counts["ticks_missing"] = _missing(outcome, record)
    times, steps = step_times_report(outcome.step_times, record.configuration["frame_rate"])
    further, lines = more(record) if more is not None else ({}, [])
    lines += [*steps, "; ".join(f"{count.replace('_', ' ')}: {number}" for count, number in counts.items())]
    result = run_result(record, outcome.wall_s, str(outcome.recording))
    result = replace(result, more={**counts, "nodes_ended": outcome.fallen, **times, **further})
    report(arguments, [(name, record)], [result], folder, *lines, f"recording: {outcome.recording}")
    check_ended_well(result.summary, record, outcome)
