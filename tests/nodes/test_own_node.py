"""A user's own node in the graph: same bits as its law in process; named if it is missing, late, silent or ends."""

from __future__ import annotations

import importlib
import json
import os
import runpy
import signal
import subprocess
import sys
import time
from contextlib import suppress
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from facts_damping.case.loading import load_case
from facts_damping.cli.main import main
from facts_damping.errors import RunError
from facts_damping.nodes.launching import graph
from facts_damping.parameters.files import read_table
from facts_damping.recording.reader import load
from facts_damping.simulation import loop
from tests.commands import assert_one_line, changes
from tests.nodes.graphs import LOADED_S, SILENCE_S, assert_same, quiet, wait_until
from tests.nodes.test_graph import EXAMPLES
from tests.nodes.test_policies import diagnostics

if TYPE_CHECKING:
    from facts_damping.record import Record

NODE = str(EXAMPLES / "lead_lag_node.py")
SETS = ["scenario=large", "link=pdci", "watchdog=off"]
BESIDE = f"import runpy, sys; sys.path.insert(0, {str(EXAMPLES)!r})"
DYING = (
    "import os; from lead_lag import LeadLag; step, left = LeadLag.step, iter(range(90, 0, -1)); "
    "LeadLag.step = lambda *given: step(*given) if next(left, 0) else (os.write(2, b'out of ideas'), os._exit(7))"
)
NAME = "controller_0_mine"


def controller_sets(*sets: str, **fields: Any) -> list[str]:
    return [*SETS, *sets, "controllers=" + json.dumps([{"name": "mine", **fields}])]


def by_command(*sets: str, more: str = "", **fields: Any) -> list[str]:
    """A run whose node is started; `more`: Python that comes before it is."""
    lines = [BESIDE, *([more] if more else []), f"runpy.run_path({NODE!r}, run_name='__main__')"]
    return controller_sets(*sets, command=[sys.executable, "-c", "; ".join(lines)], **fields)


@pytest.fixture
def by_hand(loopback: Any) -> Any:
    """The example as its user starts it."""
    return loopback.start(
        "mine", partial(runpy.run_path, NODE, run_name="__main__"), ["--ros-args", "-r", f"__node:={NAME}"]
    )


def in_process(*sets: str, **fields: Any) -> Record:
    """The same law as the shipped controller."""
    llc = "controllers=" + json.dumps([{"name": "LLC", **fields}])
    return loop.run(load_case(None, [*SETS, *sets, llc]))


def assert_same_law(recorded: Record, computed: Record) -> None:
    assert recorded.controller_names == [NAME]
    named = replace(computed, controller_names=[NAME], configuration=recorded.configuration)
    assert_same(recorded, named)


def run(folder: Path, sets: list[str], mode: str = "lockstep", timeout: float = LOADED_S) -> graph.Outcome:
    return graph.run(load_case(None, sets), mode, folder, quiet, timeout)


def test_example_is_what_the_page_says_it_is() -> None:
    assert len(Path(NODE).read_text().splitlines()) <= 54
    asked = read_table(EXAMPLES / "lead_lag_node.yaml")
    assert asked["controllers"][0]["command"][-1] == "examples/lead_lag_node.py"
    assert load_case(str(EXAMPLES / "lead_lag_node.yaml")).controllers[0].name == "my_node"


def test_started_by_the_graph_it_is_replayed_with_others(domain: int, tmp_path: Path) -> None:
    placed: dict[str, Any] = {"link": "delay_100ms", "namespace": "area_1", "parameters": {"gain": 12}}
    outcome = run(tmp_path, by_command("duration=1.5", **placed))
    assert_same_law(load(outcome.recording), in_process("duration=1.5", **placed))
    assert (tmp_path / f"{NAME}.log").read_text() == ""
    assert main(["replay", str(outcome.recording)]) == 2
    assert main(["replay", str(outcome.recording), "--set", "controllers.0.name=LLC"]) == 0
    nodes = ["--policy", "--nodes", "--out", str(tmp_path / "again"), "--timeout", str(LOADED_S)]
    assert main(["replay", str(outcome.recording), *nodes]) == 0


def test_started_by_hand_it_serves_one_run_after_the_other(by_hand: Any, tmp_path: Path) -> None:
    computed = in_process("duration=2")
    for mode in ("lockstep", "realtime"):
        outcome = run(tmp_path / mode, controller_sets("duration=2", external=True), mode)
        assert (outcome.messages_lost, outcome.deadline_misses) == (0, 0)
        assert_same_law(load(outcome.recording), computed)
    assert by_hand.is_alive()


