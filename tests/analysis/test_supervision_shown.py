"""Supervision in pictures and in the report: states, monitors beside their limits, trips, tables; else nothing."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from facts_damping.analysis import summarise
from facts_damping.analysis.plotting.pictures import PICTURES
from facts_damping.analysis.plotting.plots import plot_comparison
from facts_damping.case.loading import load_case
from facts_damping.monitor_table import STATES
from facts_damping.simulation import loop
from facts_damping_views import report
from facts_damping_views.analysis import details
from facts_damping_views.report.contents import ReportedRun
from facts_damping_views.report.sections import build

if TYPE_CHECKING:
    from pathlib import Path

    from facts_damping.record import Record
    from facts_damping_views.report.contents import Report

SUPERVISED = ["supervision=standard", "arm_at=0.5", "duration=8"]
WRONG_SIGN = "controllers.0.faults=[{kind: wrong_sign, start: 2}]"
STEMS = {"supervision", "monitors"}


@pytest.fixture(scope="module")
def tripped() -> Record:
    return loop.run(load_case("two_area_small", [*SUPERVISED, WRONG_SIGN]))


@pytest.fixture(scope="module")
def alone() -> Record:
    return loop.run(load_case("two_area_small", ["duration=8"]))


def said(**records: Record) -> Report:
    summaries = [summarise(record) for record in records.values()]
    rows = zip(records.items(), summaries, details.improvements(summaries, 0), strict=True)
    return build([ReportedRun(name, record, summary, "-", percent) for (name, record), summary, percent in rows])


def items(shown_report: Report) -> dict[str, Any]:
    return {item.key: item for section in shown_report.sections for item in section.items}


def test_report_shows_states_monitors_and_changes(tripped: Record, tmp_path: Path) -> None:
    shown_report = said(it=tripped)
    assert (5.433, "controller_0_LLC tripped by harm") in shown_report.events
    named = items(shown_report)
    (states,) = named["supervision"].panels
    assert (states.title, named["supervision"].words) == ("controller_0_LLC", STATES)
    assert set(states.curves[0].y) == {1.0, 2.0, 4.0}
    monitors = {panel.title: panel for panel in named["monitors"].panels}
    harm = monitors["controller_0_LLC harm"]
    assert (harm.levels, harm.curves[0].y.max()) == ([1.0], 3.0)
    assert all(0.3 < panel.curves[0].y.max() <= 3.0 for panel in monitors.values())
    assert "controller_0_LLC missing" not in monitors
    assert [[cell.text for cell in row] for row in named["changes"].rows] == [
        ["it", "controller_0_LLC", "0.50", "armed", "schedule"],
        ["it", "controller_0_LLC", "5.43", "tripped", "harm 0.186 1/s, more than 0.03"],
    ]
    ((*_, shadow, armed, _, _, probe),) = [[cell.text for cell in row] for row in named["supervisors"].rows]
    assert (shadow, armed, probe) == ("6.2", "61.7", "-")
    result = summarise(tripped)
    report.write(tmp_path / "report.html", [("it", tripped)], [result])
    page = (tmp_path / "report.html").read_text()
    assert "<h2>Supervision</h2>" in page
    assert "major_label_overrides" in page


def test_run_without_a_supervisor_beside_one_with(tripped: Record, alone: Record) -> None:
    named = items(said(alone=alone, it=tripped))
    assert {curve.run for panel in named["supervision"].panels for curve in panel.curves} == {1}
    assert (5.433, "it: controller_0_LLC tripped by harm") in said(alone=alone, it=tripped).events
    rows = {row[0].text: [cell.text for cell in row[1:]] for row in named["summary"].rows}
    asked = {row[0].text: [cell.text for cell in row[1:]] for row in named["conditions"].rows}
    assert (asked["supervision"], asked["arm at"]) == (["-", "standard"], ["-", "0.5"])
    assert rows["controller_0_LLC"] == ["-", "armed at 0.50 s; tripped at 5.43 s: harm 0.186 1/s, more than 0.03"]


def test_run_without_supervision_shows_nothing_of_it(alone: Record, tmp_path: Path) -> None:
    shown_report = said(alone=alone)
    assert "Supervision" not in [section.title for section in shown_report.sections]
    assert [text for _, text in shown_report.events] == ["load step load_2"]
    assert "supervision" not in [row[0].text for row in items(shown_report)["conditions"].rows]
    assert not STEMS & {path.stem for path in plot_comparison([("", alone)], tmp_path)}


def test_pictures_of_a_supervised_run(tripped: Record, tmp_path: Path) -> None:
    assert {path.stem for path in plot_comparison([("", tripped)], tmp_path)} >= STEMS
    by_stem = {picture.stem: picture for picture in PICTURES}
    (states,) = by_stem["supervision"].panels(tripped)
    assert len(states.curves[""].values) == len(tripped.time_ns)
    tripped.supervision["tick"][100:110] += 10_000  # what it did not say is a gap
    try:
        (cut,) = by_stem["supervision"].panels(tripped)
        assert np.flatnonzero(np.isnan(cut.curves[""].values)).tolist() == list(range(100, 110))
    finally:
        tripped.supervision["tick"][100:110] -= 10_000
