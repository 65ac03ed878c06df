"""Each node killed at a random tick, in real time: devices at zero, the recording readable, nothing left behind."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import tempfile
from multiprocessing import util
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from facts_damping.case.loading import load_case
from facts_damping.errors import RunError
from facts_damping.nodes.launching import forked, graph
from facts_damping.recording.reader import load
from tests.nodes.graphs import assert_let_go, nodes_left

KILLS = int(os.environ.get("KILLS", "1"))  # of each node
LINK = "controller_1_LLC/wan_link"
SETS = [
    *("scenario=small", "duration=3", "devices=[sssc, statcom]"),
    "controllers=[{name: HBsWC, scheme: indirect}, {name: LLC, signals: [speed], devices: [statcom], link: pdci}]",
]
SERVED = {"controller_0_HBsWC": 0, LINK: 1}  # devices that let go without them
END_S = 1.0  # so long a plant waits at the end for readers that do not answer
RANDOM = np.random.default_rng(1)
GOES_ON = [
    {"identifier_0_ANFGuMoI": int(a), "controller_0_HBsWC": int(b), LINK: int(c)}
    for a, b, c in zip(*(RANDOM.integers(*when, KILLS) for when in ((30, 60), (80, 120), (80, 120))), strict=True)
]
ENDS = [{node: int(tick)} for node in ("plant_sim", "recorder") for tick in RANDOM.integers(60, 130, KILLS)]


def middleware_files(domain: int) -> set[str]:
    """Shared memory of Fast DDS in a ROS domain, by the ports that it is named after (RTPS 2.5, 9.6.1.1)."""
    ports = range(7400 + 250 * domain, 7400 + 250 * (domain + 1))
    ports_found = ((path.name, re.search(r"fast\w*_port(\d+)", path.name)) for path in Path("/dev/shm").iterdir())
    return {name for name, port in ports_found if port is not None and int(port[1]) in ports}


@pytest.mark.parametrize("ticks", [*GOES_ON, *ENDS])
def test_killed_nodes(
    domain: int, tmp_path: Path, started: dict[str, Any], monkeypatch: pytest.MonkeyPatch, ticks: dict[str, int]
) -> None:
    """A run goes on without identifier, controller and link; it ends without plant or recorder."""
    forked.load()  # whose folder is that of the tests
    passing = tmp_path / "tmp"
    passing.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(passing))
    monkeypatch.setenv("TMPDIR", str(passing))
    shared, case, killed = middleware_files(domain), load_case(None, SETS), dict[str, int]()

    def kill(done: int, _of: int) -> None:
        for node in [node for node, tick in ticks.items() if done > tick and node not in killed]:
            killed[node] = done
            os.kill(started[node].process.pid, signal.SIGKILL)

    if len(ticks) == 1:
        (node,) = ticks
        with pytest.raises(RunError, match=f"^{node} was killed by SIGKILL"):
            graph.run(case, "realtime", tmp_path / "out", kill, END_S)
        record = load(tmp_path / "out" / "recording")
        assert 0 < len(record.time_ns) < case.ticks
        why = "the run was cut off" if node == "plant_sim" else "the end is missing"
        assert [note for note in record.notes if note.startswith(why)]
    else:
        outcome = graph.run(case, "realtime", tmp_path / "out", kill, END_S)
        assert sorted(outcome.fallen) == sorted(f"{node} was killed by SIGKILL" for node in ticks)
        record = load(outcome.recording)
        assert len(record.time_ns) == case.ticks
        assert_let_go(case, record, outcome.deadline_misses)
        if outcome.deadline_misses == 0:  # without its identifier a controller goes on
            for node, device in SERVED.items():
                assert not record.devices["released"][: killed[node], device].any()
    assert nodes_left(tmp_path) == []
    assert list(passing.iterdir()) == []
    assert middleware_files(domain) == shared


def test_process_that_imports_preload_keeps_the_folder_of_this_fork_server() -> None:
    forked.load()
    subprocess.run([sys.executable, "-c", "import facts_damping.nodes.launching.preload"], check=True)
    assert Path(util.get_temp_dir()).is_dir()
