"""`--supervised`, how a tripped run ends, and what `list` tells of supervision, as a user types it."""

from __future__ import annotations

import json
from itertools import takewhile
from typing import TYPE_CHECKING

import pytest

from facts_damping.case.loading import load_case
from facts_damping.cli.main import main
from facts_damping.monitor_table import MONITORS
from facts_damping_testing.loopback.opening import opened

if TYPE_CHECKING:
    from pathlib import Path

WRONG_SIGN = "controllers.0.faults=[{kind: wrong_sign, start: 2}]"
TRIPPED = "facts-damping: the run ended, but: controller_0_LLC was tripped at 5.43 s: harm 0.186 1/s, more than 0.03\n"


def test_run_whose_controller_was_tripped_ends_with_3_and_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "result.json"
    command = ["simulate", "two_area_small", "--supervised", "--set", WRONG_SIGN, "--set", "duration=8"]
    assert main([*command, "--json", str(path)]) == 3
    out, err = capsys.readouterr()
    assert err == TRIPPED
    assert "armed at 0.50 s; tripped at 5.43 s: harm 0.186 1/s, more than 0.03\n" in out
    (history,) = json.loads(path.read_text())["supervision"]
    assert (history["controller"], history["trips"]) == ("controller_0_LLC", 1)


def test_graph_is_told_as_the_same_run_in_process(tmp_path: Path) -> None:
    command = ["two_area_small", "--supervised", "--set", WRONG_SIGN, "--set", "duration=6"]
    paths = [tmp_path / name for name in ("run.json", "simulate.json", "analyze.json")]
    with opened():
        assert main(["run", *command, "--out", str(tmp_path), "--json", str(paths[0])]) == 3
    assert main(["simulate", *command, "--json", str(paths[1])]) == 3
    again = ["--out", str(tmp_path / "again"), "--json", str(paths[2])]
    assert main(["analyze", str(tmp_path / "recording"), *again]) == 0
    recorded, computed, (read,) = (json.loads(path.read_text()) for path in paths)
    for name in ("supervision", "latency_ms"):
        assert recorded[name] == computed[name] == read[name], name
    assert recorded["supervision"][0]["trips"] == 1
    assert {"supervision.png", "monitors.png"} <= {path.name for path in (tmp_path / "again").iterdir()}


def test_sound_controller_is_armed_and_ends_with_0(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["simulate", "two_area_small", "--supervised", "--set", "duration=2"]) == 0
    out, err = capsys.readouterr()
    assert err == ""
    assert "controller_0_LLC" in out
    assert " armed at 0.50 s\n" in out


@pytest.mark.parametrize(
    ("sets", "preset", "supervision", "arm_at"),
    [
        ([], "", "standard", 0.5),
        (["arm_at=2"], "", "standard", 2.0),
        ([], "probed", "probed", None),  # it is armed after the probe, when somebody says so
        (["arm_at=15"], "probed", "probed", 15.0),
        (["supervision=probed"], "", "probed", None),
    ],
)
def test_supervised_option_sets_supervision_and_arming_time(
    sets: list[str], preset: str, supervision: str, arm_at: float | None
) -> None:
    case = load_case("two_area_small", sets, preset)
    assert (case.run.supervision, case.run.arm_at) == (supervision, arm_at)
    assert case.summary()["supervision"] == supervision
    assert load_case("two_area_small").run.supervision is None


def test_run_s_own_supervision_stays_unless_another_is_named(tmp_path: Path) -> None:
    path = tmp_path / "own.yaml"
    path.write_text("supervision: {arming: {ramp: 2}}\narm_at: 3\n")
    for preset, ramp in (("", 2.0), ("standard", 1.0)):
        case = load_case(str(path), [], preset)
        assert case.supervision is not None
        assert (case.supervision.arming.ramp, case.run.arm_at) == (ramp, 3.0)
    path.write_text("supervision: off\n")
    assert load_case(str(path), [], "").run.supervision == "standard"
    below = load_case(str(path), ["supervision.arming.ramp=4"], "").supervision
    assert below is not None
    assert below.arming.ramp == 4.0


def test_preset_that_is_not_there_is_named(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["simulate", "--supervised", "two_area_small"]) == 2
    problem = (
        "supervision: 'two_area_small' given, one of the runs, which `facts-damping simulate` takes; allowed: probed, "
    )
    assert capsys.readouterr().err.startswith(f"facts-damping: {problem}")


def test_list_names_presets_and_monitors(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["list", "supervision", "--json", "-"]) == 0
    assert [row["name"] for row in json.loads(capsys.readouterr().out)] == ["probed", "standard", "strict"]
    assert main(["list", "monitors", "--json", "-"]) == 0
    rows = json.loads(capsys.readouterr().out)
    assert [row["name"] for row in rows] == list(MONITORS)
    assert all(set(row) == {"name", *MONITORS["harm"]._fields} for row in rows)
    assert main(["list", "monitors"]) == 0
    _, _, text = capsys.readouterr().out.partition("\nharm ")
    lines = ["harm " + text.splitlines()[0], *takewhile(lambda line: line.startswith(" "), text.splitlines()[1:])]
    words = " ".join(lines).split()
    shown = ["harm", "grid", "0.03", "0", "10", "1/s", "1.5", "cycles", "trip", *MONITORS["harm"].reason.split()]
    assert sorted(words) == sorted([*shown, *MONITORS["harm"].description.split()])
    assert max(map(len, lines)) <= 120
