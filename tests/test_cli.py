"""The commands as a user types them: exit status, one line on errors, JSON alone on standard output."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from pathlib import Path


def call(*arguments: str, cwd: Path | None = None) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "facts_damping.cli", *arguments],
        capture_output=True,
        text=True,
        check=False,
        timeout=120,
        cwd=cwd,
        env=dict(os.environ),
    )


def json_of(*arguments: str) -> Any:
    done = call(*arguments, "--json", "-")
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def test_simulate_gives_the_promised_fields() -> None:
    result = json_of("simulate", "two_area_small", "--set", "link=delay_100ms")
    assert set(result["indices"]) == {"ITAE", "IAE", "ITSE", "ISE"}
    assert all(value > 0 for value in result["indices"].values())
    assert result["stable"] is True
    assert result["damped"] is True
    assert result["latency_ms"]["mean"] == pytest.approx(100.0)
    assert result["frames_lost"] == 0
    assert result["recording"] is None
    assert result["duration_s"] == 20.0
    assert result["run"]["link"] == "delay_100ms"
    assert {"smoothness", "settling_time_s", "max_injected_voltage_pu", "modes", "wall_s"} <= set(result)


def test_unstable_run_is_a_result() -> None:
    result = json_of("simulate", "two_area_large", "--set", "controllers=[]")
    assert result["stable"] is False
    assert result["damped"] is False
    assert result["indices"] is None
    assert result["duration_s"] < 20.0
    assert result["latency_ms"] is None or result["latency_ms"]["mean"] is None


def test_control_damps_what_grows_without_it() -> None:
    without = json_of("simulate", "two_area_small", "--set", "controllers=[]")
    with_control = json_of("simulate", "two_area_small")
    assert without["stable"] is True
    assert without["damped"] is False
    assert with_control["damped"] is True
    for name, value in with_control["indices"].items():
        assert value < 0.5 * without["indices"][name]


def test_simulate_writes_pictures(tmp_path: Path) -> None:
    done = call("simulate", "two_area_small", "--set", "duration=3", "--out", str(tmp_path / "out"))
    assert done.returncode == 0, done.stderr
    pictures = sorted((tmp_path / "out").glob("*.png"))
    assert {p.stem for p in pictures} >= {"speeds", "tie_power", "injected_voltage"}
    assert all(p.read_bytes().startswith(b"\x89PNG") and p.stat().st_size > 5000 for p in pictures)
    assert (tmp_path / "out" / "result.json").is_file()


def test_modes_of_two_area_are_the_thesis_s() -> None:
    result = json_of("modes", "two_area")
    buses = {bus["name"]: bus for bus in result["power_flow"]["buses"]}
    # Thesis 4.5.2, four digits on 900 MVA.
    for name, p, q in [("B1", 0.7778, 0.1021), ("B2", 0.7777, 0.1307), ("B3", 0.7989, 0.0914), ("B4", 0.7778, 0.0919)]:
        assert buses[name]["p_mw"] / 900 == pytest.approx(p, abs=2e-4)
        assert buses[name]["q_mvar"] / 900 == pytest.approx(q, abs=2e-4)
    interarea = [mode for mode in result["modes"] if 0.3 < mode["frequency_hz"] < 0.9]
    assert len(interarea) == 1
    assert 0.60 < interarea[0]["frequency_hz"] < 0.66
    assert -0.03 < interarea[0]["damping_ratio"] < 0.0
    assert max(interarea[0]["participation"], key=interarea[0]["participation"].get).split(".")[1] in ("delta", "omega")


@pytest.mark.parametrize(
    ("kind", "some"),
    [("systems", "two_area"), ("scenarios", "two_area/small"), ("controllers", "LLC"), ("links", "delay_100ms")],
)
def test_list_names_what_there_is(kind: str, some: str) -> None:
    assert some in {row["name"] for row in json_of("list", kind)}


@pytest.mark.parametrize(
    "arguments",
    [
        ["simulate", "no_such_run"],
        ["simulate", "no_such_file.yaml"],
        ["simulate", "--set", "frame_rate=fast"],
        ["simulate", "--frobnicate"],
        ["simulate", "two_area_small", "--set", "scenario.0.load=load_9"],
        ["run", "two_area_small", "--mode", "warp"],
        ["run", "two_area_small", "--set", "scenario.0.load=load_9"],
        ["run", "two_area_small", "--timeout", "-1"],
        ["modes", "no_such_system"],
        ["modes", "two_area", "--set", "machines.0.H=-1"],
        ["analyze", "no_such_recording"],
        ["simulate", "--out", "/proc/nowhere/out"],
        ["simulate", "--json", "no/such/folder/result.json"],
        ["run", "--json", "no/such/folder/result.json"],
        ["list", "unicorns"],
        ["frobnicate"],
        [],
    ],
    ids=" ".join,
)
def test_bad_input_is_exit_2_one_line_and_nothing_else(tmp_path: Path, arguments: list[str]) -> None:
    done = call(*arguments, cwd=tmp_path)
    assert done.returncode == 2
    assert done.stdout == ""
    assert done.stderr.count("\n") == 1
    assert "Traceback" not in done.stderr
    assert list(tmp_path.iterdir()) == []