def test_missing_it_is_named(loopback: Any, tmp_path: Path) -> None:
    with pytest.raises(RunError, match=f"missing after 30 s: .*/{NAME}/setpoints"):
        run(tmp_path, controller_sets("duration=1", external=True))


@pytest.mark.parametrize(("number", "what"), [(signal.SIGSTOP, "is silent"), (signal.SIGINT, "has left")])
def test_silent_or_gone_it_is_named_in_lockstep(
    by_hand: Any, started: dict[str, Any], tmp_path: Path, number: int, what: str
) -> None:
    def strike(done: int, _of: int) -> None:
        if done > 1:
            with suppress(ProcessLookupError):  # it is gone
                os.kill(by_hand.pid, number)

    with pytest.raises(RunError, match=f"{NAME} {what}: nothing after tick"):
        graph.run(
            load_case(None, controller_sets("duration=100", external=True)), "lockstep", tmp_path, strike, SILENCE_S
        )
    assert len(load(tmp_path / "recording").time_ns) > 1


@pytest.mark.parametrize("mode", ["lockstep", "realtime"])
def test_command_that_dies_is_named_with_what_it_said(domain: int, tmp_path: Path, mode: str) -> None:
    sets = by_command("duration=2", more=DYING)
    reason = f"{NAME} ended with exit status 7: out of ideas"
    if mode == "lockstep":
        with pytest.raises(RunError, match=reason):
            run(tmp_path, sets, mode)
    else:
        assert run(tmp_path, sets, mode).fallen == [reason]


def test_late_in_real_time_it_is_named(by_hand: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(EXAMPLES))
    law = importlib.import_module("lead_lag").LeadLag
    step = law.step

    def slowly(*positional: Any) -> float:
        time.sleep(0.025)
        return float(step(*positional))

    monkeypatch.setattr(law, "step", slowly)
    outcome = run(tmp_path, controller_sets("duration=2", external=True), "realtime")
    assert outcome.deadline_misses > 0
    texts = diagnostics(outcome.recording, "wan_link")
    assert any(f"of {NAME}" in text and "late answers" in text for text in texts), texts


def test_own_node_ends_when_its_command_is_killed(domain: int, tmp_path: Path) -> None:
    asked = [*changes(by_command("duration=1000")), "--out", str(tmp_path / "out")]
    command = [sys.executable, "-m", "facts_damping.cli.main", "run", *asked]
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as popen:
        wait_until(lambda: bool(left()))
        wait_until(lambda: any((tmp_path / "out").glob("recording/*.mcap")))
        popen.kill()
    wait_until(lambda: not left())


def left() -> list[str]:
    commands = []
    for entry in Path("/proc").iterdir():
        try:
            words = (entry / "cmdline").read_bytes().decode().split("\0")
            environment = (entry / "environ").read_bytes().decode(errors="replace").split("\0")
        except OSError:
            continue
        if any(NODE in word for word in words) and f"ROS_DOMAIN_ID={os.environ['ROS_DOMAIN_ID']}" in environment:
            commands += [entry.name] if "facts_damping.cli.main" not in words else []
    return commands


@pytest.mark.parametrize(
    ("fields", "expected"),
    [
        ({"external": True}, "controllers.0.external: a separate node given; allowed: in a graph"),
        ({"command": ["true"]}, "controllers.0.command: a separate node given; allowed: in a graph"),
        ({"external": True, "command": ["true"]}, "given with `external` and `command`; allowed: one of"),
        ({"command": []}, "command"),
        ({"external": True, "compensation": "lead"}, "compensation: 'lead' given; allowed: none for mine"),
    ],
)
def test_in_process_it_is_refused(fields: dict[str, Any], expected: str, capsys: Any) -> None:
    assert_one_line(2, ["simulate", *changes(controller_sets(**fields))], expected, capsys)


def test_command_that_is_not_there_starts_nothing(tmp_path: Path, capsys: Any) -> None:
    command = ["run", *changes(controller_sets(command=["no_such_program"])), "--out", str(tmp_path / "out")]
    text = "controllers.0.command: 'no_such_program' given; allowed: an executable program"
    assert_one_line(2, command, text, capsys)
    assert not (tmp_path / "out").exists()
