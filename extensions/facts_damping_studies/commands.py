"""The commands on modes, margins, studies and campaigns."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from facts_damping.case import loading
from facts_damping.cli.reporting import say
from facts_damping.errors import DegradedError, InputError
from facts_damping.interruption import CONTINUES, clean_up_first
from facts_damping.output.terminal import Progress
from facts_damping.output.writing import write_json, write_whole
from facts_damping.parameters import files
from facts_damping.simulation import loop
from facts_damping_studies.pages import untuned_lines
from facts_damping_studies.sweeps.batch import make

if TYPE_CHECKING:
    import argparse
    from collections.abc import Sequence

    from facts_damping_studies.campaigns.campaign import CampaignPlan
    from facts_damping_studies.campaigns.draw_rows import DrawRow
    from facts_damping_studies.sweeps.sweep import SweepPlan
    from facts_damping_studies.sweeps.sweep_rows import FractionRow, MarginRow, SweepRow


def modes(arguments: argparse.Namespace) -> None:
    """Power flow, eigenvalues, mode shapes and residues of a system at its initial state."""
    from facts_damping.small_signal import linear_plant, modal_tables

    files.check_writable(arguments.linear, "--linear", standard=False)
    system = loading.load_system(arguments.system, arguments.set, arguments.scenario)
    modal = modal_tables.analyse(system, loading.installed(system, arguments.devices))
    if arguments.linear is not None:
        linear_plant.save(linear_plant.of(modal), Path(arguments.linear))
    pictures = []
    if arguments.out is not None:
        from facts_damping_studies.modes import modal_pictures

        pictures = modal_pictures.plot(modal, files.new_folder(Path(arguments.out)))
    write_json(arguments.json, modal_tables.document(modal))
    say(arguments, *modal_tables.modes_text(modal), *(f"plot: {path}" for path in pictures))


def sweep(arguments: argparse.Namespace) -> None:
    """Run a study in parallel: table, delay margins, pictures; continues after an interruption."""
    from facts_damping_studies.sweeps import control_outcomes, point_figures, results, sweep_plots, tables
    from facts_damping_studies.sweeps import sweep as study

    sets = [*([f"profile={arguments.profile}"] if arguments.profile else []), *arguments.set]
    plan = study.plan(arguments.study, sets, arguments.only, check_step=arguments.check_step)
    folder = Path(arguments.out) if arguments.out is not None else Path("results") / plan.name
    _check_report(arguments.report, plan, folder)
    clean_up_first(f"{CONTINUES}: {folder}")
    with Progress(plan.name, "runs") as progress:
        point_states = study.run(plan, folder, arguments.jobs, arguments.scheduler, progress)
    rows, margins = study.rows(point_states), study.found_margins(plan, point_states)
    fractions, across = study.found_fractions(plan, point_states), study.across(plan)
    asked = plan.study.tables
    figures = tables.figure_tables(rows, asked) if asked else []
    parts: dict[str, Sequence[SweepRow | MarginRow | FractionRow]] = {
        "rows": rows, "margins": margins, "fractions": fractions,
    }  # fmt: skip
    write_json(arguments.json, {name: [row.cells for row in part] for name, part in parts.items()})
    say(arguments, *results.sweep_tables(rows, margins, fractions, across), "", *figures)
    if asked:
        notes = [f"{line}." for line in results.shortcomings(rows)]
        head = [f"# {plan.name}", "", plan.study.description, "", *(part for line in notes for part in (line, ""))]
        write_whole(folder / "tables.md", "\n".join([*head, *figures]))
        say(arguments, f"tables: {folder / 'tables.md'}")
    say(arguments, *(f"table: {path}" for path in results.write(folder, rows, margins, fractions)))
    pictures = tables.plot(rows, asked, folder) if asked else []
    pictures += sweep_plots.plot(rows, study.swept(plan), margins, across, folder)
    pictures += point_figures.plot(plan, folder, arguments.jobs)
    say(arguments, *(f"picture: {path}" for path in pictures))
    if arguments.report is not None:
        _report(arguments, plan)
    flaws = [control_outcomes.missing_line(rows), None if margins else control_outcomes.trip_line(rows)]
    if any(flaws):
        raise DegradedError(f"the study ended, but: {'; '.join(flaw for flaw in flaws if flaw)}")


def _check_report(path: str | None, plan: SweepPlan, folder: Path) -> None:
    """Raise `InputError` if a study's runs do not fit on one page, or the page cannot be written."""
    from facts_damping.analysis.plotting.plots import COLOURS

    if path is None:
        return
    if plan.study.margin is not None:
        raise InputError("--report: given with a study that searches margins; allowed: with other studies")
    if len(plan.points) > len(COLOURS):
        allowed = f"1 to {len(COLOURS)}, chosen by --only COLUMN=VALUE,..."
        raise InputError(f"--report: given with {len(plan.points)} runs; allowed: {allowed}")
    files.new_folder(folder)  # the page may be one of its files
    files.check_writable(path, "--report", standard=False)


def _report(arguments: argparse.Namespace, plan: SweepPlan) -> None:
    """Write one page that compares the runs of a study, each named by what differs; the runs are made again."""
    from facts_damping_views.report import write

    named, columns = [], plan.points[0].columns
    differing = [name for name in columns if len({str(point.columns[name]) for point in plan.points}) > 1]
    with Progress("report", "runs") as progress:
        for done, point in enumerate(plan.points):
            progress(done, len(plan.points))
            name = ", ".join(str(point.columns[name]) for name in differing)
            named.append((name or plan.name, loop.run(make(plan.base, point.changes))))
    write(Path(arguments.report), named)
    say(arguments, f"report: {arguments.report}")


