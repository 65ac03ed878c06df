"""Hunts for the worst cases: better than random points, shrunk to what still violates, kept after an interrupt."""

from __future__ import annotations

import json
import math
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from facts_damping.case.loading import load_case
from facts_damping.cli.main import main
from facts_damping.simulation import loop
from facts_damping_studies.campaigns import campaign, hunt, hunt_pages, invariants
from facts_damping_studies.campaigns.faults import FAULTS, ONLY_REAL, Numbers
from facts_damping_studies.campaigns.hunt_rows import HuntRow, ShrunkRow
from facts_damping_studies.campaigns.proposals import proposal, spread, turns
from facts_damping_studies.campaigns.shrink import shrunk
from tests.commands import assert_one_line

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

    from facts_damping_studies.campaigns.campaign import Choice

TURNED = """\
description: a wrong sign or nothing on two_area
seed: 5
draws: 6
window: [0.6, 0.8]
healthy: 0.3
faults: {wrong_sign: 1, gain: 1}
lasting: 0.9
base_runs:
  two_area:
    run: two_area_supervised
    set: {duration: 4, arm_at: 0.2, supervision.arming.ramp: 0.1, scenario: small}
    choose:
      controller: {LLC: {controllers.0.name: LLC}, HBsWC: {controllers.0.name: HBsWC}}
      link: {ideal: {link: ideal}, pdci: {link: pdci}}
"""
SIZE, WORST = 6, -0.4  # of the toy


