"""Controllers compared on any grid: its cases are drawn, and controllers with parameters to choose are tuned for it."""

from __future__ import annotations

from typing import TYPE_CHECKING

from facts_damping.case.loading import changed_case
from facts_damping_studies.score.cases.drawing import FAULT, STEP, TRIP
from facts_damping_studies.score.cases.sets import drawn_again, run_of

if TYPE_CHECKING:
    from collections.abc import Mapping

    from facts_damping.case.model import Case
    from facts_damping_studies.design.design import Tell
    from facts_damping_studies.score.cases.own_grid import Ground
    from facts_damping_studies.score.cases.sets import Controllers, Set

PROFILE = "measured"


def kinds_of(cases: int) -> dict[str, int]:
    """So many cases, of faults, trips and steps in turn."""
    kinds = FAULT, TRIP, STEP
    return {kind: (cases + len(kinds) - 1 - i) // len(kinds) for i, kind in enumerate(kinds)}


def training_cases(ground: Ground, jobs: int, tell: Tell) -> list[Case]:
    """A case of each kind, without controllers, on which controllers are tuned: none of those that are compared."""
    content = ground.case_set.content
    narrow = ground.case_set._replace(content=content.model_copy(update={"kinds": dict.fromkeys(content.kinds, 1)}))
    training = drawn_again(narrow, f"{content.seed} training", "training", jobs, tell("compare", "training cases"))
    run = run_of(training.content, ())
    return [changed_case(run, training.name, case.set) for case in training.cases]


def with_controllers(case_set: Set, entrants: Mapping[str, Controllers]) -> Set:
    """The set of cases with its controllers."""
    rows = {name: list(controllers) for name, controllers in entrants.items()}
    return case_set._replace(content=case_set.content.model_copy(update={"controllers": rows}))


def tuned_text(entrants: Mapping[str, Controllers], controllers: Mapping[str, Controllers]) -> list[str]:
    """Lines: the parameters that were tuned."""
    lines = []
    for name, rows in entrants.items():
        if rows[0].get("parameters") != controllers[name][0].get("parameters"):
            values = ", ".join(f"{key} {value}" for key, value in rows[0]["parameters"].items())
            lines.append(f"{name} tuned: {values}")
    return lines
