"""`facts-damping locate` on recordings, as a user types it: the ranking, the picture, and what is refused."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from facts_damping.case.loading import load_case
from facts_damping.cli.main import main
from facts_damping.signals import CHANNELS
from facts_damping.simulation import loop
from facts_damping_views.analysis.locating import locate
from tests.commands import assert_one_line

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from facts_damping.record import Record

FORCED = "{time: 2, kind: forced_oscillation, exciter: G2, frequency: 0.8, amplitude: 0.02}"


@pytest.fixture(scope="module")
def record() -> Record:
    """two_area_deployment with its noise of loads, the exciter of G2 forced."""
    sets = ["controllers=[]", "devices=[]", f"scenario=[{FORCED}]", "duration=32", "frame_rate=30", "measurement=ideal"]
    return loop.run(load_case("two_area_deployment", sets))


@pytest.fixture(scope="module")
def recording(record: Record, tmp_path_factory: pytest.TempPathFactory, written: Callable[..., None]) -> Path:
    folder = tmp_path_factory.mktemp("located") / "recording"
    written(record, folder)
    return folder


def test_source_is_named_and_drawn(recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    figures = tmp_path / "where.json"
    assert main(["locate", str(recording), "--out", str(tmp_path), "--json", str(figures)]) == 0
    out = capsys.readouterr().out
    assert out.startswith("the source of 0.80")
    assert "Hz is G2 at B2 in area_1: first in" in out
    assert (tmp_path / "energy_flow.png").stat().st_size > 10_000
    where: dict[str, Any] = json.loads(figures.read_text())
    assert where["frequency"] == pytest.approx(0.8, abs=0.01)
    assert where["places"][0]["cell"]["units"] == ["G2"]
    assert where["pmus"] == ["G1", "G2", "G3", "G4", "TIE"]


def test_source_without_a_pmu_is_named_by_its_area(
    record: Record, tmp_path: Path, written: Callable[..., None], capsys: pytest.CaptureFixture[str]
) -> None:
    """Neither G2 nor the tie is measured: the grid's data tell."""
    status = record.status.copy()
    status[:, [1, 4]] = 32768  # data error
    written(replace(record, status=status), tmp_path / "recording")
    assert main(["locate", str(tmp_path / "recording")]) == 0
    assert "Hz is G2 at B2 in area_1: first in" in capsys.readouterr().out


def test_source_is_named_where_another_unit_gives_more_energy() -> None:
    """G2 has no stabiliser: it feeds the interarea mode, whatever forces it. With a line out there is another mode."""
    forced = "{time: 1, kind: forced_oscillation, exciter: G3, frequency: 0.67, amplitude: 0.01}"
    sets = ["controllers=[]", "devices=[]", "duration=41", "frame_rate=30"]
    case = load_case("two_area_deployment", [*sets, f"scenario=[{forced}]"])
    where = locate(loop.run(case), case.system)
    assert where.places[0].cell.units == ["G2"]
    assert where.causes[0].units == ["G3"]
    assert where.causes[0].explained > 0.9
    trip = "{time: 0.5, kind: line_out, line: line_1}"
    case = load_case("two_area_deployment", [*sets, f"scenario=[{trip}, {forced}]"])
    where = locate(loop.run(case), case.system, frequency=0.67, since=10.0)
    assert where.causes[0].units == ["G3"]
    assert where.causes[0].explained > 0.9


@pytest.mark.parametrize(
    ("options", "reason"),
    [
        (["--frequency", "13"], "--frequency: 13 given; allowed: above 0, below 12 Hz, 0.4 of the frame rate"),
        (["--since", "28"], "s given; allowed: at least"),
        (["--since", "40"], "no frames from 40 to 31.9667 s given"),
    ],
    ids=str,
)
def test_bad_input_is_one_line(
    recording: Path, options: list[str], reason: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert_one_line(2, ["locate", str(recording), *options], reason, capsys)


def test_recording_without_currents_is_refused(
    record: Record, tmp_path: Path, written: Callable[..., None], capsys: pytest.CaptureFixture[str]
) -> None:
    frames = record.frames.copy()
    frames[:, :, list(CHANNELS).index("current_magnitude")] = np.nan
    written(replace(record, frames=frames), tmp_path / "recording")
    assert_one_line(2, ["locate", str(tmp_path / "recording")], "no currents given; allowed: a recording of", capsys)


def test_recording_that_grows_is_located_until_it_has_ended(
    recording: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """At first a tenth of it is there, too little; then three quarters; then all, and what marks its end."""
    whole = (recording / "recording_0.mcap").read_bytes()
    folder = tmp_path / "recording"
    folder.mkdir()

    shares = iter((0.1, 0.75, 1.0))

    def grow(_seconds: float = 0.0) -> None:
        share = next(shares)
        (folder / "recording_0.mcap").write_bytes(whole[: int(share * len(whole))])
        if share == 1.0:
            shutil.copy(recording / "metadata.yaml", folder)

    grow()
    monkeypatch.setattr("facts_damping_views.recording_commands.time.sleep", grow)
    assert main(["locate", str(folder), "--every", "5", "--out", str(tmp_path)]) == 0
    out, err = capsys.readouterr()
    assert err.count("not yet: ") == 1
    verdicts = [line for line in out.splitlines() if "Hz is G2 at B2 in area_1: first in" in line]
    assert len(verdicts) == 2
    ends = [float(line.split()[2]) for line in out.splitlines() if " s; energy relative" in line]
    assert 20.0 < ends[0] < 26.0
    assert ends[1] > 31.0
    assert out.count("energy_flow.png") == 1, "only at the end"
