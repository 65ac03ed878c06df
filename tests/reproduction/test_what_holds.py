"""What holds in a deployment: who is there, what is asked of them, and the command on a few draws of a few of them."""

from __future__ import annotations

import csv
import json
import shutil
from typing import TYPE_CHECKING, Any

import pytest
from facts_damping_reproduction import candidates as who
from facts_damping_reproduction import held_out, what_holds
from facts_damping_reproduction.paired import Effect
from facts_damping_reproduction.runs import shipped as shipped_study

from facts_damping.case.controllers import chosen
from facts_damping.case.loading import changed_case
from facts_damping.cli.main import main
from facts_damping.parameters.files import read_table, shipped
from facts_damping.parameters.study import Axis
from facts_damping.studies.search import scoring
from facts_damping.studies.sweeps import sweep
from facts_damping.studies.sweeps.batch import make
from tests.commands import assert_one_line

if TYPE_CHECKING:
    from pathlib import Path

    from facts_damping.parameters.study import Study

EVERYBODY = who.everybody()
HELD_OUT = [name for name in shipped("studies") if name.startswith("held_out_")]


# Who is there


def test_everybody_has_a_label_of_its_own_and_a_run() -> None:
    assert len({one.label for one in EVERYBODY}) == len(EVERYBODY)
    for one in EVERYBODY:
        case = changed_case({}, "test", {"profile": who.PROFILE, "duration": 0.1, **one.changes})
        assert [c.devices for c in case.controllers] == ([] if one.name == who.NONE else [list(one.devices)])
        assert case.run.tuning == who.PROFILE


def test_what_was_chosen_is_what_runs() -> None:
    """With its compensation, where it has one."""
    for file in chosen(who.SYSTEM, who.PROFILE):
        for row in file.controllers:
            case = changed_case(
                {}, "test", {"profile": who.PROFILE, "duration": 0.1, **who.candidate(file, row).changes}
            )
            (own,) = case.controllers
            assert own.compensation == row.compensation
            assert {name: own.parameters[name] for name in row.parameters} == row.parameters


def test_all_kinds_are_there_with_both_sets_of_devices_and_with_compensation() -> None:
    fixed = {"LLC", "LLC-tuned", "LQG", "Hinf"}
    for devices in who.SETS:
        own = [one for one in EVERYBODY if one.devices == devices and one.compensation == who.NONE]
        assert {one.name for one in own if one.family == who.FIXED} == fixed
        for family in (who.DIRECT, who.INDIRECT):
            assert len([one for one in own if one.family == family]) == 14  # the eleven, three pairs
        late = [one for one in EVERYBODY if one.devices == devices and one.compensation != who.NONE]
        assert len(late) == 29


def test_finalists_are_chosen_by_training_alone() -> None:
    found = who.finalists(EVERYBODY)
    assert len({one.label for one in found}) == len(found)
    for devices in who.SETS:
        own = [one for one in found if one.devices == devices and one.family == who.DIRECT]
        others = [one for one in EVERYBODY if one.devices == devices and one.family == who.DIRECT]
        plain = [one for one in others if one.compensation == who.NONE]
        assert min(plain, key=lambda one: one.score or 0.0) in own


def test_a_network_that_does_not_learn_has_rates_of_zero() -> None:
    network = next(one for one in EVERYBODY if one.family == who.INDIRECT)
    (own,) = changed_case({}, "test", {"profile": who.PROFILE, **who.frozen(network).changes}).controllers
    (learning,) = changed_case({}, "test", {"profile": who.PROFILE, **network.changes}).controllers
    changed = {name for name, value in own.parameters.items() if value != learning.parameters[name]}
    assert changed == {"eta", "identifier_eta"}
    assert own.parameters["eta"] == own.parameters["identifier_eta"] == 0.0


# What is asked of them


