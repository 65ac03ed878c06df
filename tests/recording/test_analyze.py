"""`facts-damping analyze --spwvd` on a recording, as a user types it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from facts_damping.case.loading import load_case
from facts_damping.cli.main import main
from facts_damping.simulation import loop
from tests.commands import assert_one_line

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory, written: Callable[..., None]) -> Path:
    """Five seconds of the default run."""
    folder = tmp_path_factory.mktemp("analyzed") / "recording"
    written(loop.run(load_case(None, ["duration=5"])), folder)
    return folder


@pytest.mark.parametrize(
    ("options", "reason"),
    [
        (["--spwvd", "w12,w99"], "signal: 'w99' given; allowed: angle, angle_rate, f12, "),
        (["--spwvd", "w12", "--windows", "fast"], "argument --windows: fast given; allowed: two numbers with a comma"),
        (["--spwvd", "w12", "--windows", "0,1"], "signal w12: lag window: 0 s given; allowed: above 0 s, or inf"),
        (["--spwvd", "w12", "--band", "0.1,70"], "signal w12: band: 0.1 to 70 Hz given; allowed: rising, within 0 to"),
        (["--band", "0.1,2"], "--windows, --band: given without --spwvd; allowed: with --spwvd SIGNAL,..."),
    ],
    ids=str,
)
def test_bad_input_is_one_line_and_nothing_is_written(
    recording: Path, tmp_path: Path, options: list[str], reason: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert_one_line(2, ["analyze", str(recording), "--out", str(tmp_path / "out"), *options], reason, capsys)
    assert not (tmp_path / "out").exists()


def test_report_and_pictures_of_two_recordings(
    recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Two of the same name are told apart, a cut one is said to be cut."""
    cut = tmp_path / "cut.mcap"
    whole = next(recording.glob("*.mcap")).read_bytes()
    cut.write_bytes(whole[: len(whole) * 2 // 3])
    page = tmp_path / "report.html"
    options = ["--out", str(tmp_path / "out"), "--report", str(page), "--run", "two_area_small"]
    options += ["--spwvd", "w12", "--windows", "3,1", "--band", "0.2,2"]
    assert main(["analyze", str(recording), str(cut), *options]) == 0
    out, err = capsys.readouterr()
    assert out.splitlines()[-1] == f"report: {page}"
    for picture in (tmp_path / "out" / f"spwvd_w12_{k}.png" for k in (1, 2)):
        assert f"plot: {picture}" in out.splitlines()
        assert picture.stat().st_size > 10_000
    assert (tmp_path / "out" / "speeds.png").exists()
    text = page.read_text(encoding="utf-8")
    for note in [line.partition(": ")[2] for line in err.splitlines() if "missing" in line]:
        assert note in text
    assert "the recording ends too early" in text
    assert "1 LLC" in text
    assert "2 LLC" in text
    assert str(cut) in text


def test_same_run_without_control_may_be_the_baseline(
    recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    options = ["analyze", str(recording), "--run", "two_area_small", "--out", str(tmp_path), "--baseline"]
    assert main([*options, "no_control"]) == 0
    assert "improvement on no control [%]" in capsys.readouterr().out
    assert main([*options, "none"]) == 2
    assert f"--baseline: 'none' given; allowed: {recording}, no_control" in capsys.readouterr().err
