"""A graph without end, as `cockpit` starts it: longer than its duration, and a recording like any other."""

from __future__ import annotations

from argparse import Namespace
from typing import TYPE_CHECKING

import pytest

from facts_damping.case.loading import load_case
from facts_damping.nodes.launching import graph
from facts_damping.nodes.launching.starting import Parts
from facts_damping.recording.reader import load
from facts_damping.simulation.replaying import replay
from facts_damping_views.commands import live_case

if TYPE_CHECKING:
    from pathlib import Path


@pytest.mark.usefixtures("loopback")
def test_run_without_end_goes_on_after_its_duration_and_is_replayed_to_the_bit(tmp_path: Path) -> None:
    case = load_case("two_area_deployment", ["duration=0.5"], "")

    def done(tick: int, _of: int) -> None:
        if tick > 2 * case.ticks:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        graph.run(case, "lockstep", tmp_path, done, parts=Parts(endless=True))
    record = load(tmp_path / "recording")
    assert len(record.ticks) > 2 * case.ticks
    assert (record.notes, record.configuration["duration"]) == ([], None)
    again = replay.case_of(record, "recording", None, [])
    part = replay.fitted(record, again)
    assert replay.first_difference(part, replay.play(again, part).issued) is None


@pytest.mark.parametrize(
    ("sets", "duration", "endless"), [(["seed=2"], 600.0, True), (["seed=2", "duration=5"], 5.0, False)]
)
def test_cockpit_has_no_end_unless_a_duration_is_set(sets: list[str], duration: float, endless: bool) -> None:
    case, without_end = live_case(Namespace(what="two_area_deployment", set=sets, supervised=None))
    assert (case.duration, without_end) == (duration, endless)
