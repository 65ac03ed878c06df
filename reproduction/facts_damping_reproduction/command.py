"""The command `reproduce` of `facts-damping`, by the entry point `facts_damping.commands`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from facts_damping.cli.options import common, jobs, whole

if TYPE_CHECKING:
    import argparse

    from facts_damping.cli.parser import Add


def add_to(add: Add) -> None:
    """What the command takes."""
    command = add(
        "reproduce",
        "facts_damping_reproduction.command:reproduce",
        "Compare with the thesis, table by table; with --profile deployment: whether learning helps in one.",
        "reproduce 3.1 --draws 2 --out results/reproduction",
    )
    command.add_argument("tables", nargs="*", metavar="TABLE", help="3.1, 4.1 ... 6.2; none: all")
    text = "thesis (its tables) or deployment (an experiment); default: thesis"
    command.add_argument("--profile", default="thesis", metavar="NAME", help=text)
    text = "cases of each ensemble, 2 or more; default: as its file says"
    command.add_argument("--draws", type=whole(2, 100_000), metavar="N", help=text)
    text = "other searches and cases, with --profile deployment; default: 0, as published"
    command.add_argument("--seed", type=whole(0, 1000), default=0, metavar="N", help=text)
    text = "address of a Dask scheduler, with --profile deployment"
    command.add_argument("--scheduler", metavar="ADDRESS", help=text)
    jobs(command)
    common(command, sets=False)


def reproduce(arguments: argparse.Namespace) -> None:
    """The thesis's tables, ours beside them: agreement, ensembles, explanations, pictures."""
    from facts_damping.cli.reporting import say
    from facts_damping.interruption import CONTINUES, clean_up_first
    from facts_damping.output.writing import write_json
    from facts_damping.parameters import files
    from facts_damping.parameters.profile import DEFAULT_PROFILE
    from facts_damping_reproduction import pages
    from facts_damping_reproduction.agreement import markdown
    from facts_damping_reproduction.findings import find
    from facts_damping_reproduction.results import gather

    if arguments.profile != DEFAULT_PROFILE:
        _what_holds(arguments)
        return
    folder = files.new_folder(Path(arguments.out) if arguments.out is not None else Path("results") / "reproduction")
    clean_up_first(f"{CONTINUES}: {folder}")
    results = gather(arguments.tables, arguments.draws, folder, arguments.jobs)
    judged = find(results)
    written = pages.write(results, judged, folder)
    write_json(arguments.json, pages.document(results, judged))
    for title, side in (("the scenarios as they are", judged.plain), ("medians over the ensembles", judged.drawn)):
        if side.signs:
            signs, ranks = ("statements", "agree", "fraction"), ("rankings", "mean_rho", "same_best", "same_second")
            lines = [*markdown(side.signs, ["table", "what"], signs), "", *markdown(side.totals, ["table"], ranks)]
            say(arguments, "\n".join([f"Agreement with the thesis, {title}:", "", *lines, ""]))
    for path in written:
        say(arguments, f"written: {path}")


def _what_holds(arguments: argparse.Namespace) -> None:
    """Whether learning helps in a deployment: the experiment, its page and its figures."""
    from facts_damping.cli.reporting import say
    from facts_damping.errors import InputError, check_known
    from facts_damping.interruption import CONTINUES, clean_up_first
    from facts_damping.output.writing import write_json
    from facts_damping.parameters import files
    from facts_damping.parameters.profile import DEFAULT_PROFILE
    from facts_damping_reproduction.adaptation import experiment, pages

    check_known("--profile", arguments.profile, [DEFAULT_PROFILE, experiment.PROFILE])
    for name, value in (("TABLE", arguments.tables), ("--draws", arguments.draws)):
        if value:
            raise InputError(f"{name}: {value} given; allowed: none with --profile {experiment.PROFILE}")
    folder = files.new_folder(
        Path(arguments.out) if arguments.out is not None else Path("results") / experiment.PROFILE
    )
    clean_up_first(f"{CONTINUES}: {folder}")
    by_seed = experiment.run(folder, arguments.jobs, arguments.scheduler, arguments.seed)
    results = pages.by_devices(by_seed)
    comparisons = {devices: pages.ratios(experiments) for devices, experiments in results.items()}
    written, first = pages.write(by_seed, comparisons, folder), next(iter(results))
    answers = pages.answers(results[first], comparisons[first])
    write_json(arguments.json, {"ratios": pages.rows(comparisons), "answers": answers})
    say(arguments, *answers, "", *(f"written: {path}" for path in written))
