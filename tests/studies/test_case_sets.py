"""Sets of cases: a version never changes, its cases are of many events, can be made, and are not the held-out ones."""

from __future__ import annotations

import itertools

import pytest

from facts_damping.errors import InputError
from facts_damping.parameters.files import read_table, shipped
from facts_damping.simulation.loop import build_loop
from facts_damping_studies.score.cases.kinds import KINDS
from facts_damping_studies.score.cases.sets import Set, case_of, drawn_again, held_out, read_set, set_of

# What was published under a name and a version never changes.
FROZEN = {
    "two_area_2.0": "7b0b07ef8a5244c0",
    "nets_nyps_2.0": "f2457c009935f40b",
    "minniwecc_2.0": "82eac183228b4d20",
    "two_area_ibr_1.0": "7bd507a2b1895382",
    "wecc_240_1.0": "d4e255677ddcd0fc",
}
SETS = {name: read_set(name) for name in FROZEN}
ROWS = [{"name": "LLC"}]


def quiet(_done: int, _of: int) -> None: ...


def test_all_shipped_sets_are_frozen() -> None:
    assert shipped("case_sets").keys() == FROZEN.keys()
    assert {name: case_set.digest for name, case_set in SETS.items()} == FROZEN


@pytest.mark.parametrize("name", FROZEN)
def test_kind_in_a_score_has_six_events_at_least_and_shares_them_with_its_kin_alone(name: str) -> None:
    case_set = SETS[name]
    events = {kind: {case.event for case in case_set.cases if case.kind == kind} for kind in case_set.content.kinds}
    assert all(len(events[kind]) >= 6 for kind in events if kind not in case_set.content.beside)
    for one_kind, other in itertools.combinations(events, 2):
        kin = KINDS[one_kind].drawn_as and KINDS[one_kind].drawn_as == KINDS[other].drawn_as
        assert events[one_kind] == events[other] if kin else events[one_kind].isdisjoint(events[other])
    seeds = {case.set["seed"] for case in case_set.cases}
    assert len(seeds) == len({case.event for case in case_set.cases})


@pytest.mark.parametrize("name", [name for name in FROZEN if name != "wecc_240_1.0"])
def test_case_of_each_kind_can_be_made_and_is_designed_on_the_same_grid(name: str) -> None:
    case_set = SETS[name]
    first = {case.kind: i for i, case in reversed(list(enumerate(case_set.cases)))}
    cases = [case_of(case_set, ROWS, i) for i in first.values()]
    assert len({case.designed_on.model_dump_json() for case in cases}) == 1
    assert len({case.system.model_dump_json() for case in cases}) >= len(cases) - 3  # delays share their grids
    for case in cases[:4]:
        build_loop(case)


def test_another_text_draws_other_cases_of_the_same_kinds() -> None:
    case_set = SETS["two_area_2.0"]
    other = drawn_again(small(case_set), "another text", "other", 1, quiet)
    again = drawn_again(small(case_set), "another text", "other", 1, quiet)
    assert other == again
    assert [case.kind for case in other.cases] == list(case_set.content.kinds)
    assert not {case.set["seed"] for case in other.cases} & {case.set["seed"] for case in case_set.cases}


def small(case_set: Set) -> Set:
    """The set with a case of each kind."""
    kinds = dict.fromkeys(case_set.content.kinds, 1)
    return case_set._replace(content=case_set.content.model_copy(update={"kinds": kinds}))


def test_text_of_held_out_cases_is_not_that_of_others() -> None:
    with pytest.raises(InputError, match=r"--heldout: 'a guess' given; allowed: the text of two_area 2\.0"):
        held_out(SETS["two_area_2.0"], "a guess", 1, quiet)
    assert len({case_set.content.heldout for case_set in SETS.values()}) == len(SETS)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"kinds": {"nominal": 1, "calm": 2}}, "kinds: 'calm' given; allowed: nominal, "),
        ({"beside": ["noise"], "kinds": {"nominal": 1}}, "beside: 'noise' given; allowed: nominal"),
        ({"lines": ["line_9"]}, "lines: 'line_9' given (did you mean line_4?); allowed: "),
        ({"signals": ["none"]}, "signals: 'none' given; allowed: w12, "),
        ({"heldout": "abc"}, "heldout"),
        ({"seed": ""}, "seed"),
    ],
)
def test_wrong_field_of_a_set_is_named(changes: dict[str, object], said: str) -> None:
    content = read_table(shipped("case_sets")["two_area_2.0"]) | changes
    with pytest.raises(InputError, match="mine") as caught:
        set_of("mine", content, "mine")
    assert said in str(caught.value)
