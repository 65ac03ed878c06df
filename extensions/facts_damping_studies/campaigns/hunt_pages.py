"""The page of a hunt: the worst cases of each rule beside those of random draws, and their mildest forms."""

from __future__ import annotations

import math
from bisect import bisect_right
from itertools import accumulate
from typing import TYPE_CHECKING, Any, NamedTuple

from facts_damping.output.tables import table
from facts_damping.output.writing import write_whole
from facts_damping.parameters.files import new_folder
from facts_damping_studies.campaigns import campaign as study
from facts_damping_studies.campaigns import invariants
from facts_damping_studies.campaigns.campaign_tables import WORDS
from facts_damping_studies.campaigns.faults import FAULTS, NOTHING
from facts_damping_studies.campaigns.hunt import ARMS, draw_of, margin

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from facts_damping_studies.campaigns.campaign import CampaignPlan, Draw
    from facts_damping_studies.campaigns.hunt import Hunt
    from facts_damping_studies.campaigns.hunt_rows import HuntRow

    Rows = Sequence[HuntRow]

FOLDER, PAGE = "hunt", "hunt.md"
NONE = "-"
SPAN = ("start", "duration")


class Found(NamedTuple):
    """What was found about a rule."""

    rule: str
    unit: str
    hunted: HuntRow | None  # row with the smallest margin of the hunt; None: nothing can violate the rule
    random: HuntRow | None  # the same of as many random cases
    violated: int  # hunted cases that violate the rule
    random_violated: int
    ratio: float | None  # severity of the worst to that of the random ones; None: not both violate the rule


def compared(rows: Rows) -> list[Found]:
    """What was found about each rule, by hunted and random cases in the same time of computing."""
    arms = [[row for row in rows if row.arm == arm] for arm in ARMS]
    until = [list(accumulate(row.took_s for row in arm)) for arm in arms]
    many = [bisect_right(times, min((each[-1] for each in until if each), default=0.0)) for times in until]
    return [_found(rule, arms[0][: many[0]], arms[1][: many[1]]) for rule in invariants.INVARIANTS]


def _found(rule: str, hunted: Rows, drawn: Rows) -> Found:
    units = {name: rule_row.unit for name, rule_row in (invariants.ALONE | invariants.BESIDE).items()}
    worst, other = (min(rows, key=lambda row: margin(row.margins, rule), default=None) for rows in (hunted, drawn))
    counts = [sum(margin(row.margins, rule) < 0.0 for row in rows) for rows in (hunted, drawn)]
    hunted_margin, beside = (math.inf if row is None else margin(row.margins, rule) for row in (worst, other))
    ratio = hunted_margin / beside if hunted_margin < 0.0 and beside < 0.0 else None
    finite = [row if math.isfinite(value) else None for row, value in ((worst, hunted_margin), (other, beside))]
    return Found(rule, units[rule], finite[0], finite[1], counts[0], counts[1], ratio)


def rules_table(findings: Sequence[Found], *, markdown: bool = False) -> list[str]:
    """A row for each rule: smallest margins and violations, hunted and random, and their ratio."""
    heads = ["what must hold", "unit", "smallest margin", "random draws", "violated", "random draws", "times as severe"]
    lines = []
    for finding in findings:
        margins = [
            NONE if row is None else f"{margin(row.margins, finding.rule):.3g}"
            for row in (finding.hunted, finding.random)
        ]
        counts = [str(finding.violated), str(finding.random_violated)]
        lines.append(
            [
                WORDS[finding.rule],
                finding.unit,
                *margins,
                *counts,
                NONE if finding.ratio is None else f"{finding.ratio:.2g}",
            ]
        )
    return table(heads, lines, 2, markdown=markdown)


