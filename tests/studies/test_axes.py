"""Axes of studies, and the search of margins: synthetic, without runs."""

from __future__ import annotations

import re
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from scipy import stats

from facts_damping.errors import InputError
from facts_damping.parameters.field_errors import check
from facts_damping_studies.margins import margins
from facts_damping_studies.parameters import Axis, Margin, Study
from facts_damping_studies.sweeps import axes


def points(*sweep: dict[str, Any], seed: int = 0) -> list[axes.Point]:
    return axes.points(check(Study, {"sweep": list(sweep), "seed": seed}, "test"))


def values(spec: dict[str, Any]) -> list[Any]:
    return [point.columns["duration"] for point in points({"field": "duration", **spec})]


def test_study_without_axes_is_one_run() -> None:
    assert points() == [axes.Point({}, {})]


def test_axes_make_a_grid_the_last_fastest() -> None:
    grid = points({"field": "a.0.b", "values": [1, 2]}, {"field": "c", "values": ["x", "y", "z"]})
    assert [(p.changes["a.0.b"], p.changes["c"]) for p in grid] == [(a, c) for a in (1, 2) for c in "xyz"]
    assert all(p.columns == p.changes for p in grid)


def test_zipped_axes_go_side_by_side_within_a_grid() -> None:
    both = {"zip": [{"field": "a", "values": [1, 2]}, {"field": "b", "values": [3, 4]}]}
    grid = points(both, {"field": "c", "values": [5, 6]})
    assert [tuple(p.changes.values()) for p in grid] == [(1, 3, 5), (1, 3, 6), (2, 4, 5), (2, 4, 6)]


def test_value_goes_into_several_fields_by_factors() -> None:
    (point,) = points({"name": "total", "fields": {"up": 0.25, "down": 0.75}, "values": [0.1]})
    assert point == axes.Point({"total": 0.1}, {"up": 0.025, "down": 0.075})


def test_rows_set_several_fields_and_leave_others_alone() -> None:
    rows = [{"name": "LLC"}, {"name": "HBsWC", "scheme": "direct"}]
    row_points = points({"rows": rows})
    assert [p.changes for p in row_points] == rows
    assert [p.columns for p in row_points] == [{"name": "LLC", "scheme": None}, {"name": "HBsWC", "scheme": "direct"}]
    assert [p.columns for p in points({"name": "who", "rows": rows})] == [{"who": "LLC"}, {"who": "HBsWC direct"}]


def test_labels_stand_in_the_table_and_do_not_reach_the_run() -> None:
    rows = [{"p": 0.5, "q": 0.25}, {"p": 0.1, "q": 0.05}]
    row_points = points({"name": "burst", "labels": [2, 10], "rows": rows})
    assert [p.columns for p in row_points] == [{"burst": 2}, {"burst": 10}]
    assert [p.changes for p in row_points] == rows


@pytest.mark.parametrize(
    ("spec", "expected"),
    [
        ({"start": 0, "stop": 1, "step": 0.25}, [0, 0.25, 0.5, 0.75, 1]),
        ({"start": 0, "stop": 0.3, "step": 0.1}, [0, 0.1, 0.2, 0.3]),
        ({"start": 0, "stop": 0.35, "step": 0.1}, [0, 0.1, 0.2, 0.3]),
        ({"start": 1, "stop": 0, "number": 3}, [1, 0.5, 0]),
        ({"start": 1, "stop": 5, "number": 5}, [1, 2, 3, 4, 5]),
        ({"start": 3, "step": 2, "number": 3}, [3, 5, 7]),
        ({"stop": -2, "step": -1}, [0, -1, -2]),
        ({"start": 1, "stop": 9, "number": 1}, [1]),
    ],
)
def test_ranges(spec: dict[str, Any], expected: list[Any]) -> None:
    assert values({"range": spec}) == expected


def test_whole_ranges_stay_whole() -> None:
    assert all(type(value) is int for value in values({"range": {"start": 1, "stop": 5, "number": 5}}))
    assert all(type(value) is int for value in values({"range": {"start": 1, "step": 2, "number": 5}}))


