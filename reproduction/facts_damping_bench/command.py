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
    larger = command.add_mutually_exclusive_group()
    larger.add_argument("--large", action="store_true", help="140 buses and 48 machines instead, beside ANDES alone")
    larger.add_argument("--wecc", action="store_true", help="WECC-240 instead, with inverters, beside ANDES alone")
    common(command, sets=False)


def bench(arguments: argparse.Namespace) -> None:
    """Time and error of a run, a sweep and lockstep beside other programs, those that are installed, in one run."""
    from facts_damping.cli.reporting import say
    from facts_damping.errors import check_known
    from facts_damping.interruption import clean_up_first
    from facts_damping.output.terminal import Progress
    from facts_damping.output.writing import write_json
    from facts_damping.parameters import files
    from facts_damping_bench import grid, large, pages, study, ticks, wecc
    from facts_damping_bench.programs import EXCHANGE, LARGE, OURS, PROGRAMS, WECC

    larger = (LARGE, large.SHOWN, large.REPEATS) if arguments.large else (WECC, wecc.SHOWN, wecc.REPEATS)
    alone = arguments.large or arguments.wecc
    table, shown, repeats = larger if alone else (PROGRAMS, grid.SHOWN, study.REPEATS)
    allowed = [name for name in (*table, *(() if alone else (EXCHANGE,))) if name != OURS]
    for name in arguments.programs:
        check_known("PROGRAM", name, allowed)
    asked = arguments.programs or allowed
    if arguments.large:
        large.check()
    folder = None if arguments.out is None else files.new_folder(Path(arguments.out))
    others, results, rates = [name for name in asked if name != EXCHANGE], [], []
    clean_up_first()
    with Progress("bench", "runs") as progress:
        if others:
            results = study.measure(others, progress, repeats, table, finer=shown.finer, sweep=not alone)
        if EXCHANGE in asked:
            rates = ticks.measure(progress)
    write_json(arguments.json, pages.document(results, rates))
    for line in pages.text(results, rates, shown):
        say(arguments, line)
    if folder is not None and results:
        say(arguments, f"picture: {pages.plot(results, folder / 'bench.png', shown)}")
