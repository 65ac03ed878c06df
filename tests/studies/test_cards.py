"""The cards of the repository: of the sets as they are drawn, with all baselines, and as measured again."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest

from facts_damping.input_files import share_folder
from facts_damping.parameters.files import shipped
from facts_damping_studies.score.card import compared, logs, scored
from facts_damping_studies.score.cases.sets import read_set
from facts_damping_studies.score.entries import FIXED, NONE, _measured, stored_entries
from facts_damping_studies.score.statistics import changes, groups

if TYPE_CHECKING:
    from facts_damping_studies.score.measure import Measured

CARDS = share_folder() / "cards"
SETS = {path.name: read_set(path.name) for path in sorted(CARDS.iterdir()) if path.is_dir()}
ENTRIES = {name: stored_entries(case_set) for name, case_set in SETS.items()}


def test_every_shipped_set_has_cards_of_its_baselines_and_references() -> None:
    assert SETS.keys() == shipped("case_sets").keys()
    for name, case_set in SETS.items():
        assert {*FIXED, *case_set.content.controllers} <= set(ENTRIES[name])
        for entry in ENTRIES[name].values():
            assert len(entry.cases) == len(case_set.cases)


@pytest.mark.parametrize("name", SETS)
def test_order_of_different_groups_holds_in_95_of_100_other_resamples(name: str) -> None:
    entries, case_set = ENTRIES[name], SETS[name]
    measured = [entry.cases for entry in entries.values() if entry.name not in FIXED]
    beside, none = case_set.content.beside, entries[NONE].cases
    changed = scored(compared(case_set, measured, none), beside)
    group_of = {i: g for g, group in enumerate(groups(changed)) for i in group}
    ratios = np.array([logs(cases, none) for cases in measured])
    kinds, events = [case.kind for case in case_set.cases], [case.event for case in case_set.cases]
    drawn = scored(changes(ratios, kinds, events, 1), beside).drawn
    pairs = [(i, j) for i in group_of for j in group_of if group_of[i] < group_of[j]]
    held = np.mean([np.all([drawn[i, k] < drawn[j, k] for i, j in pairs]) for k in range(drawn.shape[1])])
    assert held >= 0.95


@pytest.mark.parametrize("controller", ["LQG", "ANFBsC direct", *FIXED])
@pytest.mark.parametrize("i", [0, 30, 62])
def test_case_of_a_card_is_as_it_is_measured_now(controller: str, i: int) -> None:
    """A change of the plant or of a controller that moves it makes another version of the set."""
    case_set, entry = SETS["two_area_2.0"], ENTRIES["two_area_2.0"][controller]
    measured = _measured(case_set, controller, entry.rows, i).measured
    assert close(measured, entry.cases[i])


def close(measured: Measured, stored: Measured) -> bool:
    """Whether figures are the same but for rounding on another processor."""
    pairs = [(a, b) for a, b in zip(measured, stored, strict=True) if isinstance(b, float)]
    return all(a is not None and np.isclose(float(a), b, rtol=2e-3, atol=1e-9) for a, b in pairs)
