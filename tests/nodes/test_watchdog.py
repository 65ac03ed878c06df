"""The device watchdog in a graph: the same bits as in process, and by the wall clock in real time."""

from __future__ import annotations

import os
import signal
import time
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from std_srvs.srv import Trigger

from facts_damping.analysis.summary import summarise
from facts_damping.case.loading import load_case
from facts_damping.nodes.launching import graph
from facts_damping.nodes.live_plant import LivePlant
from facts_damping.recording.reader import load
from facts_damping.simulation.replaying import replay
from tests.nodes.graphs import PATIENCE_S, as_in_process, ticks

if TYPE_CHECKING:
    from pathlib import Path

CUT = 'link={"up": [{"model": "bernoulli", "loss": 1.0, "start": 1.0, "duration": 0.5}]}'


def test_release_and_return_of_a_graph_are_those_of_the_in_process_run(loopback: Any, tmp_path: Path) -> None:
    sets = ["scenario=large", "duration=3", CUT, "watchdog.good=20"]
    case = load_case(None, sets)
    as_in_process(tmp_path, case)
    recorded = load(tmp_path / "recording")
    issued = replay.play(case, replay.fitted(recorded, case)).issued
    assert replay.first_difference(recorded, issued) is None
    (row,) = summarise(recorded).releases
    assert row.rearmed_s is not None


def test_plant_that_is_slow_lets_go_by_the_clock(
    loopback: Any, tmp_path: Path, started: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    advance = LivePlant.advance

    def slowly(self: LivePlant, *positional: Any) -> None:
        time.sleep(0.1 if self.tick > 90 else 0.0)
        advance(self, *positional)

    def strike(done: int, _of: int) -> None:
        if done > 90 and "wan_link" in started:
            os.kill(started.pop("wan_link").process.pid, signal.SIGSTOP)

    monkeypatch.setattr(LivePlant, "advance", slowly)
    record = load(graph.run(load_case(None, ["duration=2"]), "realtime", tmp_path, strike).recording)
    (change,) = record.changes
    assert (change.role, change.kind, change.name) == ("plant", "release", "sssc")
    (row,) = summarise(record).releases
    assert row.time_s == pytest.approx(change.tick / 60, abs=1e-6)
    assert 2 <= change.tick - record.applied["tick"].max() <= 4  # 0.2 s by the clock, not 12 ticks


def test_stopped_controller_s_device_lets_go_and_is_re_armed_by_an_operator(
    loopback: Any, start: Any, client: Any, tmp_path: Path
) -> None:
    common = {"scenario": "large", "duration": 4.0, "mode": "realtime", "recorder": "true", "start_timeout": 60.0}
    recorder = start("recorder", output=tmp_path / "bag", **common)
    start("wan_link", **common)
    controller = start("controller", **common)
    plant = start("plant_sim", **common)
    plant.wait(lambda: ticks(plant) > 90, PATIENCE_S)
    controller.send_signal(signal.SIGSTOP)
    time.sleep(1.0)
    rearmed = client(Trigger, "/plant_sim/rearm", Trigger.Request())
    assert (rearmed.success, rearmed.message) == (True, "re-armed: sssc")
    plant.communicate(timeout=PATIENCE_S)
    controller.send_signal(signal.SIGKILL)
    recorder.stop()
    record = load(tmp_path / "bag")
    first, second = summarise(record).releases  # it lets go again: nobody has come back
    assert first.rearmed_s is not None
    assert second.rearmed_s is None
    released = record.devices["released"][:, 0] == 1.0
    at_rest = (record.time_s > first.time_s + 0.6) & (record.time_s < first.rearmed_s)
    assert released[at_rest].all()
    assert np.abs(record.devices["reference"][at_rest, 0]).max(initial=0.0) == 0.0
