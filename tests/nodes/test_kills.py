"""Each node killed at a random tick, in real time: devices at zero, the recording readable, nothing left behind."""

from __future__ import annotations

import os
import signal
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from facts_damping.case.loading import load_case
from facts_damping.errors import RunError
from facts_damping.nodes import forked, graph
from facts_damping.recording.reader import load
from tests.nodes.graphs import nodes_left
from tests.nodes.letting_go import assert_let_go

KILLS = int(os.environ.get("KILLS", "1"))  # of each node
SETS = ["scenario=small", "duration=3", "controllers.0.name=HBsWC", "controllers.0.scheme=indirect"]
NODES = ("plant_sim", "wan_link", "controller_0_HBsWC", "identifier_0_ANFGuMoI", "recorder")
END_S = 1.0  # so long a plant waits at the end for readers that do not answer
NEEDED = ("plant_sim", "recorder")  # without these a run ends
RANDOM = np.random.default_rng(1)
STRIKES = [(node, int(tick)) for node in NODES for tick in RANDOM.integers(60, 130, KILLS)]


def middleware_files() -> set[str]:
    return {path.name for path in Path("/dev/shm").iterdir() if path.name.startswith(("fast", "sem.fast"))}


@pytest.mark.parametrize(("node", "tick"), STRIKES)
def test_a_killed_node(
    domain: int, tmp_path: Path, started: dict[str, Any], monkeypatch: pytest.MonkeyPatch, node: str, tick: int
) -> None:
    forked.load()  # whose folder is that of the tests
    passing = tmp_path / "tmp"
    passing.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(passing))
    monkeypatch.setenv("TMPDIR", str(passing))
    shared, case = middleware_files(), load_case(None, SETS)

    def strike(done: int, _of: int) -> None:
        if done > tick and node in started:
            os.kill(started.pop(node).process.pid, signal.SIGKILL)

    if node in NEEDED:
        with pytest.raises(RunError, match=f"^{node} was killed by SIGKILL"):
            graph.run(case, "realtime", tmp_path / "out", strike, END_S)
        record = load(tmp_path / "out" / "recording")
        assert 5 < len(record.time_ns) < case.ticks
    else:
        outcome = graph.run(case, "realtime", tmp_path / "out", strike, END_S)
        assert outcome.fallen == [f"{node} was killed by SIGKILL"]
        record = load(outcome.recording)
        assert len(record.time_ns) == case.ticks
        if not node.startswith("identifier"):  # without that a controller goes on
            assert_let_go(case, record, outcome.deadline_misses)
        elif outcome.deadline_misses == 0:
            assert not record.devices["released"].any()
    assert nodes_left(tmp_path) == []
    assert list(passing.iterdir()) == []
    assert middleware_files() == shared
