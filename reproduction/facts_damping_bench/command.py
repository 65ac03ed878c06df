"""The command `bench` of `facts-damping`, by the entry point `facts_damping.commands`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from facts_damping.cli.options import common

if TYPE_CHECKING:
    import argparse

    from facts_damping.cli.parser import Add


def add_to(add: Add) -> None:
    """What the command takes."""
    command = add(
        "bench",
        "facts_damping_bench.command:bench",
        "Measure time and error side by side with other programs that are installed.",
        "bench andes",
    )
    command.add_argument("programs", nargs="*", metavar="PROGRAM", help="which, of docs/validation.md; none: all")
    command.add_argument("--large", action="store_true", help="140 buses and 48 machines instead, beside ANDES alone")
    common(command, sets=False)


def bench(arguments: argparse.Namespace) -> None:
    """Time and error of a run, a sweep and lockstep beside other programs, those that are installed, in one run."""
    from facts_damping.cli.reporting import say
    from facts_damping.errors import check_known
    from facts_damping.interruption import clean_up_first
    from facts_damping.output.terminal import Progress
    from facts_damping.output.writing import write_json
    from facts_damping.parameters import files
    from facts_damping_bench import grid, large, pages, study, ticks
    from facts_damping_bench.programs import EXCHANGE, LARGE, OURS, PROGRAMS

    allowed = [name for name in (LARGE if arguments.large else (*PROGRAMS, EXCHANGE)) if name != OURS]
    for name in arguments.programs:
        check_known("PROGRAM", name, allowed)
    asked = arguments.programs or allowed
    if arguments.large:
        large.check()
    folder = None if arguments.out is None else files.new_folder(Path(arguments.out))
    others, results, rates = [name for name in asked if name != EXCHANGE], [], []
    clean_up_first()
    with Progress("bench", "runs") as progress:
        if arguments.large:
            results = study.measure(others, progress, large.REPEATS, LARGE, sweep=False)
        elif others:
            results = study.measure(others, progress)
        if EXCHANGE in asked:
            rates = ticks.measure(progress)
    write_json(arguments.json, pages.document(results, rates))
    shown = large.SHOWN if arguments.large else grid.SHOWN
    for line in pages.text(results, rates, shown):
        say(arguments, line)
    if folder is not None and results:
        say(arguments, f"picture: {pages.plot(results, folder / 'bench.png', shown)}")
