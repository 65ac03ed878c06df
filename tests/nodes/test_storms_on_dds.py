"""What storms have found, once more in graphs on DDS, judged by the same rules."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING, Any

from facts_damping.case.loading import changed_case, load_case
from facts_damping.monitor_table import ARMED
from facts_damping.nodes.launching import graph, processes
from facts_damping.recording.reader import load
from facts_damping_testing.storm.rules import violations
from facts_damping_testing.storm.running import Trace
from tests.nodes.graphs import LOADED_S, quiet

if TYPE_CHECKING:
    from pathlib import Path

GONE_S = 2.0  # longest wait at the end for the readers of killed nodes
OWN = [sys.executable, "-c", "from facts_damping_testing.foreign.own_controller import main; main()"]


def assert_holds(case: Any, mode: str, folder: Path, timeout: float, look: Any = None) -> Trace:
    outcome = graph.run(case, mode, folder, quiet, timeout, look=look)
    trace = Trace(case, mode, load(outcome.recording))
    assert violations(trace) == []
    return trace


def test_replay_knows_a_link_and_a_supervisor_that_were_started_again(domain: int, tmp_path: Path) -> None:
    case = load_case(None, ["system=smib", "scenario=nominal", "frame_rate=20", "supervision=standard", "arm_at=0.2",
                            "duration=5"])  # fmt: skip
    killed = {"wan_link": 20, "supervisor_0_LLC": 35}  # tick by node

    def look(tick: int, running: dict[str, Any]) -> None:
        for name, at in list(killed.items()):
            if tick >= at and running[name].process.exitcode is None:
                running[name].process.kill()
            elif tick >= at:
                processes.start_again(running, name)
                del killed[name]

    record: Any = assert_holds(case, "realtime", tmp_path / "graph", GONE_S, look).record
    assert {change.role for change in record.changes if change.kind == "start"} == {"link", "supervisor"}


def test_supervised_node_of_the_users_own_runs(domain: int, tmp_path: Path) -> None:
    controllers = [{"name": "mine", "command": OWN}]
    fields = {"duration": 1, "supervision": "standard", "arm_at": 0.2, "controllers": controllers}
    case = changed_case({}, "test", fields)
    record: Any = assert_holds(case, "lockstep", tmp_path / "graph", LOADED_S).record
    assert len(record.issued) > 0
    assert (record.supervision["state"] == ARMED).any()
