"""The command `replay`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from facts_damping.cli.reporting import say
from facts_damping.cli.runs import out_folder
from facts_damping.digest import digest
from facts_damping.errors import InputError, RunError
from facts_damping.output.tables import table
from facts_damping.output.terminal import Progress, note
from facts_damping.output.writing import write_json
from facts_damping.parameters import files
from facts_damping.simulation import loop
from facts_damping.simulation.replaying import replay as again
from facts_damping.simulation.replaying.replayed_nodes import Played
from facts_damping.version import versions

if TYPE_CHECKING:
    import argparse

    from numpy.typing import NDArray

    from facts_damping.case.model import Case
    from facts_damping.record import Record


def replay(arguments: argparse.Namespace) -> None:
    """Feed a recording's delivered frames into its controllers again, or into others."""
    from facts_damping.analysis import releases
    from facts_damping.recording.reader import load

    record = load(arguments.recording)
    case = again.case_of(record, str(arguments.recording), arguments.run, arguments.set, policy=arguments.policy)
    try:
        played = again.fitted(record, case)
    except InputError as error:
        raise InputError(f"{arguments.recording}: {error}") from error
    folder = None if arguments.out is None and not arguments.nodes else out_folder(arguments, "replay")
    replayed, recording = _by_nodes(arguments, case, played, folder) if arguments.nodes else _in_process(case, played)
    issued = again.acted(replayed)
    first = again.first_difference(played, replayed.issued)
    others = {
        "the estimates are": again.first_estimate(played, replayed.estimates),
        "the learning is": again.first_learning(played, replayed.learning),
        "supervision is": again.first_supervised(played, replayed),
    }
    result = {
        "recording": str(arguments.recording),
        "controllers": [controller.model_dump() for controller in case.controllers],
        "ticks": len(played.ticks),
        "setpoints": len(replayed.issued),
        "estimates": len(replayed.estimates),
        "supervised": len(replayed.supervised),
        "identical": first is None and all(tick is None for tick in others.values()),
        "digest": digest(played),
        "versions": {"recorded": record.versions, "replayed": versions()},
        "first_difference": first and first._asdict(),
        "devices": again.beside(case, played, issued),
        "watchdogs": {
            which: releases.WatchdogActions(releases.releases(acted), releases.refused_setpoints(acted))
            for which, acted in (("recorded", played), ("replayed", again.watched(case, played)))
        },
        "notes": again.notes_on(record, played),
        "replayed": recording,
    }
    lines = [] if recording is None else [f"recording: {recording}"]
    if folder is not None:
        lines.append(f"plot: {_picture(case, record, played, issued, files.new_folder(folder))}")
        write_json(str(folder / "result.json"), result)
    write_json(arguments.json, result)
    _tell(arguments, result, lines)
    if first is not None and not arguments.set:
        raise RunError(f"setpoints differ from those recorded, from {first}")
    for what, tick in others.items():
        if tick is not None and not arguments.set:
            raise RunError(f"setpoints are as recorded, but {what} not, from tick {tick} on")


def _tell(arguments: argparse.Namespace, result: dict[str, Any], lines: list[str]) -> None:
    """Print notes on standard error, the verdict and, if setpoints differ, their table."""
    from facts_damping.analysis import releases
    from facts_damping.analysis.plotting import shadow

    for line in result["notes"]:
        note(f"{arguments.recording}: {line}")
    kinds = ("ticks", "setpoints", "estimates", "supervised")
    counted = ", ".join(f"{result[what]} {what}" for what in kinds if result[what])
    if result["identical"]:
        say(arguments, f"{counted}: identical, bit for bit")
        lines = [f"exact: digest {result['digest']}", *lines]
    else:
        say(arguments, shadow.table(result["devices"]))
        first = result["first_difference"]
        others = (
            "the same setpoints, other values differ" if first is None else f"different from tick {first['tick']} on"
        )
        say(arguments, f"{counted}: {others}")
        lines = [*([] if arguments.set else _other_versions(**result["versions"])), *lines]
    watchdogs = result["watchdogs"]
    if watchdogs["recorded"] != watchdogs["replayed"]:
        rows = releases.rows(list(watchdogs.values())) or [("released, refused", ["-", "-"])]
        lines = [*table(["watchdogs", *watchdogs], [[label, *cells] for label, cells in rows]), *lines]
    say(arguments, *lines)


def _other_versions(recorded: dict[str, str], replayed: dict[str, str]) -> list[str]:
    """A line that lists differences in software versions from the recording, if these are known."""
    other = [(name, recorded[name], now) for name, now in replayed.items() if recorded.get(name, now) != now]
    text = ", ".join(f"{name} {before}, here {now}" for name, before, now in other)
    return [f"recorded with {text}"] if other else []


def _in_process(case: Case, played: Record) -> tuple[Played, None]:
    """Replay with the compiled steps in this process."""
    with Progress("replay") as progress:
        return again.play(case, played, progress), None


def _by_nodes(arguments: argparse.Namespace, case: Case, played: Record, folder: Path | None) -> tuple[Played, str]:
    """Replay with nodes; returns the result and the recording of the graph."""
    from facts_damping.nodes.launching import graph
    from facts_damping.nodes.launching.starting import Parts
    from facts_damping.recording import seal

    if played.ticks[0] > 0:
        raise InputError(f"--nodes: a recording from tick {played.ticks[0]} on given; allowed: one from tick 0 on")
    loop.build_loop(case, outside=True)  # refuses bad input before anything starts
    place, timeout = folder or Path(), arguments.timeout
    with Progress("replay") as progress:
        outcome = graph.run(case, "lockstep", place, progress, timeout, parts=Parts(replayed=arguments.recording))
    record = seal(outcome.recording)
    return Played(*(getattr(record, name) for name in Played._fields)), str(outcome.recording)


def _picture(case: Case, record: Record, played: Record, issued: NDArray[Any], folder: Path) -> Path:
    from facts_damping.analysis.plotting import shadow

    grids = {
        name: (again.on_grid(played, again.acted(played), d), again.on_grid(played, issued, d))
        for d, name in enumerate(case.run.devices)
    }
    limits = {name: case.system.device(name).setpoint_max for name in case.run.devices}
    names = ", ".join(record.controller_names) or "none", ", ".join(played.controller_names)
    return shadow.plot(played.time_s, grids, limits, names, folder / "setpoints.png")