LAWS = [
    ({"distribution": "uniform", "low": 1.0, "high": 3.0}, stats.uniform(1, 2)),
    ({"distribution": "loguniform", "low": 0.1, "high": 10.0}, stats.loguniform(0.1, 10)),
    ({"distribution": "normal", "mean": 2.0, "std": 0.5}, stats.norm(2, 0.5)),
    ({"distribution": "normal", "mean": 2.0, "std": 0.5, "low": 2.0}, stats.truncnorm(0, np.inf, 2, 0.5)),
    ({"distribution": "lognormal", "median": 2.0, "sigma": 0.3}, stats.lognorm(0.3, scale=2)),
]


@pytest.mark.parametrize("method", ["plain", "latin_hypercube"])
@pytest.mark.parametrize(("variable", "law"), LAWS, ids=[str(v) for v, _ in LAWS])
def test_draws_have_their_distribution_and_depend_on_the_seed_alone(
    variable: dict[str, Any], law: Any, method: str
) -> None:
    draws = {"draws": {"number": 2000, "method": method, "variables": [{"field": "duration", **variable}]}}
    durations = np.array([p.columns["duration"] for p in points(draws, seed=4)])
    assert stats.kstest(durations, law.cdf).pvalue > 1e-3
    assert points(draws, seed=4) == points(draws, seed=4)
    assert points(draws, seed=5) != points(draws, seed=4)
    if method == "latin_hypercube":
        assert sorted((law.cdf(durations) * 2000).astype(int)) == list(range(2000))


def test_variables_drawn_together_are_independent_and_whole_ones_whole() -> None:
    first = {"field": "a", "distribution": "uniform", "low": 0, "high": 1}
    two = {"field": "b", "distribution": "uniform", "low": 0.5, "high": 100.5, "whole": True}
    drawn = points({"draws": {"number": 500, "variables": [first, two]}})
    assert len(drawn) == 500
    assert abs(np.corrcoef([list(p.changes.values()) for p in drawn], rowvar=False)[0, 1]) < 0.15
    assert all(type(p.changes["b"]) is int and 0 <= p.changes["b"] <= 101 for p in drawn)


# Margins


def margin(**changed: Any) -> Margin:
    content = {"field": "delay", "low": 0.0, "high": 1.0, "coarse": 11, "tolerance": 0.005}
    return check(Margin, {**content, **changed}, "test")


def search(fails: Any, spec: Margin) -> tuple[margins.Bracket, int]:
    """The bracket, and how many values were tried; each is tried once."""
    tried: dict[float, bool | None] = {}
    while wanted := margins.wanted(spec, tried):
        assert not set(wanted) & set(tried)
        tried.update({value: fails(value) for value in wanted})
    return margins.bracket(tried), len(tried)


@given(edge=st.floats(1e-6, 1.0), coarse=st.integers(2, 40), tolerance=st.floats(1e-4, 0.3))
def test_bisection_brackets_the_edge(edge: float, coarse: int, tolerance: float) -> None:
    spec = margin(coarse=coarse, tolerance=tolerance)
    (low, high, again), tried = search(lambda value: value >= edge, spec)
    assert low is not None
    assert high is not None
    assert low < edge <= high
    assert high - low <= tolerance * (1 + 1e-6) or high - low <= 1 / (coarse - 1) * (1 + 1e-6) <= tolerance * (1 + 1e-6)
    assert again == []
    assert tried <= margins.max_runs(spec)


def test_run_that_holds_again_is_noticed_and_the_first_edge_is_the_margin() -> None:
    (low, high, again), _ = search(lambda value: 0.33 <= value < 0.55 or value >= 0.87, margin())
    assert low is not None
    assert high is not None
    assert low < 0.33 <= high
    assert {0.6, 0.7, 0.8} <= set(again)  # and values beside the edges, which are refined
    margin_row = margins.over_seeds([margins.Bracket(low, high, again)], margin(), 0)
    assert (margin_row.monotonic, margin_row.holds_again) == (False, again)
    assert (margin_row.low_s, margin_row.high_s) == (low, high)


