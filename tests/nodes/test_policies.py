"""Classes of a user's own in real graphs: replayed when asked to, named when they fail or are slow."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

import pytest
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.serialization import deserialize_message

from facts_damping.case.loading import load_case
from facts_damping.cli.main import main
from facts_damping.errors import InputError, RunError
from facts_damping.nodes.launching import graph
from facts_damping.recording.reader import load
from facts_damping.simulation import loop
from facts_damping_testing.loopback.opening import opened
from tests.commands import assert_one_line, changes
from tests.lead_lag_fmu import build
from tests.nodes.graphs import LOADED_S, as_in_process, payloads, quiet
from tests.nodes.test_graph import EXAMPLES, LEAD_LAG

if TYPE_CHECKING:
    from pathlib import Path


def policy_sets(policy: str, *sets: str) -> list[str]:
    return ["scenario=large", *sets, "controllers=" + json.dumps([{"name": "mine", "policy": policy}])]


def written(folder: Path, step: str) -> str:
    head = "import time\n\nclass Mine:\n    def __init__(self, spec): pass\n"
    text = f"{head}    def step(self, t_s, y, age_s, fresh): {step}\n"
    (folder / "mine.py").write_text(text)
    return f"{folder / 'mine.py'}:Mine"


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    case = load_case(None, policy_sets(LEAD_LAG, "duration=2", "link=pdci"))
    with opened():
        outcome = graph.run(case, "lockstep", tmp_path_factory.mktemp("graph"), quiet, LOADED_S)
    assert outcome.step_times["controller_0_mine"].steps > 100
    return outcome.recording


def test_recording_runs_its_code_when_asked_to_alone(recording: Path, capsys: Any) -> None:
    text = f"controllers.0.policy: '{LEAD_LAG}' given by the recording; allowed: --policy"
    assert_one_line(2, ["replay", str(recording)], text, capsys)
    for more in (["--policy"], ["--set", "controllers.0.name=LLC"], ["--set", f"controllers.0.policy={LEAD_LAG}"]):
        assert main(["replay", str(recording), *more]) == 0
        assert "identical, bit for bit" in capsys.readouterr().out


def test_commands_that_read_a_recording_run_no_user_code(
    recording: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: object) -> None:
        raise AssertionError

    monkeypatch.setattr("facts_damping.simulation.programs.user_code.find", refuse)
    report = ["--out", str(tmp_path / "analysis"), "--report", str(tmp_path / "report.html")]
    assert main(["analyze", str(recording), *report]) == 0
    assert main(["views", str(recording), "--out", str(tmp_path / "views")]) == 0
    assert main(["export", str(recording), "--out", str(tmp_path / "signals.csv")]) == 0
    assert "mine" in (tmp_path / "report.html").read_text()


def test_class_that_fails_is_named_and_its_recording_is_readable(loopback: Any, tmp_path: Path) -> None:
    case = load_case(None, policy_sets(written(tmp_path, "return 0.001 if t_s < 1 else 1 / 0"), "duration=3"))
    text = r"controller_0_mine: controllers.0.policy: mine.py:5: ZeroDivisionError: .*, in step of mine at 1 s"
    with pytest.raises(RunError, match=text):
        graph.run(case, "lockstep", tmp_path / "out", quiet, LOADED_S)
    recorded = load(tmp_path / "out" / "recording")
    assert len(recorded.time_ns) >= 60
    before = loop.run(load_case(None, policy_sets(written(tmp_path, "return 0.001"), "duration=1")))
    for name in ("frames", "machines", "devices"):
        assert getattr(recorded, name)[:60].tobytes() == getattr(before, name)[:60].tobytes()


def test_missing_policy_file_is_refused_before_a_graph_starts(tmp_path: Path, capsys: Any) -> None:
    command = ["run", *changes(policy_sets("nowhere.py:Mine")), "--out", str(tmp_path / "out")]
    assert_one_line(2, command, "controllers.0.policy: nowhere.py: no such file", capsys)
    assert not (tmp_path / "out").exists()


def test_node_refuses_it_too(loopback: Any, tmp_path: Path) -> None:
    case = load_case(None, policy_sets("nowhere.py:Mine", "duration=1"))
    with pytest.raises((RunError, InputError), match=r"nowhere\.py: no such file"):
        graph.run(case, "lockstep", tmp_path / "out", quiet, LOADED_S)


def test_in_real_time_steps_longer_than_a_frame_are_counted(loopback: Any, tmp_path: Path) -> None:
    slow = written(tmp_path, "time.sleep(0.05 if 1.0 < t_s < 1.3 else 0); return 0.0")
    case = load_case(None, policy_sets(slow, "duration=3"))
    outcome = graph.run(case, "realtime", tmp_path / "out", quiet, LOADED_S)
    times = outcome.step_times["controller_0_mine"]
    assert 0.05 <= times.max_s < 0.06
    assert times.steps > 100
    texts = diagnostics(outcome.recording, "controller")
    assert any("steps of mine took longer than a frame" in text for text in texts), texts


def diagnostics(recording: Path, of: str) -> list[str]:
    """Texts of a node's diagnostics in a recording."""
    data = payloads(recording.parent, name=recording.name)["/diagnostics"]
    rows = [status for message in data for status in deserialize_message(message, DiagnosticArray).status]
    return [status.message for status in rows if of in status.name]


def test_fmu_in_a_graph_is_the_one_in_process_bit_for_bit(
    domain: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "passing").mkdir()
    monkeypatch.setenv("TMPDIR", str(tmp_path / "passing"))
    fmu = build(tmp_path, EXAMPLES, 3)
    controllers = json.dumps([{"name": "mine", "fmu": str(fmu)}])
    sets = ["scenario=large", "duration=1.5", "link=pdci", f"controllers={controllers}"]
    as_in_process(tmp_path / "out", load_case(None, sets))
    assert not list((tmp_path / "passing").glob("facts_damping_fmu_*"))


def test_lockstep_waits_for_a_step_that_is_slow(loopback: Any, tmp_path: Path) -> None:
    slow = written(tmp_path, "time.sleep(0.05 if t_s == 0.5 else 0); return 0.0")
    as_in_process(tmp_path / "out", load_case(None, policy_sets(slow, "duration=1")))
