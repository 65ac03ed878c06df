"""The worst of a controller: a search over the cases of a set and what may fail in them, of a fixed number of cases."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING

from facts_damping_studies.campaigns.campaign import CampaignPlan
from facts_damping_studies.campaigns.hunt import margin, search
from facts_damping_studies.campaigns.invariants import HARM
from facts_damping_studies.campaigns.parameters import BaseRun, Campaign
from facts_damping_studies.score.cases.sets import run_of
from facts_damping_studies.score.score_card import Hunted, WorstCase
from facts_damping_studies.sweeps.pool import run_all

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from facts_damping_studies.score.cases.sets import Controllers, Set
    from facts_damping_studies.score.score_card import ScoreCard

RULE = "does_no_harm"


def campaign_of(case_set: Set, rows: Controllers, seed: int = 0) -> CampaignPlan:
    """The fault campaign whose base runs are the cases of a set, with controllers."""
    cases = case_set.cases
    base_runs = {str(i): BaseRun(set=case.set) for i, case in enumerate(cases)}
    campaign = Campaign(seed=seed, draws=1, base_runs=base_runs, healthy=0.0)
    run = run_of(case_set.content, rows)
    return CampaignPlan(
        case_set.name, "", campaign, dict.fromkeys(base_runs, (run, case_set.name)), {}, case_set.digest
    )


def worst(case_set: Set, rows: Controllers, cases: int) -> Hunted:
    """The worst of so many hunted cases.

    The same search for each controller, with the margin of the campaigns' rule `does_no_harm`.
    """
    hunted = search(campaign_of(case_set, rows), RULE, cases)
    row = min(hunted, key=lambda hunted_row: margin(hunted_row.margins, RULE), default=None)
    if row is None or row.margins.get(RULE) is None:
        return Hunted(cases, None)
    drawn, case = row.drawn, int(row.drawn.base_run)
    ratio, kind = HARM - margin(row.margins, RULE), case_set.cases[case].kind
    return Hunted(cases, WorstCase(ratio, case, kind, drawn.fault, drawn.start_s, drawn.labels["lasts"]))


def with_worst(
    case_set: Set,
    cards: Sequence[ScoreCard],
    controllers: Mapping[str, Controllers],
    cases: int,
    jobs: int,
    progress: Callable[[int, int], None],
) -> list[ScoreCard]:
    """The cards, each with the worst of so many hunted cases of its controller; as they are for 0."""
    if not cases:
        return list(cards)
    hunted = run_all(partial(worst, case_set, cases=cases), list(controllers.values()), jobs, progress)
    worst_by_name = dict(zip(controllers, hunted, strict=True))
    return [replace(card, hunted=worst_by_name.get(card.controller)) for card in cards]
