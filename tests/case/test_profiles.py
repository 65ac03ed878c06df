"""Profiles: what they set, what goes before them, and that a run which has been stored keeps what it was."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest

from facts_damping.case.changes import read_profile
from facts_damping.case.loading import load_case
from facts_damping.cli.main import main
from facts_damping.errors import InputError
from facts_damping.parameters.files import shipped
from facts_damping.parameters.yaml_text import dump
from facts_damping.simulation import loop
from facts_damping.simulation.assembly import build_control, plant_residues
from facts_damping_studies.sweeps import sweep
from facts_damping_studies.sweeps.batch import make

if TYPE_CHECKING:
    from pathlib import Path

    from facts_damping.case.model import Case

DEPLOYMENT = "profile=deployment"


def known(case: Case) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
    """The first controller's matrix of its gains."""
    return np.array(build_control(case)[0].optimal.K)


@pytest.mark.parametrize("system", ["two_area", "smib"])
@pytest.mark.parametrize("profile", shipped("profiles"))
def test_every_profile_makes_a_run_of_every_system(profile: str, system: str) -> None:
    scenario = {"two_area": "small", "smib": "nominal"}[system]
    case = load_case(None, [f"profile={profile}", f"system={system}", f"scenario={scenario}", "duration=1"])
    assert case.run.profile == profile
    assert loop.run(case).in_synchronism.all()


def test_thesis_profile_changes_nothing() -> None:
    plain, thesis = (load_case("two_area_large", sets).document() for sets in ([], ["profile=thesis"]))
    for document in (plain, thesis):
        del document["profile"], document["asked"]
    assert plain == thesis


def test_deployment_has_what_its_page_says() -> None:
    case = load_case("two_area_small", [DEPLOYMENT])
    assert (case.run.measurement, case.measurement.filter) == ("p_class", "p_class")
    assert (case.run.link, case.run.supervision, case.run.arm_at) == ("pdci", "standard", 0.5)
    assert case.run.load_noise is not None
    assert all(governor.enabled for governor in case.system.governors)
    assert [stabiliser.enabled for stabiliser in case.system.stabilisers] == [True, False, True, False]
    assert {load.P_fractions.current for load in case.system.loads} == {1.0}
    assert {(device.response_time, device.dead_time) for device in case.system.devices} == {(0.015, 0.002)}
    assert [device.model_dump()["g"] for device in case.system.devices] == [0.004, 0.01]
    assert case.controllers[0].signals == ["frequency"]


def test_system_without_governors_may_have_it() -> None:
    assert load_case(None, [DEPLOYMENT, "system=smib", "scenario=nominal"]).system.governors == []


def test_fields_set_by_the_user_override_the_profile() -> None:
    sets = [DEPLOYMENT, "link=ideal", "system.governors.0.enabled=false", "controllers.0.signals=[f13]"]
    case = load_case("two_area_small", sets)
    assert case.run.link == "ideal"
    assert [governor.enabled for governor in case.system.governors] == [False, True, True, True]
    assert case.controllers[0].signals == ["f13"]


def test_fields_of_a_run_file_override_its_profile(tmp_path: Path) -> None:
    path = tmp_path / "mine.yaml"
    path.write_text("profile: deployment\nlink: fibre\ncontrollers: [{name: LLC, signals: [f13]}]\n")
    case = load_case(str(path))
    assert (case.run.link, case.run.measurement) == ("fibre", "p_class")
    assert case.controllers[0].signals == ["f13"]
    path.write_text("profile: deployment\ncontrollers: [{name: LLC}]\n")
    assert load_case(str(path)).controllers[0].signals == ["frequency"]


@pytest.mark.parametrize("run", ["two_area_deployment", "{profile: deployment, duration: 1}"])
def test_run_of_a_study_has_its_profile(tmp_path: Path, run: str) -> None:
    path = tmp_path / "study.yaml"
    path.write_text(f"run: {run}\nsweep: [{{field: seed, values: [1, 2]}}]\n")
    plan = sweep.plan(str(path), [])
    for point in plan.points:
        case = make(plan.base, point.changes)
        assert (case.measurement.filter, case.run.tuning) == ("p_class", "deployment")
        assert case.model == case.system


def test_stored_run_stays_what_it_was(tmp_path: Path) -> None:
    case = load_case("two_area_small", [DEPLOYMENT, "system.governors.0.enabled=false", "system.loads.0.P=900"])
    path = tmp_path / "run.yaml"
    path.write_text(dump(case.document()))
    again = load_case(str(path))
    assert again.system == case.system
    assert again.model == case.model
    assert again.document() == case.document()


def test_without_supervision_nothing_is_to_be_armed() -> None:
    assert load_case("two_area_small", [DEPLOYMENT, "supervision=off"]).run.arm_at is None


# The system that controllers are designed on


@pytest.mark.parametrize("name", ["LQG", "Hinf"])
def test_design_does_not_know_what_is_changed_after_the_profile(name: str) -> None:
    sets = [DEPLOYMENT, f"controllers.0={{name: {name}, signals: [frequency]}}"]
    changed = [*sets, "system.loads.0.P=900", "system.machines.0.H=5"]
    case, other = load_case(None, sets), load_case(None, changed)
    assert case.system != other.system
    assert case.designed_on == other.designed_on == case.system
    np.testing.assert_array_equal(known(case), known(other))
    redesigned = load_case(None, [*changed, "model=null"])
    assert redesigned.designed_on == redesigned.system
    assert not np.array_equal(known(case), known(redesigned))


def test_residues_for_adaptation_are_of_the_model_not_of_the_plant() -> None:
    residues, other = (plant_residues(load_case(None, [DEPLOYMENT, f"system.machines.0.H={H}"])) for H in (6.5, 4.0))
    assert residues is not None
    assert other is not None
    assert residues.eigenvalue == other.eigenvalue


def test_model_may_be_another_file() -> None:
    case = load_case(None, ["model=two_area", "model.machines.0.H=5", "controllers.0.name=LQG"])
    assert case.designed_on.machines[0].H == 5.0
    assert case.system.machines[0].H == 6.5


# Bad input


@pytest.mark.parametrize(
    ("sets", "said"),
    [
        (["profile=field"], "profiles: 'field' given; allowed: deployment, measured, thesis"),
        (["profile=[1]"], "--set profile=[1]: [1] given; allowed: deployment, measured, thesis, or a YAML file"),
        (["model=smib"], "model: pmus G1, TIE given; allowed: those of the system, G1, G2, G3, G4, TIE"),
        ([DEPLOYMENT, "tuning=mine", "controllers.0.name=LLC-tuned"], "'LLC-tuned' given, which is not tuned"),
    ],
)
def test_bad_input_is_one_line(sets: list[str], said: str) -> None:
    with pytest.raises(InputError) as caught:
        load_case(None, sets)
    assert said in str(caught.value)
    assert "\n" not in str(caught.value)


def test_profiles_are_told(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["list", "profiles"]) == 0
    text = " ".join(capsys.readouterr().out.split())
    assert all(name in text and read_profile(name).description in text for name in shipped("profiles"))
