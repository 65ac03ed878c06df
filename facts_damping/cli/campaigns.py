"""The command `campaign`: draws of possible failures, in process and as graphs, and a page of results."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from facts_damping.cli.runs import say
from facts_damping.errors import RunError
from facts_damping.terminal import Progress, clean_up_first, write_json, write_whole

if TYPE_CHECKING:
    import argparse
    from collections.abc import Callable


def campaign(arguments: argparse.Namespace) -> None:
    """Run the draws of a campaign and check the conditions for each; violating draws are written as run files."""
    from facts_damping.studies.campaigns import campaign as study
    from facts_damping.studies.campaigns import campaign_pages as pages
    from facts_damping.studies.sweeps import results

    made = study.plan(arguments.campaign, arguments.set, arguments.draws, arguments.graphs)
    folder = Path(arguments.out) if arguments.out is not None else Path("results") / made.name
    clean_up_first()
    rows = _carried_out("draws", folder, partial(study.run, made, folder, arguments.jobs, arguments.scheduler))
    graphs: list[dict[str, Any]] = []
    if made.campaign.graphs:
        from facts_damping.cli.campaign_graphs import graphs as as_graphs

        graphs = _carried_out("graphs", folder, partial(as_graphs, made, folder, arguments.jobs))
    text = pages.page(made, rows, graphs, command(arguments))
    write_json(arguments.json, {"draws": rows, "graphs": graphs})
    for line in pages.overview(rows, graphs):
        say(arguments, line)
    for name, own in (("draws", rows), ("graphs", graphs)):
        for path in results.tables(folder, name, own) if own else ():
            say(arguments, f"table: {path}")
    write_whole(folder / "page.md", text)
    say(arguments, f"page: {folder / 'page.md'}")
    failed = [row for row in (*rows, *graphs) if not pages.holds(row)]
    if failed:
        say(arguments, f"{len(failed)} for which something does not hold: {folder / study.FAILED}")
    errors = [row for row in (*rows, *graphs) if row["error"] is not None]
    if errors:
        raise RunError(f"{len(errors)} draws could not be made, the first: {errors[0]['number']}: {errors[0]['error']}")


def _carried_out(what: str, folder: Path, make: Callable[[Progress], list[dict[str, Any]]]) -> list[dict[str, Any]]:
    """Rows of one part of a campaign, with progress shown."""
    progress = Progress("campaign", what)
    try:
        return make(progress)
    except KeyboardInterrupt:
        raise KeyboardInterrupt(f"the same command goes on where it stopped: {folder}") from None
    finally:
        progress.close()


def command(arguments: argparse.Namespace) -> str:
    """The command that makes this page again."""
    given = [f"--{name} {value}" for name in ("draws", "graphs") if (value := getattr(arguments, name)) is not None]
    return " ".join(["facts-damping campaign", arguments.campaign, *given, *(f"--set {one}" for one in arguments.set)])