def counts(hunt: Hunt) -> str:
    """The number of cases and their time as a sentence."""
    arms = [[row for row in hunt.rows if row.arm == arm] for arm in ARMS]
    hunted, drawn = (f"{len(arm)} in {sum(row.took_s for row in arm):.0f} s" for arm in arms)
    minutes = max((row.at_s or 0.0 for row in hunt.rows), default=0.0) / 60.0
    rate = f", {len(hunt.rows) / minutes:.0f} a minute" if minutes else ""
    return f"Cases hunted: {hunted} of computing; drawn: {drawn}{rate}"


def words(plan: CampaignPlan, drawn: Draw) -> str:
    """A case in words: base run, what was chosen, the fault, when, and its sizes."""
    labels = [f"{name} {label}" for name, label in drawn.chosen.items() if name != "lasts"]
    where = ", ".join([drawn.base_run, *labels])
    if drawn.fault == NOTHING:
        return f"{where}: nothing fails"
    until = f"for {drawn.chosen['lasts']} s" if drawn.chosen["lasts"] else "to the end"
    sizes = [f"{name} {value}" for name, value in _sizes(plan, drawn).items()]
    what = ", ".join(sizes) or FAULTS[drawn.fault].description
    return f"{where}: `{drawn.fault}` from {drawn.start:g} s {until} ({what})"


def _sizes(plan: CampaignPlan, drawn: Draw) -> dict[str, Any]:
    """What the fault sets, without its time; of a link, in the stages that it adds."""
    sound = study.healthy(plan, drawn)
    changes = [value for path, value in drawn.changes.items() if sound.changes.get(path) != value and path != "link"]
    link = drawn.changes.get("link")
    if isinstance(link, dict):
        usual = study.case_of(plan, sound).link.model_dump()
        changes += [stages[len(usual[way]) :] for way, stages in link.items() if way in ("up", "down")]
    parts = [part for change in changes for part in (change if isinstance(change, list) else [change])]
    parts = [inner for part in parts for inner in (part, part.get("clock")) if isinstance(inner, dict)]
    return {name: value for part in parts for name, value in part.items() if name not in (*SPAN, "clock")}


def document(plan: CampaignPlan, hunt: Hunt) -> dict[str, Any]:
    """The result for JSON."""
    rule_rows = []
    for finding in compared(hunt.rows):
        rows = {"hunted": finding.hunted, "random": finding.random, "shrunk": hunt.shrunk.get(finding.rule)}
        rule_rows.append(finding._asdict() | {name: None if row is None else row.cells for name, row in rows.items()})
    return {"campaign": plan.name, "seed": plan.campaign.seed, "cases": len(hunt.rows), "rules": rule_rows}


def write(plan: CampaignPlan, hunt: Hunt, folder: Path, command: str) -> list[Path]:
    """Write the page and the run files; return their paths."""
    findings, written = compared(hunt.rows), [folder / PAGE]
    lines = [f"# {plan.name}: the worst cases", "", plan.campaign.description, "", f"    {command}", ""]
    lines += [f"{counts(hunt)}.", "", *rules_table(findings, markdown=True), ""]
    lines += ["A margin is the distance to a violation, below zero beyond it. Each case is a run file, for"]
    lines += ["`facts-damping simulate`. The mildest form has what can be left out, shortened or made smaller.", ""]
    for rule, shrunk in hunt.shrunk.items():
        worst = min(hunt.rows, key=lambda row: margin(row.margins, rule))
        lines += [f"## {WORDS[rule][0].upper()}{WORDS[rule][1:]}", ""]
        of_worst = "worst", draw_of(plan, worst), margin(worst.margins, rule)
        for what, drawn, value in (of_worst, ("mildest", draw_of(plan, shrunk), shrunk.margin)):
            path = new_folder(folder / FOLDER) / f"{rule}_{what}.yaml"
            write_whole(path, study.run_file(plan, drawn, f"Hunted, {what}: case"))
            written.append(path)
            case = f"margin {value:.3g}: {words(plan, drawn)}."
            lines.append(f"- **{what.capitalize()}** ([run file]({FOLDER}/{path.name})), {case}")
        lines.append("")
    write_whole(folder / PAGE, "\n".join(lines))
    return written