def campaign(arguments: argparse.Namespace) -> None:
    """Run the draws of a campaign and check the conditions for each, or hunt for the worst; both write run files."""
    from facts_damping_studies.campaigns import campaign as study
    from facts_damping_studies.campaigns import campaign_pages as pages
    from facts_damping_studies.sweeps import results

    plan = study.plan(arguments.campaign, arguments.set, arguments.draws, arguments.graphs)
    folder = Path(arguments.out) if arguments.out is not None else Path("results") / plan.name
    clean_up_first(f"{CONTINUES}: {folder}")
    if arguments.hunt is not None:
        _hunt(arguments, plan, folder)
        return
    with Progress("campaign", "draws") as progress:
        rows = study.run(plan, folder, arguments.jobs, arguments.scheduler, progress)
    graphs: list[DrawRow] = []
    if plan.campaign.graphs:
        from facts_damping_studies.campaigns import graphs as campaign_graphs

        with Progress("campaign", "graphs") as progress:
            graphs = campaign_graphs.graphs(plan, folder, arguments.jobs, progress)
    options = [f"--{name} {value}" for name in ("draws", "graphs") if (value := getattr(arguments, name)) is not None]
    sets = [f"--set {change}" for change in arguments.set]
    text = pages.page(plan, rows, graphs, " ".join(["facts-damping campaign", arguments.campaign, *options, *sets]))
    cells = {"draws": [row.cells for row in rows], "graphs": [row.cells for row in graphs]}
    write_json(arguments.json, cells)
    say(arguments, *pages.overview(rows, graphs))
    for name, part in cells.items():
        say(arguments, *(f"table: {path}" for path in results.tables(folder, name, part)) if part else ())
    say(arguments, *(f"table: {path}" for path in pages.write_tables(rows, graphs, folder)))
    write_whole(folder / "page.md", text)
    say(arguments, f"page: {folder / 'page.md'}")
    broken = [row for row in (*rows, *graphs) if row.error is None and not row.holds]
    flaws = [f"{_cases(len(broken))} with a requirement violated: {folder / study.FAILED}"] if broken else []
    errors = [row for row in (*rows, *graphs) if row.error is not None]
    if errors:
        flaws.append(f"{_cases(len(errors))} could not be run, the first: {errors[0].number}: {errors[0].error}")
    if flaws:
        raise DegradedError(f"the campaign ended, but: {'; '.join(flaws)}")


def _cases(count: int) -> str:
    return f"{count} case{'s' if count > 1 else ''}"


def _hunt(arguments: argparse.Namespace, campaign_plan: CampaignPlan, folder: Path) -> None:
    """Search for the worst cases of a campaign; what was found is written after an interrupt, too."""
    from facts_damping_studies.campaigns import hunt, hunt_pages

    option = next((name for name in ("draws", "graphs") if getattr(arguments, name) is not None), None)
    if option is not None:
        raise InputError(f"--{option} {getattr(arguments, option)}: given with --hunt; allowed: without it")
    with Progress("hunt", "s") as progress:
        hunted = hunt.run(campaign_plan, folder, arguments.hunt, arguments.jobs, arguments.scheduler, progress)
    sets = [f"--set {change}" for change in arguments.set]
    command = ["facts-damping campaign", arguments.campaign, f"--hunt {arguments.hunt:g}", *sets]
    write_json(arguments.json, hunt_pages.document(campaign_plan, hunted))
    say(arguments, f"{hunt_pages.counts(hunted)}.", *hunt_pages.rules_table(hunt_pages.compared(hunted.rows)))
    say(arguments, *(f"written: {path}" for path in hunt_pages.write(campaign_plan, hunted, folder, " ".join(command))))
    if not hunted.complete:
        raise KeyboardInterrupt
    errors = [row for row in hunted.rows if row.error is not None]
    if errors:
        raise DegradedError(
            f"the hunt ended, but: {_cases(len(errors))} could not be run, the first: {errors[0].error}"
        )


def margin(arguments: argparse.Namespace) -> None:
    """The delay margin of a loop with linear controllers, and its modes over the delay."""
    from facts_damping_studies.margins import delay_margin as study
    from facts_damping_studies.margins import delay_margin_pages as pages
    from facts_damping_studies.margins.delay_margin_runs import beside

    case, runs, pictures = loading.load_case(arguments.run, arguments.set), None, []
    with Progress("margin", "delays") as progress:
        loop_margin = study.margin(case, arguments.max_delay, arguments.pade, progress)
    if arguments.time_domain:
        with Progress("margin", "runs") as progress:
            runs = beside(loop_margin, progress)
    if arguments.out is not None:
        folder = files.new_folder(Path(arguments.out))
        pictures += [
            pages.plot(loop_margin, runs, folder / "margin.png"),
            pages.plot_loops(loop_margin, folder / "one_line.png"),
        ]
    write_json(arguments.json, pages.document(loop_margin, runs))
    alone = [] if case.supervision is None else ["without the run's supervisor, which may trip at shorter delays"]
    lines = [*pages.margin_text(loop_margin, runs), *alone, *untuned_lines(case)]
    say(arguments, *lines, *(f"plot: {path}" for path in pictures))
