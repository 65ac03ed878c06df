"""The command `storm`: shows one storm in words, or tries many."""

from __future__ import annotations

import time
from contextlib import nullcontext
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

from facts_damping.cli.reporting import say
from facts_damping.errors import RunError
from facts_damping.interruption import RECORDED, clean_up_first
from facts_damping.output.terminal import Progress, note
from facts_damping.output.writing import write_json, write_whole
from facts_damping.parameters.files import new_folder

if TYPE_CHECKING:
    import argparse
    from collections.abc import Sequence

    from facts_damping_testing.storm.running import Trace
    from facts_damping_testing.storm.search import Findings


def storm(arguments: argparse.Namespace) -> None:
    """Show one storm, or try many. Raises `RunError` if a rule is broken."""
    if arguments.minutes is not None:
        _many(arguments)
    else:
        _one(arguments)


def _one(arguments: argparse.Namespace) -> None:
    from facts_damping.nodes.launching import preload  # noqa: F401 (nodes are loaded before the loopback opens)
    from facts_damping_testing.storm import drawing, model, rules, running

    clean_up_first("" if arguments.out is None else RECORDED)
    drawn_storm = drawing.draw(arguments.seed) if arguments.storm is None else model.read(Path(arguments.storm))
    with TemporaryDirectory() if arguments.out is None else nullcontext(arguments.out) as folder:
        trace = running.run(drawn_storm, new_folder(Path(folder)))
        broken = rules.violations(trace)
    say(arguments, _verdict([rule for rule, _ in broken], 1), drawn_storm.text(), *_told(trace))
    write_json(arguments.json, {"storm": drawn_storm.model_dump(), "reason": trace.reason, "broken": broken})
    if broken:
        raise RunError("; ".join(f"{rule}: {text}" for rule, text in broken))
    say(arguments, f"all {len(rules.RULES)} rules hold")


def _verdict(broken: Sequence[str], storms: int) -> str:
    """The first line: how often rules were broken; `broken`: a rule for each violation."""
    counts = {"violation": len(broken), "rule": len(set(broken)), "storm": storms}
    violations, rules, tried = (f"{many} {name}{'s' * (many != 1)}" for name, many in counts.items())
    return f"{violations} of {rules} in {tried}" if broken else f"no violation in {tried}"


def _told(trace: Trace) -> list[str]:
    """The timeline: events, logs of the nodes, how they ended."""
    rows = [(done.world_s, f"! {done.text} (tick {done.tick})") for done in trace.timeline]
    rows += [(1e-9 * at, f"{name}: {text}") for at, name, _, text in trace.logs]
    ends = [f"{node.name}: {'killed' if node.killed else node.status} {node.errors.strip()}" for node in trace.nodes]
    end = f"the graph ended after {trace.world_s:.1f} s: {trace.reason or 'as planned'}"
    return [*(f"{at:9.3f} s  {text}" for at, text in sorted(rows, key=lambda row: row[0])), *ends, end]


def _many(arguments: argparse.Namespace) -> None:
    from facts_damping_testing.storm import search

    clean_up_first()
    with Progress("storm", "seconds") as progress:
        began, whole = time.monotonic(), round(60 * arguments.minutes)
        reported: set[str] = set()

        def tell(findings: Findings) -> None:
            for mark in findings.broken.keys() - reported:
                note(f"found: {mark}")
                reported.add(mark)
            progress(min(int(time.monotonic() - began), whole), whole)

        all_findings = search.search(arguments.minutes, arguments.seed, arguments.jobs, tell)
    folder = new_folder(Path(arguments.out or "results/storms"))
    clean_up_first(f"kept in {folder}: {len(all_findings.broken)} storms that broke a rule")
    broken = [mark.partition(":")[0] for mark, storms in all_findings.broken.items() for _ in storms]
    say(arguments, _verdict(broken, all_findings.storms))
    say(arguments, *_summary(all_findings, (time.monotonic() - began) / 60.0))
    files, violating = [], []
    for number, (mark, storms) in enumerate(sorted(all_findings.broken.items(), key=lambda row: -len(row[1]))):
        smallest, text = min(storms, key=lambda row: len(row[0].events))
        path = folder / f"storm-{number}.yaml"
        write_whole(path, f"# {text}\n{smallest.text()}")
        say(arguments, f"{len(storms)} storms: {mark}", f"  {path}")
        files.append({"file": str(path), "rule": mark, "storms": len(storms), "text": text})
        violating.append((path, mark, smallest, text))
    with Progress("shrink", "storms") as progress:
        for done, (path, mark, smallest, text) in enumerate(violating if all_findings.complete else ()):
            progress(done, len(violating))
            write_whole(path, f"# {text}\n{search.shrunk(smallest, mark).text()}")
    totals: dict[str, Any] = {name: getattr(all_findings, name) for name in ("storms", "world_s", "plant_s", "kinds")}
    write_json(arguments.json, totals | {"reached": len(all_findings.reached), "broken": files})
    if not all_findings.complete:
        raise KeyboardInterrupt
    if all_findings.broken:
        raise RunError(f"{len(all_findings.broken)} kinds of violations: {folder}")


def _summary(findings: Findings, minutes: float) -> list[str]:
    rate = f"{findings.storms / minutes:.0f} a minute" if minutes else ""
    kinds = ", ".join(f"{count} {kind}" for kind, count in findings.kinds.most_common())
    return [
        f"{findings.storms} storms, {rate}: {findings.world_s:.0f} s simulated, {findings.plant_s:.0f} s of plants",
        f"reached: {len(findings.reached)} lines, logs and pairs of event and state; {len(findings.kept)} storms kept",
        f"events: {kinds}",
    ]
