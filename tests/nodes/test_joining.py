"""Nodes that are started again in real time replace dead ones; they are disarmed until an operator arms them."""

from __future__ import annotations

import signal
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from std_srvs.srv import Trigger

from facts_damping.analysis.summary import summarise
from facts_damping.case.controllers import with_weights
from facts_damping.case.loading import load_case
from facts_damping.errors import InputError
from facts_damping.parameters.files import read_table
from facts_damping.parameters.security import add_key
from facts_damping.parameters.yaml_text import dump
from facts_damping.recording.reader import load
from facts_damping.simulation import adapted_weights, loop
from tests.nodes.graphs import PATIENCE_S, assert_replayed, ticks

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

RATE = 60


class Graph:
    """A graph in real time whose nodes are started one by one."""

    def __init__(self, start: Any, folder: Path, **more: Any) -> None:
        self.start, self.folder = start, folder
        self.common = {"scenario": "large", "duration": 60.0, "mode": "realtime", "recorder": "true", **more}
        self.common["start_timeout"] = PATIENCE_S
        self.recorder = start("recorder", output=folder / "bag", **self.common)
        self.nodes: dict[str, Any] = {}

    def add(self, executable: str, **more: Any) -> Any:
        self.nodes[executable] = self.start(executable, **self.common, **more)
        return self.nodes[executable]

    def run_until(self, tick: int) -> None:
        plant = self.nodes["plant_sim"]
        plant.wait(lambda: plant.poll() is not None or ticks(plant) >= tick, PATIENCE_S)

    def finish(self) -> Any:
        plant = self.nodes["plant_sim"]
        self.run_until(ticks(plant) + RATE // 2)
        plant.terminate()
        plant.finish()
        self.recorder.stop()
        return load(self.folder / "bag")


@pytest.fixture
def graph(start: Any, tmp_path: Path) -> Callable[..., Graph]:
    return lambda **more: Graph(start, tmp_path, **more)


def test_killed_controller_s_successor_acts_when_it_is_armed(graph: Any, client: Any) -> None:
    """It is admitted within 2 s, long before DDS notices that the first one was killed."""
    run = graph()
    run.add("wan_link", join="true")
    first = run.add("controller", join="true")
    run.add("plant_sim")
    run.run_until(RATE)
    assert not client(Trigger, "/controller/arm", Trigger.Request()).success  # and others know who will ask
    first.send_signal(signal.SIGKILL)
    second = run.add("controller", join="true")
    second.wait(lambda: "joined at" in second.texts()[0], PATIENCE_S)
    joined = ticks(run.nodes["plant_sim"])
    assert not client(Trigger, "/wan_link/arm", Trigger.Request()).success
    run.run_until(joined + 2 * RATE)
    armed = client(Trigger, "/controller/arm", Trigger.Request())
    assert (armed.success, armed.message) == (True, "it acts from the next tick on")
    again = client(Trigger, "/controller/arm", Trigger.Request())
    assert (again.success, again.message) == (False, "it acts already")
    second.wait(lambda: "armed at" in second.texts()[0], PATIENCE_S)
    assert client(Trigger, "/plant_sim/rearm", Trigger.Request()).success
    record = run.finish()
    summary: Any = summarise(record)
    (row,) = summary.joined
    assert row.node == "controller"
    release = summary.releases[0]  # on a loaded machine others may follow
    assert release.time_s < row.armed_s
    assert release.rearmed_s > row.armed_s
    issued = record.issued["tick"] / RATE
    assert not np.any((issued > release.time_s) & (issued < row.armed_s))
    assert np.any(issued >= row.armed_s)
    reference = record.devices["reference"][:, 0]
    at_rest = (record.time_s > release.time_s + 0.6) & (record.time_s < release.rearmed_s)
    assert np.all(reference[at_rest] == 0.0)
    assert np.any(reference[record.time_s > release.rearmed_s] != 0.0)
    assert_replayed(record)


def test_link_and_an_identifier_are_joined_too(loopback: Any, graph: Any, client: Any, tmp_path: Path) -> None:
    """Also where messages are signed: each signs as a session of its own."""
    add_key(tmp_path / "keys.yaml")
    sets = ["controllers.0.name=HBsWC", "controllers.0.scheme=indirect", f"security.keys={tmp_path / 'keys.yaml'}"]
    run = graph(set=str(sets))
    link = run.add("wan_link", join="true")
    run.add("controller", join="true")
    weights = tmp_path / "identifier.yaml"
    identifier = run.add("identifier", join="true", save=weights)
    run.add("plant_sim")
    run.run_until(RATE)
    for other_node in (link, identifier):
        other_node.stop()
    learnt = read_table(weights)["identifier"]
    successors = [run.add("identifier", join="true", save=weights, resume="true"), run.add("wan_link", join="true")]
    for successor in successors:
        successor.wait(lambda started=successor: "joined at" in started.texts()[0], PATIENCE_S)
    run.run_until(ticks(run.nodes["plant_sim"]) + RATE)
    for name in ("wan_link", "identifier"):
        assert client(Trigger, f"/{name}/arm", Trigger.Request()).success
    for successor in successors:
        successor.wait(lambda started=successor: "armed at" in started.texts()[0], PATIENCE_S)
    assert client(Trigger, "/plant_sim/rearm", Trigger.Request()).success
    record = run.finish()
    summary: Any = summarise(record)
    at = {row.node: row for row in summary.joined}
    assert set(at) == {"wan_link", "identifier"}
    applied, estimated = record.applied["tick"] / RATE, record.estimates["tick"] / RATE
    assert applied.max() > at["wan_link"].armed_s
    assert estimated.max() > at["identifier"].armed_s
    assert not np.any((applied > summary.releases[0].time_s) & (applied < at["wan_link"].armed_s))
    assert not np.any((estimated > at["identifier"].time_s) & (estimated < at["identifier"].armed_s))
    assert len(read_table(weights)["identifier"]) == len(learnt)
    assert_replayed(record)


@pytest.mark.parametrize(
    ("executable", "parameters", "expected"),
    [
        ("controller", {"join": "true"}, "controller: join: true given; allowed: with mode free, realtime"),
        ("controller", {"resume": "true"}, "controller: resume: true given; allowed: with save"),
    ],
)
def test_joining_in_lockstep_and_resuming_without_save_are_refused(
    loopback: Any, start: Any, executable: str, parameters: dict[str, str], expected: str
) -> None:
    node = start(executable, **parameters)
    assert node.communicate(timeout=PATIENCE_S) == ("", f"{expected}\n")
    assert node.returncode == 2


def test_saved_weights_are_begun_with(tmp_path: Path) -> None:
    case = load_case(None, ["controllers.0.name=HBsWC", "duration=1"])
    built = loop.build_loop(case)
    loop.finish(case, built)
    (weights,) = adapted_weights.all_adapted(case, built).values()
    file = tmp_path / "weights.yaml"
    file.write_text(dump(weights.model_dump()))
    assert with_weights(case.controllers[0], file).weights == weights
    with pytest.raises(InputError, match=r"weights of HBsWC@two_area \(indirect\) given; allowed: those of LLC"):
        with_weights(load_case(None).controllers[0], file)
