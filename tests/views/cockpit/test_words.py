"""The log of the cockpit's page: changes in plain words, and a line for what a drawn slider comes to."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import pytest

from facts_damping.case.loading import load_case
from facts_damping.record import GridEvent, RunChange
from facts_damping.signals import NANOSECONDS
from facts_damping.simulation import loop
from facts_damping.simulation.changes import rerun
from facts_damping_views.cockpit import application, words
from facts_damping_views.cockpit.controls import controls

if TYPE_CHECKING:
    from facts_damping.case.model import Case

LINK, DELAY = "wan_link", "link/wan_link/delay"


@pytest.fixture(scope="module")
def case() -> Case:
    return load_case("two_area_supervised", ["duration=0.5", "link=pdci", "load_noise=null"])


def link_change(case: Case, tick: int, **values: Any) -> RunChange:
    """The change that the page's controls of a link make; `values` by control, of a channel after `_of_`."""
    stands = {}
    for name, value in values.items():
        control, _, channel = name.partition("_of_")
        stands[f"link/{LINK}/{control}", channel or ("" if control == "cut" else "all")] = value
    request = controls(case)[DELAY].request(None, stands)
    return RunChange(tick, f"/{LINK}", "link", 0, "link", "", json.loads(request.content))


@pytest.mark.parametrize(
    ("values", "text"),
    [
        ({}, "link as in the run again"),
        ({"delay": 250.0}, "added delay 250 ms"),
        ({"delay": 100.0, "jitter": 50.0, "loss": 2.0}, "added delay 100 ms, added jitter 50 ms, loss 2 %"),
        ({"jitter": 50.0}, "added jitter 50 ms"),
        ({"delay_of_sssc": 20.0, "delay_of_G1": 5.0}, "added delay 5 ms (G1), added delay 20 ms (sssc)"),
        ({"cut": True}, "cut"),
        ({"cut": True, "loss": 100.0}, "cut"),
        ({"cut": True, "delay": 30.0}, "cut, added delay 30 ms"),
        ({"loss": 100.0}, "loss 100 %"),
    ],
)
def test_change_of_a_link_is_told_by_its_difference_to_the_run(case: Case, values: dict[str, Any], text: str) -> None:
    assert words.change(case, link_change(case, 60, **values)) == f"{LINK}: {text}"


@pytest.mark.parametrize(
    ("role", "kind", "name", "value", "text"),
    [
        ("plant", "event", "", "{kind: fault, bus: B7}", None),
        ("plant", "rearm", "", None, None),
        ("plant", "parameter", "noise.angle", 0.001, "noise.angle is 0.001 rad now"),
        ("link", "parameter", "up.1.delay", 0.05, "up.1.delay is 0.05 s now"),
        ("link", "parameter", "up.99.delay", 0.05, "up.99.delay is 0.05 now"),
        ("link", "link", "", {"up": [{"delay": 0.1}]}, "another link: up constant delay 0.1; down no delay"),
        ("link", "link", "", {"up": [{"model": "x"}]}, "another link: {'up': [{'model': 'x'}]}"),
        ("controller", "parameter", "gain", 30.0, "gain is 30 p.u./p.u. now"),
        ("supervisor", "reset", "", None, "reset"),
    ],
)
def test_changes_are_told_with_unit_and_only_once(
    case: Case, role: str, kind: str, name: str, value: Any, text: str | None
) -> None:
    line = words.change(case, RunChange(60, "/node", role, 0, kind, name, value))
    assert line == (None if text is None else f"node: {text}")


def test_drawn_slider_leaves_its_last_value(case: Case) -> None:
    """25 values in a second, a cut in between, and one value later; live and in a recording."""
    drawn = [link_change(case, 60 + 3 * i, delay=10.0 * (i + 1)) for i in range(25)]
    drawn += [link_change(case, 140, delay=250.0, cut=True), link_change(case, 150, delay=250.0)]
    drawn += [link_change(case, 290, delay=300.0)]
    wanted = ["added delay 250 ms", "cut, added delay 250 ms", "added delay 250 ms", "added delay 300 ms"]
    shown = application.Cockpit(application.Content({}))
    story = words.Story(case)
    for change in drawn:
        for event in story.on_change(change):
            shown.event(event)
    assert [event["text"] for event in shown._events] == [f"{LINK}: {text}" for text in wanted]
    record = loop.run(case)
    log = words.of_record(case, replace(record, changes=drawn, supervision=record.supervision[:0]))
    assert [row["text"] for row in log if LINK in row["text"]] == [f"{LINK}: {text}" for text in wanted]


def test_release_and_what_it_needs_are_told_and_end() -> None:
    case = load_case("two_area_deployment", ["duration=4", "load_noise=null"])
    again = RunChange(200, "/plant_sim", "plant", 0, "rearm", "", None)
    record = rerun(case, [link_change(case, 60, cut=True), link_change(case, 150), again])
    log = words.of_record(case, record)
    released, back = (row for row in log if row["text"].startswith("sssc"))
    assert words.REARM in released["text"]
    assert (released["level"], released["released"], back["released"]) == ("warn", ["sssc"], [])
    assert back["t"] == pytest.approx(200 / 60, abs=0.02)
    assert controls(case)["grid/rearm"].shown["label"] == words.REARM


def test_run_that_is_not_well_says_why() -> None:
    """Separation, death of a node, a released device and a trip: as events, and beside the state while they last."""
    case = load_case("two_area_deployment", ["load_noise=null"])
    story = words.Story(case)
    assert story.wrong() == []
    for line in ("line_3", "line_4"):
        events = story.on_event(GridEvent(NANOSECONDS, "line_out", line))
    assert events[-1]["text"].startswith("the grid has split: B1, B2, ")
    events += story.on_nodes(1.0, ["wan_link"]) + story.on_devices(1.0, ["sssc"])
    events += story.on_supervision(1.0, "controller", "tripped", "device")
    events += story.on_frequencies(1.0, {"B1": 62.04, "B4": 58.0, "B5": float("nan")})
    events += story.on_forced(1.0, "0.63 Hz, 12 mHz; damping control does not remove it")
    assert [event["level"] for event in events[1:]] == ["error", "error", "warn", "error", "error", "warn"]
    split = ["the grid has split", "58.0 Hz at B4, 62.0 Hz at B1"]
    assert story.wrong() == [*split, "forced oscillation", "wan_link dead", "sssc released", "controller tripped"]
    assert story.on_nodes(2.0, [])[0]["text"] == "wan_link is alive again"
    assert story.on_frequencies(2.0, {"B1": 60.0}) == []
    assert story.on_forced(2.0, "") == []
    story.on_devices(2.0, [])
    story.on_supervision(2.0, "controller", "shadow", "operator")
    story.on_change(RunChange(120, "/plant_sim", "plant", 0, "reset", "", None))
    assert story.wrong() == []
