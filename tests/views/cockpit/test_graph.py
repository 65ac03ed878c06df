"""A cockpit beside a real graph: what a page asks for is in the recording, and lockstep keeps its bits."""

from __future__ import annotations

import json
import struct
import threading
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from websockets.exceptions import ConnectionClosed

from facts_damping.case.loading import load_case
from facts_damping.nodes.launching import graph
from facts_damping.nodes.launching.starting import Cockpit, Parts
from facts_damping.recording.reader import load
from facts_damping.simulation import loop
from tests.nodes.graphs import LOADED_S, PATIENCE_S, assert_same, nodes_left, quiet
from tests.views.cockpit.serving import page_socket

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

NODE = "controller_0_LLC_tuned"
DELAY, CUT = "link/wan_link/delay", "link/wan_link/cut"


class Page:
    """A client of a cockpit that goes through steps: each is sent when its condition holds."""

    def __init__(self, steps: list[tuple[str, Any, Callable[[Page], bool]]]) -> None:
        self.steps, self.frames, self.events = steps, list[tuple[float, ...]](), list[str]()
        self.answers, self.status, self.layout = dict[int, Any](), dict[str, Any](), dict[str, Any]()
        self.thread = threading.Thread(target=lambda: None)

    def open(self, address: str) -> None:
        self.thread = threading.Thread(target=self.listen, args=(page_socket(address),), daemon=True)
        self.thread.start()

    def listen(self, connection: Any) -> None:
        number = 0
        with connection:
            try:
                for data in connection:
                    self.take(data)
                    if number < len(self.steps) and len(self.answers) == number and self.steps[number][2](self):
                        control, value, _ = self.steps[number]
                        connection.send(json.dumps({"id": number, "control": control, "value": value}))
                        number += 1
            except ConnectionClosed:
                pass

    def take(self, data: str | bytes) -> None:
        if isinstance(data, bytes):
            self.frames.append(struct.unpack(f"<{len(data) // 4}f", data))
            return
        message = json.loads(data)
        if message["type"] == "answer":
            self.answers[message["id"]] = message
        elif message["type"] == "event":
            self.events.append(message["text"])
        else:
            setattr(self, message["type"], message)

    @property
    def time_s(self) -> float:
        return self.frames[-1][0] if self.frames else 0.0


def test_requests_of_the_cockpit_page_are_in_the_recording(domain: int, tmp_path: Path) -> None:
    """Delay, cut, mend, kill and restart; the values on the page are those recorded."""
    page = Page(
        [
            (DELAY, 400, lambda page: page.time_s > 0.7),
            (CUT, True, lambda page: page.time_s > 1.2),
            (CUT, False, lambda page: page.time_s > 1.7),
            (f"nodes/{NODE}/kill", None, lambda _: True),
            (f"nodes/{NODE}/restart", None, lambda page: page.status["nodes"].get(NODE) == "dead"),
            (f"nodes/{NODE}/arm", None, lambda page: any("start disarmed" in text for text in page.events)),
            ("run/pause", None, lambda _: True),
            ("run/resume", None, lambda page: page.status["run"] == "paused"),
        ]
    )
    case = load_case("two_area_deployment", ["duration=300", "scenario=[]"])

    def done(_done: int, _of: int) -> None:
        if len(page.answers) == len(page.steps) and page.status["run"] == "running":
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        graph.run(case, "realtime", tmp_path, done, LOADED_S, parts=Parts(cockpit=Cockpit("127.0.0.1", 0, page.open)))
    page.thread.join(PATIENCE_S)
    record = load(tmp_path / "recording")
    assert {number: answer["success"] for number, answer in page.answers.items()} == dict.fromkeys(range(8), True)
    links = [change.value for change in record.changes if change.kind == "link"]
    assert [stage["model"] for stage in links[0]["up"]][-1] == "constant"
    assert [link["up"][-1].get("delay") for link in links] == [0.4, None, 0.4]
    assert links[1]["up"][-1]["loss"] == links[1]["down"][-1]["loss"] == 1.0
    assert [joined.node for joined in record.joined] == [NODE]
    assert record.joined[0].armed_s is not None
    assert [change.kind for change in record.changes if change.role == "plant"] == ["pause", "resume"]
    assert len(page.frames) > 50
    times = np.array([frame[0] for frame in page.frames])
    rows = np.searchsorted(record.time_s, times - 1e-4)
    power = page.layout["panels"][0]["diagram"]["machines"][0]["power"]
    shown = np.array([frame[2 + power] for frame in page.frames])
    np.testing.assert_array_equal(shown, (100.0 * record.machines["electrical_power"][rows, 0]).astype(np.float32))
    assert nodes_left(tmp_path) == []


def test_lockstep_with_a_cockpit_keeps_its_bits(domain: int, tmp_path: Path) -> None:
    case = load_case("two_area_deployment", ["duration=3"])
    page = Page([])
    outcome = graph.run(
        case, "lockstep", tmp_path, quiet, LOADED_S, parts=Parts(cockpit=Cockpit("127.0.0.1", 0, page.open))
    )
    page.thread.join(PATIENCE_S)
    assert_same(load(outcome.recording), loop.run(case))
    assert page.frames
    assert not any("kill" in control["id"] for control in page.layout["controls"])