def test_training_has_no_event_or_condition_of_what_is_held_out() -> None:
    training = scoring.ensemble(who.SYSTEM, None, who.PROFILE)
    judged = sweep.plan("held_out_two_area", [])
    kinds = [{point.columns["event"] for point in one.points} for one in (training, judged)]
    assert not kinds[0] & kinds[1]
    assert not {one.study.seed for one in (training,)} & {read_table(shipped("studies")[n])["seed"] for n in HELD_OUT}
    assert held_out.AGAIN_SEED not in {read_table(shipped("studies")[name])["seed"] for name in HELD_OUT}


@pytest.mark.parametrize("name", HELD_OUT)
def test_a_shipped_study_is_of_the_profile(name: str) -> None:
    made = sweep.plan(name, [])
    case = make(made.base, made.points[0].changes)
    assert case.run.profile == who.PROFILE
    assert case.model is not None


# The command


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three of them on four draws of 6 s and three delays; again, where most was there in another order."""

    def short(name: str, *asked: Any, **more: Any) -> Study:
        made = shipped_study(name, *asked, **more)
        made.set["duration"] = 6
        if name == "held_out_delay":
            axis = made.sweep[0]
            assert isinstance(axis, Axis)
            assert axis.values
            made.sweep[0] = axis.model_copy(update={"values": axis.values[::4]})
        return made

    made = tmp_path_factory.mktemp("what_holds")
    few = [one for one in EVERYBODY if one.label in ("none", "LLC, SSSC", "ANFBsC direct, both")]
    asked = ["reproduce", "--profile", "deployment", "--draws", "4", "--jobs", "1"]
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(who, "everybody", lambda: few)
        patched.setattr(held_out, "shipped", short)
        assert main([*asked, "--out", str(made / "a")]) == 0
        shutil.copytree(made / "a" / "runs", made / "b" / "runs")
        for number, journal in enumerate(sorted((made / "b" / "runs").glob("*/rows.jsonl"))):
            head, *rows = journal.read_bytes().splitlines(keepends=True)
            journal.write_bytes(b"".join([head, *reversed(rows[number % 2 :])]))
        assert main([*asked, "--out", str(made / "b"), "--json", str(made / "told.json")]) == 0
    return made


def test_a_command_that_goes_on_gives_the_same_files(folder: Path) -> None:
    names = sorted(path.name for path in (folder / "a").iterdir() if path.is_file())
    assert {"what_holds.md", "what_holds_all.md", "what_holds.png", "effects.csv", "everybody.csv"} <= set(names)
    for name in names:
        assert (folder / "a" / name).read_bytes() == (folder / "b" / name).read_bytes(), name


def test_effects_are_those_of_the_rows(folder: Path) -> None:
    told = json.loads((folder / "told.json").read_text())
    with (folder / "a" / "effects.csv").open() as file:
        rows: list[dict[str, Any]] = list(csv.DictReader(file))
    assert len(rows) == len(told["effects"])
    own = [row for row in rows if (row["question"], row["who"], row["event"]) == ("over_none", "LLC, SSSC", "all")]
    assert len(own) == 1
    assert 0.2 < float(own[0]["ratio"]) < 1.0
    assert {row["question"] for row in rows} >= {"over_none", "learning", "supervision", "device_lost"}


def test_only_what_is_converged_and_does_no_harm_has_a_place() -> None:
    nobody = who.NOBODY._replace(label="A", name="A")
    sure = what_holds.Ranked(nobody, Effect(12, 12, 0, 0, 0.5, 0.4, 0.6), 12, 12, 0.0, 0.0)
    assert sure.place
    assert sure._replace(converged=11).place
    assert not sure._replace(converged=10).place
    assert not sure._replace(over_none=sure.over_none._replace(lost=1)).place


def test_bad_input_is_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    assert_one_line(
        2,
        ["reproduce", "4.2", "--profile", "deployment"],
        "TABLE: 4.2 given; allowed: none with --profile deployment",
        capsys,
    )
    assert main(["reproduce", "--profile", "field"]) == 2
    assert "--profile: 'field' given; allowed: thesis, deployment" in capsys.readouterr().err
