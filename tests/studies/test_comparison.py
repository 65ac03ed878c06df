"""Controllers compared on a grid of the user's: cases, alignment, tuning, and what is told."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

import pytest

from facts_damping.analysis.supervision import supervision, trips
from facts_damping.case.changes import as_sets, change
from facts_damping.case.loading import changed_case, read_system
from facts_damping.cli.main import main
from facts_damping.errors import FactsDampingError
from facts_damping.parameters.files import read_table
from facts_damping.simulation import loop
from facts_damping_studies.score import comparison, tuning
from facts_damping_studies.score.cases import own_grid
from facts_damping_studies.score.cases.drawing import FAULT, STEP, TRIP, meshed_lines
from facts_damping_studies.score.cases.sets import run_of
from facts_damping_studies.score.controllers import controllers_of
from facts_damping_studies.search.space import space_of
from tests.commands import assert_one_line

if TYPE_CHECKING:
    from pathlib import Path

MINE = """
class Mine:
    search = {"gain": (1.0, 100.0), "offset": (-0.001, 0.001)}

    def __init__(self, spec):
        self.parameters = spec.parameters

    def step(self, t_s, y, age_s, fresh):
        return [self.parameters.get("gain", 10.0) * y[0] + self.parameters.get("offset", 0.0)]