@pytest.fixture
def turned(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(hunt, "BATCH", 7)
    monkeypatch.setattr(hunt, "KINDS", 1)
    path = tmp_path / "turned.yaml"
    path.write_text(TURNED)
    return path


def toy(at: NDArray[np.float64]) -> float:
    """Violated where the first two coordinates choose one of four kinds each, and worst near a point of the others."""
    right = (int(4 * at[0]) == 1) + (int(4 * at[1]) == 3)
    return 0.3 * (2 - right) + float(np.abs(at[2:] - 0.7).max()) + WORST


def hunted(seed: int, cases: int) -> NDArray[np.float64]:
    """Points of a hunt of the toy, as a campaign hunts: a spread first, then proposals."""
    random, amounts = np.random.default_rng(seed), np.arange(SIZE) > 1
    points = spread(cases // 5, amounts, random)
    margins = np.array([toy(at) for at in points])
    for _ in range(cases - len(points)):
        kinds = [(f"{int(4 * at[0])}", f"{int(4 * at[1])}") for at in points]
        points = np.vstack([points, proposal(points, kinds, margins, amounts, random)])
        margins = np.append(margins, toy(points[-1]))
    return points


def test_hunt_comes_twice_as_near_to_the_worst_as_as_many_random_points() -> None:
    hunted_ends, drawn = [], []
    for seed in range(6):
        points = hunted(seed, 300)
        assert 0.0 <= points.min() <= points.max() < 1.0
        hunted_ends.append(min(toy(at) for at in points))
        drawn.append(min(toy(at) for at in np.random.default_rng(seed + 100).random((300, SIZE))))
    assert max(hunted_ends) < 0.0
    assert 2.0 * (np.median(hunted_ends) - WORST) < np.median(drawn) - WORST


def test_parents_of_other_base_runs_are_kept_beside_the_best() -> None:
    """A base run that is better at first must not end the search in the others."""
    points, kinds = np.full((2, SIZE), [[0.1], [0.9]]), [("first", "gain"), ("second", "gain")]
    random, amounts = np.random.default_rng(0), np.arange(SIZE) > 1
    nexts = [proposal(points, kinds, np.array([-5.0, -1.0]), amounts, random) for _ in range(200)]
    assert sum(at[0] == 0.1 for at in nexts) > 30 < sum(at[0] == 0.9 for at in nexts)


def test_rules_that_nothing_violates_share_a_turn_once_they_no_longer_change() -> None:
    bests = np.array([[1.0, 2.0 - 0.1 * i, -1.0, 3.0] for i in range(10)])
    assert turns(bests[:0], 8) == [0, 0, 1, 1, 2, 2, 3, 3]
    assert turns(bests, 7) == [0, 1, 1, 1, 2, 2, 2]
    assert turns(bests[:9], 7) == [1, 1, 1, 2, 2, 2, 3]


def test_given_numbers_choose_as_often_as_a_generator() -> None:
    """Over equally spaced numbers: the same fractions, with the first and last choice at the ends."""
    names, p = ["a", "b", "c"], np.array([0.2, 0.5, 0.3])
    grid = ((np.arange(1000) + 0.5) / 1000).tolist()
    ends_only, whole = (Numbers(grid), Numbers(grid))
    chosen = [ends_only.choice(names, p) for _ in grid]
    assert [chosen.count(name) for name in names] == [200, 500, 300]
    assert np.bincount([whole.integers(4) for _ in grid]).tolist() == [250] * 4
    assert Numbers([0.25]).uniform(2.0, 4.0) == 2.5


def of_choice(choice: Choice, sizes: list[float]) -> float:
    """Violated by a fault that is large and lasts; worse with any link but that of the base run."""
    if choice.fault == "none":
        return 0.5
    lasts = math.inf if choice.duration is None else choice.duration
    return 0.5 - min(sizes[0], 0.4) - min(lasts, 0.5) / 2.5 - 0.05 * ("link" in choice.chosen)


def test_shrunk_case_still_violates_and_no_worse() -> None:
    choice = campaign.Choice("two_area", {"controller": "LLC", "link": "pdci"}, "gain", 3.217, None, 7)
    (milder, sizes), margin = shrunk(choice, [0.9], of_choice)
    assert of_choice(choice, [0.9]) <= margin == of_choice(milder, sizes) < 0.0
    assert (milder.chosen, milder.seed, milder.start, milder.duration) == ({}, None, 3.0, 0.5)
    assert sizes[0] < 0.9


@pytest.mark.parametrize("fault", [name for name in FAULTS if name not in ONLY_REAL])
def test_campaign_fault_of_the_mildest_size_makes_a_case(turned: Path, fault: str) -> None:
    """Also where the mildest of its stages takes more numbers than the one that was found."""
    plan, mild = campaign.plan(str(turned)), FAULTS[fault].mild
    choice = campaign.Choice("two_area", {}, fault, 1.0, 0.5, None)
    for sizes in ([mild], [0.99, mild], [mild, 0.99]):
        drawn = hunt.draw_of(plan, ShrunkRow("shrunk", 0, choice._asdict(), sizes, 0.0, 0))
        assert campaign.case_of(plan, drawn).run.seed == 0
        assert fault in hunt_pages.words(plan, drawn) or fault == "none"


def hunt_document(arguments: list[str], folder: Path) -> dict[str, Any]:
    assert main(["campaign", *arguments, "--out", str(folder), "--jobs", "1", "--json", str(folder.parent / "t")]) == 0
    document: dict[str, Any] = json.loads((folder.parent / "t").read_text())
    return document


def test_hunt_writes_a_page_and_run_files_that_violate_and_goes_on(turned: Path, tmp_path: Path) -> None:
    folder = tmp_path / "out"
    document = hunt_document([str(turned), "--hunt", "0.001"], folder)
    assert document["cases"] % 14 == 0 < document["cases"]
    rules = {row["rule"]: row for row in document["rules"]}
    assert set(rules) == set(invariants.INVARIANTS)
    text = (folder / "hunt.md").read_text()
    assert all(line in text for line in hunt_pages.rules_table([], markdown=True))
    harm = rules["does_no_harm"]["shrunk"]
    assert harm["margin"] < 0.0
    cases = [load_case(str(folder / "hunt" / f"does_no_harm_{what}.yaml")) for what in ("worst", "mildest")]
    free = loop.run(load_case(None, ["scenario=small", "controllers=[]", "duration=4"]))
    worst, mildest = (invariants.harm(loop.run(case), free) or 0.0 for case in cases)
    assert mildest == pytest.approx(harm["margin"])
    assert worst <= mildest < 0.0
    assert hunt_document([str(turned), "--hunt", "0.001"], folder) == document  # nothing is left to do


def test_hunt_keeps_its_cases_after_an_interrupt(
    turned: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    evaluate, asked = hunt.evaluate, iter(range(10))

    def interrupted(*positional: Any) -> tuple[str, HuntRow]:
        if next(asked) == 5:
            raise KeyboardInterrupt
        return evaluate(*positional)

    monkeypatch.setattr(hunt, "evaluate", interrupted)
    folder = tmp_path / "out"
    assert main(["campaign", str(turned), "--hunt", "1", "--out", str(folder), "--jobs", "1"]) == 130
    assert "the same command continues the study" in capsys.readouterr().err
    assert "Cases hunted: " in (folder / "hunt.md").read_text()
    assert len((folder / "hunt.jsonl").read_text().splitlines()) > 1


def test_set_wins_over_the_lists_of_a_campaign(turned: Path) -> None:
    lists = campaign.plan(str(turned), ["controllers=[{name: LQG}]"]).campaign.base_runs["two_area"].choose
    assert list(lists) == ["link"]
    assert list(campaign.plan(str(turned), ["seed=1"]).campaign.base_runs["two_area"].choose) == ["controller", "link"]


@pytest.mark.parametrize(
    ("options", "named"),
    [
        (["--hunt", "0"], "--hunt: 0 given; allowed: 0.001 to 10080 minutes"),
        (["--hunt", "1", "--draws", "3"], "--draws 3: given with --hunt; allowed: without it"),
        (["--hunt", "1", "--graphs", "3"], "--graphs 3: given with --hunt; allowed: without it"),
    ],
)
def test_wrong_options_of_a_hunt_are_one_line(
    turned: Path, options: list[str], named: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert_one_line(2, ["campaign", str(turned), *options], named, capsys)