@given(edges=st.lists(st.floats(0.02, 0.98), min_size=1, max_size=4, unique=True).map(sorted))
def test_set_that_holds_has_all_edges_that_the_grid_tells_apart(edges: list[float]) -> None:
    spec = margin(coarse=41)
    assume(all(high - low > 0.06 for low, high in pairwise([0.0, *edges, 1.0])))
    tried: dict[float, bool | None] = {}

    def fails(value: float) -> bool:
        return sum(value >= edge for edge in edges) % 2 == 1

    while wanted := margins.wanted(spec, tried):
        tried.update({value: fails(value) for value in wanted})
    ends = [end for interval in margins.holding([tried]) for end in interval]
    expected = [0.0, *edges, *([1.0] if len(edges) % 2 == 0 else [])]
    assert ends == pytest.approx(expected, abs=spec.tolerance)


def test_set_over_seeds_is_that_of_half_of_them() -> None:
    searches = [{i / 10: i / 10 > edge for i in range(11)} for edge in (0.3, 0.5, 0.7)]
    assert margins.holding(searches) == [[0.0, pytest.approx(0.55)]]
    assert margins.holding([{0.0: True, 1.0: True}]) == []


def test_margins_beyond_what_was_run_are_none() -> None:
    never, _ = search(lambda _: False, margin())
    always, _ = search(lambda _: True, margin())
    assert never == margins.Bracket(1.0, None, [])
    assert always == margins.Bracket(None, 0.0, [])
    margin_row = margins.over_seeds([never], margin(), 0)
    assert (margin_row.margin_s, margin_row.low_s, margin_row.high_s, margin_row.beyond) == (None, 1.0, None, "high")
    margin_row = margins.over_seeds([always], margin(), 0)
    assert (margin_row.margin_s, margin_row.low_s, margin_row.high_s, margin_row.beyond) == (None, None, 0.0, "low")


def test_share_that_holds_is_of_the_coarse_grid_over_all_searches() -> None:
    spec = margin(coarse=5)  # 0, 0.25, 0.5, 0.75, 1; values of the bisection do not count
    first = {0.0: False, 0.25: False, 0.375: False, 0.5: True, 0.75: False, 1.0: True}
    assert margins.held(spec, [first]) == pytest.approx(3 / 5)
    other = {0.0: True, 0.25: True, 0.5: True, 0.75: None, 1.0: True}  # one could not be run
    assert margins.held(spec, [first, other]) == pytest.approx(3 / 9)
    assert margins.held(spec, [{0.0: None}]) is None


def test_values_that_could_not_be_run_do_not_stop_the_search() -> None:
    (low, high, _), tried = search(lambda value: None if value > 0.6 else value > 0.34, margin())
    assert low == pytest.approx(0.34, abs=0.005)
    assert high == pytest.approx(0.34, abs=0.008)
    assert tried < 20
    bracket, _ = search(lambda _: None, margin())
    assert bracket == margins.Bracket(None, None, [])
    margin_row = margins.over_seeds([bracket], margin(), 0)
    assert (margin_row.margin_s, margin_row.low_s, margin_row.high_s) == (None, None, None)


def test_median_over_seeds_lies_in_its_interval_which_holds_it_as_often_as_it_says() -> None:
    random, inside = np.random.default_rng(1), 0
    for seed in range(200):
        edges = random.normal(0.3, 0.05, 20)
        margin_row = margins.over_seeds([margins.Bracket(e - 0.0025, e + 0.0025, []) for e in edges], margin(), seed)
        assert margin_row.low_s is not None
        assert margin_row.margin_s is not None
        assert margin_row.high_s is not None
        assert margin_row.low_s < margin_row.margin_s < margin_row.high_s
        inside += margin_row.low_s <= 0.3 <= margin_row.high_s
    assert 0.88 <= inside / 200 <= 1.0