"""
GAMMA = {"stage": "network", "model": "gamma", "delay": 0.05, "shape": 2.6, "scale": 0.0175}
JITTER = {"up": [GAMMA, {"stage": "network", "model": "in_order"}], "down": []}


def tell(_name: str, _what: str) -> Any:
    return lambda _done, _of: None


@pytest.fixture
def mine(tmp_path: Path) -> str:
    (tmp_path / "mine.py").write_text(MINE, encoding="utf-8")
    return f"{tmp_path / 'mine.py'}:Mine"


def new_england(**asked: Any) -> own_grid.Ground:
    usual = own_grid.OwnGrid("new_england_39", comparison.kinds_of(3), place="line_9_39", profile=comparison.PROFILE)
    return own_grid.ground(usual._replace(**asked), 1, tell)


@pytest.fixture(scope="module")
def ground() -> own_grid.Ground:
    return new_england()


def test_meshed_lines_leave_the_grid_whole_and_its_devices_in() -> None:
    """Of New England, buses 19, 20, 33 and 34 hang on line 16-19 alone; the tie of two areas holds a device."""
    system = read_system("new_england_39")
    assert {line.name for line in system.lines} - set(meshed_lines(system)) == {"line_16_19"}
    assert "line_9_39" not in meshed_lines(system, "line_9_39")
    tripped = system.model_copy(update={"lines": [line for line in system.lines if line.name != "line_1_2"]})
    assert {"line_1_39", "line_9_39", "line_8_9"}.isdisjoint(meshed_lines(tripped))  # now a radial


def test_ground_has_device_signal_and_a_case_of_each_kind(ground: own_grid.Ground) -> None:
    assert (ground.place.at, ground.wait_s) == ("line_9_39", 0.0)
    cases = ground.case_set.cases
    training = comparison.training_cases(ground, 1, tell)
    assert training[0].system.signals[ground.signal].channel == "frequency"
    assert [case.kind for case in cases] == [FAULT, TRIP, STEP]
    assert len({json.dumps(case.set) for case in cases}) == 3
    assert not {case.run.seed for case in training} & {case.set["seed"] for case in cases}
    assert new_england() == ground  # the same seed
    assert new_england(seed=2).case_set.cases != cases


def test_link_that_shifts_frames_gets_a_concentrator_and_the_supervisor_is_content(tmp_path: Path) -> None:
    link = tmp_path / "jitter.yaml"
    link.write_text(json.dumps(JITTER), encoding="utf-8")
    aligned = new_england(link=str(link))
    assert 0.05 < aligned.wait_s < 0.3
    assert aligned.tripped_by == ""
    aligned_run = run_of(aligned.case_set.content, ())
    for up in (JITTER["up"], aligned_run["link"]["up"]):
        controller = {"name": "LLC", "devices": ["damper"], "signals": [aligned.signal], "parameters": {"gain": 0.0}}
        run = {**aligned_run, "link": {"up": up, "down": []}, "controllers": [controller]}
        stopped = trips(supervision(loop.run(changed_case(run, "calm", {"duration": 60.0})), None))
        assert bool(stopped) == (up == JITTER["up"])
    link.write_text(json.dumps({"up": [{**GAMMA, "scale": 0.05}, *JITTER["up"][1:]], "down": []}), encoding="utf-8")
    late = new_england(link=str(link))
    assert late.tripped_by in ("missing", "stale")
    assert "warning: over this link the supervisor trips" in "\n".join(own_grid.ground_text(late))


def test_controllers_with_ranges_are_tuned_and_no_worse_in_training(ground: own_grid.Ground, mine: str) -> None:
    """From the lead-lag for the mode on; a class by the ranges that it states; not what has its parameters."""
    fixed = {"name": "LLC", "parameters": {"gain": 5.0}}
    controllers = {"mine": controllers_of(mine)[1], "LLC": [{"name": "LLC"}], "fixed": [fixed]}
    entrants = tuning.tuned(ground, comparison.training_cases(ground, 1, tell), controllers, 15, 1, tell)
    assert set(entrants["mine"][0]["parameters"]) == {"gain", "offset"}
    assert -0.001 <= entrants["mine"][0]["parameters"]["offset"] <= 0.001
    assert entrants["fixed"][0]["parameters"] == fixed["parameters"]
    assert float(entrants["LLC"][0]["parameters"]["gain"]) > 0.0  # the sign that damps the interarea mode
    assert controllers["LLC"] == [{"name": "LLC"}]  # what was given is as it was


@pytest.mark.parametrize(
    ("stated", "said"),
    [
        ("5", "search = 5 given; allowed: a range of each parameter"),
        ("{'gain': 5}", "search: gain: 5 given; allowed: a range of each parameter"),
        ("{'gain': (2, 1)}", "search: gain: (2, 1) given; allowed: a range of each parameter"),
    ],
)
def test_wrong_ranges_of_a_class_are_named(stated: str, said: str, tmp_path: Path) -> None:
    (tmp_path / "wrong.py").write_text(f"class Wrong:\n    search = {stated}\n    step = print\n", encoding="utf-8")
    with pytest.raises(FactsDampingError, match=r"wrong\.py:Wrong") as caught:
        space_of({"name": "Wrong", "policy": f"{tmp_path / 'wrong.py'}:Wrong"})
    assert said in str(caught.value)


def test_command_tells_place_parameters_and_trips_and_its_set_scores_again(
    tmp_path: Path, mine: str, capsys: pytest.CaptureFixture[str]
) -> None:
    asked = ["compare", mine, "--against", "LLC", "--seeds", "3", "--budget", "15", "--out", str(tmp_path)]
    assert main(asked) == 0
    text = capsys.readouterr().out
    for said in ("two_area: sssc in ", "Mine tuned: gain", "LLC tuned: gain", "tripped", "no control", "cases.yaml"):
        assert said in text
    assert "more delay" not in text  # no case has any
    card = json.loads((tmp_path / "card.json").read_text(encoding="utf-8"))
    assert list(card["kinds"]) == [FAULT, TRIP, STEP]
    tuned = read_table(tmp_path / "cases.yaml")["controllers"]["LLC"][0]["parameters"]
    assert f"gain {tuned['gain']}" in text
    assert main(["score", "LLC", "--cases", str(tmp_path / "cases.yaml"), "--json", str(tmp_path / "again.json")]) == 0
    again = json.loads((tmp_path / "again.json").read_text(encoding="utf-8"))
    assert again["set_digest"] == card["set_digest"]
    assert (
        f"{again['score']['value']:.1f}" in next(line for line in text.splitlines() if line.startswith("LLC  ")).split()
    )


@pytest.mark.parametrize(
    ("more", "said"),
    [
        (["--system", "nowhere"], "'nowhere' given"),
        (["--place", "line_0"], "--place: 'line_0' given"),
        (["--signal", "none"], "--signal: 'none' given"),
        (["--link", "string"], "'string' given"),
        (["--seeds", "2"], "2 given; allowed: 3 to 10000"),
        (["--against", "PID"], "'PID' given"),
    ],
)
def test_bad_arguments_are_one_line(more: list[str], said: str, mine: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert_one_line(2, ["compare", mine, *more], said, capsys)


def test_profile_of_measurement_leaves_the_grid_as_it_is() -> None:
    run: dict[str, Any] = {"system": "new_england_39"}
    fields = {"profile": "measured"}
    change(run, fields, as_sets(fields))
    case = changed_case(run, "run", {"scenario": [], "devices": [], "controllers": []})
    bare = read_system("new_england_39")
    assert case.system.loads == bare.loads
    assert case.measurement.filter == "p_class"
