"""What comes out of a run, in words: the same lines by `print`, in a notebook, on the command line."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

import facts_damping as fd
from facts_damping.analysis import summarise
from facts_damping.analysis.measures import columns, speed_differences
from facts_damping.cli.main import main
from facts_damping.findings import names, names_of_seeds, title, without_control
from facts_damping_views.report.contents import ReportedRun
from facts_damping_views.report.sections import build

if TYPE_CHECKING:
    from pathlib import Path

PDCI = "over a link like the Pacific DC Intertie's"


@pytest.mark.parametrize(
    ("run", "fields", "said"),
    [
        ("two_area_deployment", {}, f"Two areas, fault and trip of line 3: LLC-tuned@two_area_deployment_sssc {PDCI}"),
        (
            "two_area_deployment",
            {"link.up.1.delay": "303 ms"},
            f"Two areas, fault and trip of line 3: LLC-tuned@two_area_deployment_sssc {PDCI}, changed",
        ),
        ("two_area_deployment", {"controllers": []}, "Two areas, fault and trip of line 3: no control"),
        ("two_area_small", {}, "Two areas, step of load 2: LLC over a link without delay"),
        (
            "two_area_multiple",
            {},
            "Two areas, trip and reclosing of line 2 and mechanical power step of G1: LLC over a ",
        ),
        ("two_area_small", {"scenario": []}, "Two areas: LLC over a link without delay"),
        ("smib_supervised", {}, f"Single machine, fault of line 1: LLC and LLC-tuned@smib_power {PDCI}"),
    ],
)
def test_titles_are_words(run: str, fields: dict[str, Any], said: str) -> None:
    assert title(fd.simulate(run, duration=1, **fields)).startswith(said)


def test_several_runs_are_named_by_what_tells_them_apart() -> None:
    short: dict[str, Any] = {"duration": 0.5}
    llc, other = (
        fd.simulate("two_area_small", **short),
        fd.simulate("two_area_small", controllers=[{"name": "HBsWC"}], **short),
    )
    late = fd.simulate("two_area_small", link="delay_100ms", **short)
    calm = fd.simulate("two_area_small", scenario=[], link="delay_100ms", **short)
    assert names([llc]) == [title(llc)]
    assert names([llc, other]) == ["LLC", "HBsWC@two_area"]
    ideal, slow = names([llc, late])
    assert (ideal, slow) == ("a link without delay", "a constant delay of 100 ms")
    assert names([llc, other, late]) == [f"LLC, {ideal}", f"HBsWC@two_area, {ideal}", f"LLC, {slow}"]
    assert names([late, calm]) == ["Two areas, step of load 2", "Two areas"]
    assert names([llc, llc]) == ["1 LLC", "2 LLC"]
    again = fd.simulate("two_area_small", seed=7, **short)
    assert names([llc, again]) == ["seed 0", "seed 7"]
    assert names_of_seeds([llc, again, other]) == ["LLC (2 seeds)", "LLC (2 seeds)", "HBsWC@two_area"]


def test_seeds_are_a_median_in_a_band() -> None:
    runs = [fd.simulate("two_area_deployment", duration=4, seed=seed) for seed in range(3)]
    figure = runs[0].plot("differences", beside={"seeds": runs})
    axes = figure.axes[-1]
    median_line, median = (curve for line in axes.lines if len(curve := np.asarray(line.get_ydata(), float)) == 240)
    (path,) = axes.collections[0].get_paths()
    band = np.asarray(path.vertices, float)[:, 1]
    values = np.stack([1e3 * columns(speed_differences(run))[:, -1] for run in runs])
    assert median_line == pytest.approx(values[0])
    assert median == pytest.approx(np.median(values, axis=0))
    assert (band.min(), band.max()) == pytest.approx((values.min(), values.max()))


def test_same_lines_everywhere(capsys: pytest.CaptureFixture[str]) -> None:
    result = fd.simulate("two_area_deployment")
    lines = str(result).splitlines()
    assert main(["simulate", "two_area_deployment"]) == 0
    assert capsys.readouterr().out.splitlines()[: len(lines) + 1] == [*lines, ""]
    page = result._repr_html_()
    assert all(f"<p>{line.split(':')[0]}" in page for line in lines)
    assert 'src="data:image/png;base64,iVBOR' in page
    summary, other = (
        result.indices or {},
        fd.simulate("two_area_deployment", controllers=[], supervision="off").indices or {},
    )
    part = 100 * (1 - summary["ITAE"] / other["ITAE"])
    assert lines[1].startswith("damped; damping ratio ")
    assert lines[2] == f"ITAE {summary['ITAE']:.3g}, without control {other['ITAE']:.3g}: {part:.0f} % less"
    assert lines[3:] == ["supervisor of controller_0_LLC_tuned: armed at 0.50 s"]


def test_run_without_control_has_the_same_noise_and_time() -> None:
    part = fd.simulate("two_area_deployment", duration=3)
    free = without_control(part)
    assert len(free.time_ns) == len(part.time_ns)
    assert free.frames[: 2 * 60].tobytes() == fd.simulate("two_area_deployment", controllers=[]).frames[:120].tobytes()


@pytest.mark.parametrize(
    ("fields", "said"),
    [
        ({"link": "satellite"}, "controller_0_LLC_tuned was never armed (stale 0.45 s, more than 0.4): it controlled"),
        ({"arm_at": None}, "controller_0_LLC_tuned was never armed (nobody armed it): it controlled nothing"),
        ({"arm_at": 9, "duration": 3}, "controller_0_LLC_tuned was never armed (due at 9 s): it"),
        (
            {"link.up.1.delay": 25, "supervision": "off"},
            "no setpoint of controller_0_LLC_tuned came to a device in 20 s",
        ),
        ({"link.up.1.delay": 2.5, "supervision": "off"}, "latency 2.5 s on average, more than 2"),
        (
            {"link": "ideal", "supervision": "off", "controllers": [{"name": "LLC", "parameters": {"gain": 1e3}}]},
            "sssc was at its limit ",
        ),
    ],
)
def test_findings_warn_of_an_unusual_run(fields: dict[str, Any], said: str) -> None:
    result = fd.simulate("two_area_deployment", **fields)
    assert any(line.startswith(f"warning: {said}") for line in result.findings)


def test_controller_that_was_never_armed_is_a_warning_wherever_results_are_shown(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """In Python, a command's lines and JSON, its report, the table of runs, and the tables of a sweep."""
    said, json_path = "was never armed (nobody armed it): it controlled nothing", tmp_path / "told.json"
    record = fd.simulate("two_area_deployment", arm_at=None, duration=3)
    assert said in str(record)
    assert said in record.summary["warnings"][0]
    sets = ["--set", "arm_at=null", "--set", "duration=3"]
    assert main(["simulate", "two_area_deployment", *sets, "--json", str(json_path)]) == 0
    shown = capsys.readouterr().out
    assert said in shown
    assert "never armed, shadow to the end" in shown
    assert said in json.loads(json_path.read_text())["warnings"][0]
    report = build([ReportedRun("it", record, summarise(record))])
    assert any(said in remark for remark in report.remarks)
    study = tmp_path / "study.yaml"
    study.write_text(
        "run: two_area_deployment\nset: {arm_at: null, duration: 3}\nsweep: [{field: link, values: [ideal, fibre]}]\n"
    )
    assert main(["sweep", str(study), "--jobs", "1", "--out", str(tmp_path / "out"), "--json", str(json_path)]) == 0
    assert "2 of 2 controlled runs have a controller that was never armed" in capsys.readouterr().out
    assert all(said in row["warnings"] for row in json.loads(json_path.read_text())["rows"])


