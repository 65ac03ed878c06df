"""Scores: a controller that does nothing is no control, bad ones rank below it; cards do not depend on cores."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import facts_damping as fd
from facts_damping.cli.main import main
from facts_damping_studies.score import card
from facts_damping_studies.score.card import LOST, case_of, estimate, logs, ranking, read_set, set_of
from facts_damping_studies.score.measure import Measured, measure
from facts_damping_studies.score.pages import ranking_table, write_ranking
from facts_damping_studies.score.worst import worst
from tests.commands import assert_one_line
from tests.two_devices import ACTUATORS

# What was published under a name and a version never changes.
FROZEN = {"two_area_1.0": "c1e6bc09e5427bda", "nets_nyps_1.0": "64f36fb55048ba28", "minniwecc_1.0": "da153a07dfa67c28"}
DATA = Path(__file__).parents[1] / "data"


class Nothing:
    """Sets zero."""

    def __init__(self, spec: Any) -> None:
        """Nothing is needed."""

    def step(self, t_s: float, y: Any, age_s: Any, fresh: Any) -> Any:
        """Zero."""
        return 0.0 * y


class WrongSign(Nothing):
    """Feeds the oscillation."""

    def step(self, t_s: float, y: Any, age_s: Any, fresh: Any) -> Any:
        """Against what damps."""
        return -12.0 * y


@pytest.fixture
def cases() -> str:
    """A set with six cases of the shipped one."""
    return str(DATA / "case_set.yaml")


@pytest.mark.parametrize(("name", "digest"), FROZEN.items())
def test_version_of_a_set_never_changes(name: str, digest: str) -> None:
    """Nor does its digest, if cards call a kind by a clearer name."""
    case_set = read_set(name)
    assert case_set.digest == digest
    assert "wrong sign behind the supervisor" in case_set.content.kinds
    assert "wrong sign" not in [*case_set.content.kinds, *(case.kind for case in case_set.content.cases)]


def test_name_of_a_kind_that_a_set_lacks_is_refused(cases: str) -> None:
    content = read_set(cases).content.model_dump() | {"called": {"drift": "moved"}}
    with pytest.raises(fd.InputError, match="mine: called: 'drift' given; allowed: nominal, delay 100 ms, noise"):
        set_of("mine", content, "mine")


@pytest.mark.parametrize("name", FROZEN)
def test_cases_of_a_score_set_can_be_made(name: str) -> None:
    case_set = read_set(name)
    kinds = {
        case_set.content.cases[i].kind for i in range(len(case_set.content.cases)) if case_of(case_set, (), i).ticks
    }
    assert kinds == set(case_set.content.kinds)


def test_controller_that_does_nothing_is_no_control_and_a_wrong_one_is_below(cases: str, tmp_path: Path) -> None:
    nothing, wrong, right = (fd.score(candidate, cases, ["LLC"], jobs=1) for candidate in (Nothing, WrongSign, "LLC"))
    assert nothing.value == pytest.approx(0.0, abs=0.1)
    assert wrong.value < right.value
    assert right.content["change"]["percent"] < -10.0 < 10.0 < wrong.content["change"]["percent"]
    assert wrong.content["does_harm"]
    assert "It cannot be said to be better than no control." in repr(wrong)
    better = replace(right._card, score=5.0)
    ranked = ranking([wrong._card, better])
    rows = [line.split()[0] for line in ranking_table(ranked) if line[0] not in " -"][1:]
    assert rows[:2] == ["LLC", "no"]
    assert "tests.studies.test_score:WrongSign".startswith(rows[2])  # the name may be wrapped
    table, _ = write_ranking(ranked, tmp_path)
    assert [line.split(",")[0] for line in table.read_text().splitlines()[1:]] == [
        '"LLC"',
        '"tests.studies.test_score:WrongSign"',
    ]


def test_card_is_the_same_on_any_number_of_cores_and_from_the_command(
    cases: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    result = fd.score("LLC-tuned", cases, hunt=4, jobs=1)
    command = ["score", "LLC-tuned", "--cases", cases, "--jobs", "2", "--json", str(tmp_path / "told.json")]
    assert main([*command, "--out", str(tmp_path), "--hunt", "4"]) == 0
    document = json.loads((tmp_path / "told.json").read_text())
    assert json.loads((tmp_path / "card.json").read_text()) == document
    assert document == result.content
    hunted = document["worst"]
    case_set = read_set(cases)
    (cases_hunted, again) = worst(case_set, case_set.content.controllers["LLC-tuned"], 4)
    assert again is not None
    assert hunted == {"cases": cases_hunted, **again._asdict()}
    assert hunted["ratio"] > 0.0
    said = capsys.readouterr().out
    assert "ITAE in the worst hunted case" in said
    tripped = sum(kind["tripped"] for kind in document["kinds"].values())
    assert f"taken off by a supervisor in {tripped} of {len(document['cases'])} cases" in said
    assert tripped == sum(case["tripped"] for case in document["cases"])
    assert (tmp_path / "card.png").read_bytes().startswith(b"\x89PNG")
    page = (tmp_path / "card.md").read_text()
    assert f"score {result.value:.1f}" in page
    assert result.content["set_digest"] in page


def test_devices_that_a_set_adds_are_commanded(cases: str) -> None:
    """Of every kind that two_area lacks, together; the law of each is designed on the grid with them."""
    case_set = read_set(cases)
    names = [row["name"] for row in ACTUATORS]
    run = {**case_set.content.run, "devices": names}
    fields = {**case_set.content.set, **{f"system.devices.{2 + i}": row for i, row in enumerate(ACTUATORS)}}
    case_set = case_set._replace(content=case_set.content.model_copy(update={"run": run, "set": fields}))
    case = case_of(case_set, [{"name": "LQG", "devices": [name], "signals": ["frequency"]} for name in names], 0)
    index, free = (measure(measured_case, 8.0).measure for measured_case in (case, case_of(case_set, (), 0)))
    assert index is not None
    assert free is not None
    assert index < 0.5 * free


@pytest.mark.parametrize("controller", ["LLLC", "missing.py:Damper", "two_area_free"])
def test_score_of_an_unknown_controller_is_refused_before_any_run(controller: str, cases: str) -> None:
    with pytest.raises(fd.InputError, match="allowed"):
        fd.score(controller, cases)


@pytest.mark.parametrize(
    ("command", "message"),
    [
        (
            ["examples/lead_lag.py:Nope"],
            "controllers.0.policy: no class 'Nope' in examples/lead_lag.py; allowed: LeadLag",
        ),
        (["LLC", "--against", "LLC,"], "--against: '' given; allowed: a controller, "),
        (["LLC", "--against", ""], "--against: '' given; allowed: a controller, "),
        (["--against", "LLC"], "--against: given without CONTROLLER; allowed: beside one"),
    ],
)
def test_score_refuses_before_any_run(
    command: list[str], message: str, cases: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(card, "workers", None)
    monkeypatch.chdir(DATA.parents[1])
    assert_one_line(2, ["score", *command, "--cases", cases], message, capsys)


def test_lost_synchronism_counts_as_ten_times_and_as_nothing_where_both_lose_it() -> None:
    sound, twice, lost = Measured(1.0, 0.1, None, 0, 0, False), Measured(2.0, 0.1, None, 0, 0, False), Measured(
        None, None, 5.0, 0, 0, False
    )  # fmt: skip
    log_ratios = logs([twice, lost, sound, lost], [sound, sound, lost, lost])
    np.testing.assert_allclose(log_ratios, [np.log(2.0), LOST, -LOST, 0.0])


def test_mean_is_over_kinds_and_its_interval_holds_the_truth() -> None:
    """Two kinds of unlike size count alike; of 200 draws about 95 % of the intervals hold the mean of the source."""
    random, kinds = np.random.default_rng(3), ["a"] * 30 + ["b"] * 10
    held = 0
    for _ in range(200):
        values = np.concatenate([random.normal(-0.5, 0.2, 30), random.normal(0.1, 0.2, 10)])
        interval = estimate(values, kinds)
        held += interval.low <= 100.0 * (np.exp(-0.2) - 1.0) <= interval.high
    assert 0.88 <= held / 200 <= 0.99
