"""The worst of a controller: a search over the cases of a set and what may fail in them, of a fixed number of cases."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Any

from facts_damping_studies.campaigns.campaign import CampaignPlan
from facts_damping_studies.campaigns.hunt import margin, search
from facts_damping_studies.campaigns.invariants import HARM
from facts_damping_studies.campaigns.parameters import BaseRun, Campaign
from facts_damping_studies.score.card import run_of
from facts_damping_studies.sweeps.pool import workers

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from facts_damping_studies.score.card import Controllers, Set

RULE = "does_no_harm"


def campaign_of(case_set: Set, rows: Controllers, seed: int = 0) -> CampaignPlan:
    """The fault campaign whose base runs are the cases of a set, with controllers."""
    cases = case_set.content.cases
    base_runs = {str(i): BaseRun(set=case.set) for i, case in enumerate(cases)}
    campaign = Campaign(seed=seed, draws=1, base_runs=base_runs, healthy=0.0)
    run = run_of(case_set, rows)
    return CampaignPlan(
        case_set.name, "", campaign, dict.fromkeys(base_runs, (run, case_set.name)), {}, case_set.digest
    )


def worst(case_set: Set, rows: Controllers, cases: int) -> dict[str, Any]:
    """The worst of so many hunted cases: number and kind of the case, fault, and ITAE relative to no control.

    The same search for each controller, with the margin of the campaigns' rule `does_no_harm`; None: no case tells.
    """
    found = search(campaign_of(case_set, rows), RULE, cases)
    row = min(found, key=lambda one: margin(one, RULE), default=None)
    if row is None or row["margins"].get(RULE) is None:
        return {"cases": cases, "ratio": None}
    case = int(row["base_run"])
    told = {name: row[name] for name in ("fault", "start_s", "lasts")}
    kind = case_set.content.cases[case].kind
    return {"cases": cases, "ratio": HARM - margin(row, RULE), "case": case, "kind": kind, **told}


def with_worst(
    case_set: Set, cards: Sequence[dict[str, Any]], controllers: Mapping[str, Controllers], cases: int, jobs: int
) -> list[dict[str, Any]]:
    """The cards, each with the `worst` of so many hunted cases of its controller; as they are for 0."""
    if not cases:
        return list(cards)
    with workers(jobs) as each:
        found = dict(each(partial(_named, case_set, cases), list(controllers.items())))
    return [{**card, "worst": found[card["controller"]]} for card in cards]


def _named(case_set: Set, cases: int, task: tuple[str, Controllers]) -> tuple[str, dict[str, Any]]:
    return task[0], worst(case_set, task[1], cases)