def test_findings_tell_a_missing_run_and_a_loss_of_synchronism() -> None:
    result = fd.simulate("two_area_small", duration=8)
    assert title(replace(result, configuration={})) == "a recording without its run"
    lost = fd.simulate("two_area_large", controllers=[])
    assert lost.findings[1] == "lost synchronism: loss of synchronism"


def test_without_an_event_the_noise_is_compared_with_no_control() -> None:
    noise_run = fd.simulate("two_area_deployment", scenario=[], duration=120, supervision=None, arm_at=None, seed=3)
    assert noise_run.summary["verdict_of"] == "ambient noise"
    words = r"rms of the speed differences in noise \S+, without control \S+: variance \d+ % less"
    assert re.search(rf"^{words} \(90 % interval: \d+ % less to \d+ % less\)$", str(noise_run), re.MULTILINE)
    short = fd.simulate("two_area_deployment", scenario=[], duration=30, supervision=None, arm_at=None, seed=3)
    assert re.search(rf"^{words} \(no interval: run shorter than a minute\)$", str(short), re.MULTILINE)


@pytest.mark.parametrize("ticks", [1, 2, 3])
def test_run_of_a_few_ticks_has_findings(ticks: int) -> None:
    """In one tick nothing has happened, with and without control."""
    result = fd.simulate("two_area_small", duration=ticks / 60)
    assert len(result.time_ns) == ticks
    assert result.findings[2].startswith("ITAE ")
    assert (result.findings[2] == "ITAE 0, without control 0") == (ticks == 1)
