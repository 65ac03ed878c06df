"""Scores: a controller that does nothing is no control, bad ones rank below it; cards do not depend on cores."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import facts_damping as fd
from facts_damping.cli.main import main
from facts_damping_studies.score import entries
from facts_damping_studies.score.card import _qualified, cards_of, entries_of, log_ratio, ranking
from facts_damping_studies.score.cases.sets import case_of, read_set
from facts_damping_studies.score.entries import Entry
from facts_damping_studies.score.measure import Measured, measure
from facts_damping_studies.score.pages import ranking_table
from facts_damping_studies.score.statistics import LOST
from facts_damping_studies.score.worst import worst
from tests.commands import assert_one_line
from tests.studies.bad_laws.signals import Steady
from tests.two_devices import ACTUATORS

ROOT = Path(__file__).parents[2]
DATA = ROOT / "tests" / "data"
SOUND = Measured(1.0, 0.1, frequency_hz=0.2, lowest=0.95, highest=1.05)
LAW = """
class Law:
    sign = 1.0

    def __init__(self, spec):
        self.plant = None

    def step(self, t_s, y, age_s, fresh):
        return {law}
"""


@pytest.fixture
def cases() -> str:
    """A set with six cases."""
    return str(DATA / "case_set.yaml")


@pytest.fixture(scope="module")
def laws(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """A law that sets zero, and one that feeds the oscillation."""
    folder = tmp_path_factory.mktemp("laws")
    for name, law in {"nothing": "0.0 * y", "wrong": "-12.0 * y", "right": "12.0 * y"}.items():
        (folder / f"{name}.py").write_text(LAW.format(law=law), encoding="utf-8")
    return {name: f"{folder / name}.py:Law" for name in ("nothing", "wrong", "right")}


def test_controller_that_does_nothing_is_no_control_and_a_wrong_one_is_below(cases: str, laws: dict[str, str]) -> None:
    nothing, wrong, right = (fd.score(laws[name], cases, ["LLC"], jobs=1) for name in ("nothing", "wrong", "right"))
    assert nothing.value == pytest.approx(0.0, abs=0.1)
    assert wrong.value < right.value
    assert right.content["change"]["percent"] < -10.0 < 10.0 < wrong.content["change"]["percent"]
    assert wrong.content["does_harm"]
    assert "It cannot be said to be better than no control." in repr(wrong)
    ranked = ranking([nothing._card, wrong._card, right._card])
    assert [card.score.value for card in ranked] == sorted((card.score.value for card in ranked), reverse=True)
    assert ranked[0] is right._card
    assert right.content["group"] < nothing.content["group"] + wrong.content["group"]
    rows = [line.split()[0] for line in ranking_table(ranked) if line[0] not in " -"][1:]
    assert rows.index("no") == 2 - (nothing.value < 0.0)


def test_references_are_above_and_beside_are_the_kinds_that_the_set_names(cases: str) -> None:
    content = fd.score("LLC-tuned", cases, jobs=1).content
    assert content["score"]["low"] < content["score"]["value"] < content["score"]["high"] <= 100.0
    assert content["against"]["full state"]["percent"] > 0.0 > content["change"]["percent"]
    kind = "wrong sign behind the supervisor"
    assert content["beside"] == [kind]
    inside = [row["change"]["percent"] for name, row in content["kinds"].items() if name != kind]
    mean = np.mean(np.log1p(np.array(inside) / 100.0))
    assert content["change"]["percent"] == pytest.approx(100.0 * np.expm1(mean), abs=0.1)
    assert content["division"] == "model"
    assert content["unsupervised"]["value"] > 0.0


def test_card_is_the_same_on_any_number_of_cores_and_from_the_command(
    cases: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    result = fd.score("LLC-tuned", cases, hunt=4, jobs=1)
    command = ["score", "LLC-tuned", "--cases", cases, "--jobs", "2", "--json", str(tmp_path / "told.json")]
    assert main([*command, "--out", str(tmp_path), "--hunt", "4"]) == 0
    document = json.loads((tmp_path / "told.json").read_text())
    assert json.loads((tmp_path / "card.json").read_text()) == document
    assert without_times(document) == without_times(result.content)
    hunted = document["hunted"]
    case_set = read_set(cases)
    (cases_hunted, again) = worst(case_set, case_set.content.controllers["LLC-tuned"], 4)
    assert again is not None
    assert hunted == {"cases": cases_hunted, **again._asdict()}
    assert hunted["ratio"] > 0.0
    said = capsys.readouterr().out
    assert "ITAE in the worst of 4 hunted cases: " in said
    tripped = sum(kind["tripped"] for kind in document["kinds"].values())
    assert f"taken off by a supervisor in {tripped} of {len(document['cases'])} cases" in said
    assert tripped == sum(case["tripped"] for case in document["cases"])
    assert (tmp_path / "card.png").read_bytes().startswith(b"\x89PNG")
    page = (tmp_path / "card.md").read_text()
    assert f"score {result.value:.1f} [" in page
    assert result.content["set_digest"] in page


def test_devices_that_a_set_adds_are_commanded(cases: str) -> None:
    """Of every kind that two_area lacks, together; the law of each is designed on the grid with them."""
    case_set = read_set(cases)
    names = [row["name"] for row in ACTUATORS]
    run = {**case_set.content.run, "devices": names}
    fields = {**case_set.content.set, **{f"system.devices.{2 + i}": row for i, row in enumerate(ACTUATORS)}}
    case_set = case_set._replace(content=case_set.content.model_copy(update={"run": run, "set": fields}))
    case = case_of(case_set, [{"name": "LQG", "devices": [name], "signals": ["frequency"]} for name in names], 0)
    index, free = (measure(each, 8.0, 1)[0].measure for each in (case, case_of(case_set, (), 0)))
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
        (
            ["LLC", "--heldout", "other"],
            "--heldout: 'other' given; allowed: the text of case_set 2.0",
        ),
        (["LLC", "--place", "sssc"], "--place sssc: given without --system; allowed: with it"),
        (["--verify", "missing.json"], "missing.json"),
        (["LLC", "--against", "LLC,"], "--against: '' given; allowed: a controller, "),
        (["LLC", "--against", ""], "--against: '' given; allowed: a controller, "),
        (["--against", "LLC"], "--against: given without CONTROLLER; allowed: beside one"),
    ],
)
def test_score_refuses_before_any_run(
    command: list[str], message: str, cases: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(entries, "workers", None)
    monkeypatch.chdir(DATA.parents[1])
    assert_one_line(2, ["score", *command, "--cases", cases], message, capsys)


def test_lost_synchronism_counts_as_ten_times_and_as_nothing_where_both_lose_it() -> None:
    assert log_ratio(2.0, 1.0) == pytest.approx(np.log(2.0))
    assert log_ratio(None, 1.0) == log_ratio(1e3, 1.0) == LOST
    assert log_ratio(1.0, None) == -LOST
    assert log_ratio(None, None) == 0.0


def test_laws_that_do_not_look_at_the_swing_gain_little(cases: str) -> None:
    """An open-loop signal, saturation, action in calm only, and at the times at which events once were."""
    names = ("Steady", "Sine", "Bang", "Calm", "Briefly", "Turns")
    laws = {name: [{"name": name, "policy": f"{ROOT}/tests/studies/bad_laws/signals.py:{name}"}] for name in names}
    case_set = read_set(cases)
    cards = cards_of(case_set, entries_of(case_set, laws, names, 1, lambda *_: None))
    scores = {card.controller: card.score.value for card in cards}
    assert scores["Steady"] > 60.0
    assert max(scores[name] for name in ("Sine", "Bang", "Calm", "Briefly")) < 0.5 * scores["Steady"]
    assert abs(scores["Turns"]) == pytest.approx(scores["Steady"]) or scores["Turns"] < 0.0  # one sign in all cases


@pytest.mark.parametrize(
    ("measured", "why"),
    [
        ([SOUND] * 6, ""),
        ([SOUND, SOUND._replace(breach="mine opened a file"), *[SOUND] * 4], "mine opened a file (case 1)"),
        ([SOUND._replace(computing=1.5), *[SOUND] * 5], "it computes 1.5 times as long as time goes"),
        ([SOUND._replace(lowest=0.7), *[SOUND] * 5], "1 of 5 cases are beyond 1 Hz or 0.8 to 1.2 p.u. only with it"),
        ([*[SOUND] * 5, SOUND._replace(highest=1.3)], ""),  # of a kind beside the score
    ],
)
def test_limits_disqualify(measured: list[Measured], why: str, cases: str) -> None:
    entry = Entry("mine", [], {}, measured, measured, "open", [])
    row = _qualified(read_set(cases), entry, [SOUND] * 6)
    assert row["disqualified"].startswith(why)
    assert bool(row["disqualified"]) == bool(why)
    free = [SOUND._replace(lowest=0.7), *[SOUND] * 5]
    assert _qualified(read_set(cases), entry, free)["violations"] == [i for i in row["violations"] if i > 0]


def test_card_is_verified_from_itself_alone_and_a_changed_one_is_not(
    cases: str, laws: dict[str, str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Also with a set of the user's own, and after the class is gone."""
    law = tmp_path / "mine.py"
    law.write_text(Path(laws["right"].rpartition(":")[0]).read_text(), encoding="utf-8")
    assert main(["score", f"{law}:Law", "--against", "LLC", "--cases", cases, "--out", str(tmp_path / "out")]) == 0
    law.unlink()
    path = tmp_path / "out" / "card.json"
    capsys.readouterr()
    assert main(["score", "--verify", str(path)]) == 0
    said = capsys.readouterr().out
    assert "6 cases of case_set 2.0 measured again: all the same" in said
    content = json.loads(path.read_text())
    content["cases"][0]["measure"] *= 0.5
    path.write_text(json.dumps(content))
    assert main(["score", "--verify", str(path)]) == 1
    said, error = capsys.readouterr()
    assert "case 0, nominal: measure: " in said
    assert "the card does not hold" in error
    content["set_digest"] = "0" * 16
    path.write_text(json.dumps(content))
    assert_one_line(2, ["score", "--verify", str(path)], "set_digest: 0000000000000000 given; allowed: ", capsys)


def test_held_out_cases_are_others_and_drawn_from_the_text_alone(
    cases: str, capsys: pytest.CaptureFixture[str]
) -> None:
    first, again = (fd.score("LLC", cases, ["LLC"], heldout="test", jobs=1).content for _ in range(2))
    assert first["set"] == "case_set 2.0 held out"
    assert first == again
    assert first["set_digest"] != read_set(cases).digest


def test_class_passed_by_a_script_is_scored_as_its_file(cases: str) -> None:
    result = fd.score(Steady, cases, ["LLC"], jobs=1)
    assert result.content["division"] == "open"
    assert "class Steady" in result.content["files"]["signals.py"]


def without_times(content: dict[str, Any]) -> dict[str, Any]:
    """A card without what a machine takes."""
    cases = [{**row, "computing": 0.0} for row in content["cases"]]
    return {**content, "computing": 0.0, "cases": cases}