def test_seeds_of_which_some_never_fail_have_a_median() -> None:
    brackets = [margins.Bracket(0.2, 0.21, [])] * 8 + [margins.Bracket(1.0, None, [])] * 2
    margin_row = margins.over_seeds(brackets, margin(), 0)
    assert margin_row.margin_s == pytest.approx(0.205)
    assert margin_row.low_s == 0.2
    few = margins.over_seeds(brackets[7:], margin(), 0)
    assert (few.margin_s, few.high_s, few.beyond) == (None, None, "high")


def test_shares_have_wilson_s_interval() -> None:
    fraction = margins.failed_fraction(3, 20)
    z, p, n = 1.959964, 0.15, 20
    middle, half = (p + z**2 / 2 / n) / (1 + z**2 / n), z * np.sqrt(p * (1 - p) / n + z**2 / 4 / n**2) / (1 + z**2 / n)
    assert (fraction.runs, fraction.failed, fraction.fraction) == (20, 3, 0.15)
    assert fraction.low == pytest.approx(middle - half)
    assert fraction.high == pytest.approx(middle + half)


# Draws of several kinds

SEED = {"field": "seed", "distribution": "uniform", "low": 0, "high": 100, "whole": True}
LASTS = {"name": "lasts", "field": "scenario.0.duration", "distribution": "uniform", "low": 1, "high": 2}
CHANGE = {"field": "change", "distribution": "normal", "mean": 0, "std": 1}
DRAWS: dict[str, Any] = {
    "number": 7,
    "method": "latin_hypercube",
    "variables": [SEED],
    "kinds": {
        "trip": {"set": {"scenario": [1]}},
        "fault": {"set": {"scenario": [2]}, "variables": [LASTS]},
        "step": {"set": {"scenario": [3]}, "variables": [CHANGE]},
    },
}


def test_kinds_come_in_turn_with_what_is_theirs_and_what_all_have() -> None:
    drawn = points({"name": "event", "draws": DRAWS}, seed=3)
    assert [kind_point.columns["event"] for kind_point in drawn] == [
        "trip",
        "fault",
        "step",
        "trip",
        "fault",
        "step",
        "trip",
    ]
    fields_of_kind = {"trip": set[str](), "fault": {"scenario.0.duration"}, "step": {"change"}}
    for drawn_point in drawn:
        assert set(drawn_point.changes) == {"seed", "scenario"} | fields_of_kind[drawn_point.columns["event"]]
        assert (drawn_point.columns["lasts"] is None) == (drawn_point.columns["event"] != "fault")
        assert list(drawn_point.columns) == ["seed", "event", "lasts", "change"]
    assert len({kind_point.columns["seed"] for kind_point in drawn}) == len(drawn)


def test_hypercube_is_one_over_the_draws_of_a_kind() -> None:
    axis = {"name": "event", "draws": {**DRAWS, "number": 30}}
    lasting = sorted(point.columns["lasts"] for point in points(axis) if point.columns["event"] == "fault")
    assert [int((value - 1.0) * 10) for value in lasting] == list(range(10))
    assert axes.drawn_columns(check(Axis, axis, "axis")) == ["seed", "lasts", "change"]


@pytest.mark.parametrize(
    ("axis", "said"),
    [
        ({"draws": DRAWS}, "`kinds` need a `name`"),
        ({"name": "event", "draws": {"number": 2}}, "neither `variables` nor `kinds` given"),
        ({"name": "event", "draws": {"number": 2, "kinds": {}}}, "kinds"),
        ({"name": "event", "draws": {**DRAWS, "kinds": {"a": {"variables": [SEED]}}}}, "kinds.a: 'seed' drawn twice"),
    ],
)
def test_bad_kinds_are_refused(axis: dict[str, Any], said: str) -> None:
    with pytest.raises(InputError, match=re.escape(said)):
        points(axis)
