"""The graph: its recording equals the in-process run, and it fails by name.

Kinds of runs are compared on the loopback; a few graphs on DDS show that it gives the same.
"""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from facts_damping.case.loading import load_case
from facts_damping.cli.main import main
from facts_damping.errors import RunError
from facts_damping.nodes.launching import graph
from facts_damping.recording.reader import load
from facts_damping.simulation import loop
from facts_damping_testing.loopback.opening import opened
from tests.nodes.graphs import (
    PATIENCE_S,
    as_in_process,
    assert_kept_apart,
    assert_named,
    assert_same,
    nodes_left,
    payloads,
    quiet,
    recorded_bytes,
    wait_until,
    wait_until_recording,
)
from tests.two_plants import path

if TYPE_CHECKING:
    from collections.abc import Iterator


@pytest.mark.parametrize(
    ("scenario", "delay_s", "duration"),
    [("small", 0.0, 4), ("large", 0.0, 4), ("large", 0.1, 4), ("large", 0.1234, 4), ("multiple", 0.1234, 11)],
)
def test_lockstep_recording_equals_in_process_run_bit_for_bit(
    loopback: Any, tmp_path: Path, scenario: str, delay_s: float, duration: int
) -> None:
    delays = [f"link.{way}.0.delay={delay_s / 2}" for way in ("up", "down")]
    sets = [f"scenario={scenario}", f"duration={duration}", *delays]
    computed = as_in_process(tmp_path, load_case(None, sets))
    assert len(computed.time_ns) == 60 * duration
    assert np.any(computed.applied["value"] != 0.0)


EXAMPLES = Path(__file__).parents[2] / "examples"
LEAD_LAG = f"{EXAMPLES / 'lead_lag.py'}:LeadLag"
LLC = {"name": "LLC", "signals": ["speed"]}
SVC = {"kind": "svc", "setpoint_max": 0.05, "rate_max": 5, "B_max": 2, "B_min": -1, "K": 30}
PLANTS = {
    "SSSC and STATCOM, two controllers": [
        *("scenario=large", "duration=4", "devices=[sssc, statcom]"),
        "controllers=" + json.dumps([{**LLC, "devices": ["statcom"]}, {**LLC, "devices": ["sssc"]}]),
    ],
    "infinite bus, dispatch of the scenario": ["system=smib", "scenario=light", "duration=4"],
    "loads of constant power, salient machines": [
        *("system=wscc_9_constant_power", "devices=[]", "controllers=[]", "duration=4"),
        "scenario=" + json.dumps([{"time": 1.0, "kind": "load_step", "load": "load_A", "change": 0.1}]),
    ],
    "two SVCs, a controller at one": [
        *("system=kundur_12_6", "scenario=bus8_fault", "devices=[b, a]", "duration=4"),
        "system.devices=" + json.dumps([{**SVC, "name": "a", "bus": "B8"}, {**SVC, "name": "b", "bus": "B9", "K": 10}]),
        "controllers=" + json.dumps([{"name": "LLC", "signals": ["w13"], "devices": ["a"]}]),
    ],
    "PMUs of class M, noise, wrong clocks and data": [
        *("scenario=large", "duration=4", "measurement=m_class", "measurement.quantisation=int16", "link=pdci"),
        "controllers=" + json.dumps([{"name": "HBsWC", "signals": ["frequency"]}]),
        "measurement.pmus={G1: {clock: {offset: 2.0e-5, lost: 1.0, drift: 1.0e-5}}, G2: {noise: {angle: 0.002}}}",
        "measurement.bad_data="
        + json.dumps(
            [
                {"kind": "stuck", "pmus": ["G4"], "start": 1.5, "duration": 0.5},
                {"kind": "spike", "pmus": ["G1", "TIE"], "probability": 0.05},
                {"kind": "invalid", "pmus": ["G3"], "start": 2.5, "duration": 0.2},
                {"kind": "wrong_sign", "pmus": ["TIE"], "start": 3.0},
            ]
        ),
    ],
    "a linear law of one's own": [
        *("scenario=large", "duration=3", "link=pdci"),
        "controllers="
        + json.dumps([{"name": "my_damper", "signals": ["w13"], "linear": {"num": [50, 20], "den": [0.1, 1.1, 1]}}]),
    ],
    "a class of one's own": [
        *("scenario=large", "duration=3", "link=pdci"),
        "controllers=" + json.dumps([{"name": "mine", "policy": LEAD_LAG}]),
    ],
    "an inverter's plant control, frequencies": [
        *(f"system={path('solar')}", "devices=[pod_p]", "duration=3", "link=pdci", "measurement=p_class"),
        "system.signals.f={channel: frequency, weights: {G1: 1, SOLAR: -1}}",
        "controllers=" + json.dumps([{"name": "LLC", "signals": ["f"], "devices": ["pod_p"]}]),
        "scenario=" + json.dumps([{"time": 1.0, "kind": "fault", "bus": "B1", "duration": 0.05}]),
    ],
    "a battery that forms the grid after a machine's trip": [
        *(f"system={path('battery')}", "devices=[pod_p]", "duration=3", "supervision=standard", "arm_at=0.5"),
        "controllers=" + json.dumps([{"name": "LLC", "signals": ["w12"], "devices": ["pod_p"]}]),
        "scenario=" + json.dumps([{"time": 1.0, "kind": "generator_trip", "machine": "G2"}]),
    ],
    "a large grid, samples of PMUs within its steps": [
        *("profile=deployment", "system=wecc_240", "devices=[pod_colorado]", "duration=1.2"),
        "controllers=" + json.dumps([{"name": "LLC", "signals": ["f_colorado_utah"], "devices": ["pod_colorado"]}]),
        "scenario=" + json.dumps([{"time": 0.8, "kind": "fault", "bus": "B1001", "duration": 0.08}]),
    ],
    "stabilisers and governors": [
        *("devices=[statcom]", "controllers=[]", "scenario=multiple", "duration=4", "link=delay_100ms"),
        *(f"system.{table}.{g}.enabled=true" for table in ("stabilisers", "governors") for g in range(4)),
    ],
}


@pytest.mark.parametrize("sets", PLANTS.values(), ids=PLANTS)
def test_other_plants_are_recorded_bit_for_bit_too(loopback: Any, tmp_path: Path, sets: list[str]) -> None:
    assert as_in_process(tmp_path, load_case(None, sets)).in_synchronism.all()


EVERY_NODE = [
    *("scenario=large", "duration=2.5", "devices=[sssc, statcom]", "supervision=standard", "arm_at=0.5"),
    *PLANTS["PMUs of class M, noise, wrong clocks and data"][2:4],
    "controllers="
    + json.dumps(
        [
            {"name": "HBsWC", "scheme": "indirect", "signals": ["frequency"], "devices": ["statcom"]},
            {"name": "LLC", "signals": ["frequency"], "devices": ["sssc"], "link": "pdci", "namespace": "east"},
        ]
    ),
]


def test_dds_gives_the_recording_of_the_loopback(domain: int, tmp_path: Path) -> None:
    """Both give that of the run in process, with a node of each kind; others are run on the loopback alone."""
    computed = as_in_process(tmp_path / "dds", load_case(None, EVERY_NODE))
    assert np.any(computed.supervised["value"] != 0.0)
    with opened():
        as_in_process(tmp_path / "loopback", load_case(None, EVERY_NODE))


def test_unstable_run_ends_where_the_in_process_run_ends(loopback: Any, tmp_path: Path) -> None:
    sets = ["scenario=large", "controllers=[]", "frame_rate=30"]
    computed = as_in_process(tmp_path, load_case(None, sets))
    assert len(computed.time_ns) < 600
    assert list(np.flatnonzero(~computed.in_synchronism)) == [len(computed.time_ns) - 1]


def test_two_runs_give_identical_recordings_but_for_wall_clock_stamps(domain: int, tmp_path: Path) -> None:
    sets = ["duration=2", "link=delay_100ms"]
    for name in ("a", "b"):
        as_in_process(tmp_path / name, load_case(None, sets))
    first, second = payloads(tmp_path / "a"), payloads(tmp_path / "b")
    # The order of several nodes is chance, and the recorder publishes by the wall clock.
    health = [sorted(data for data in bag.pop("/diagnostics") if b"recorder" not in data) for bag in (first, second)]
    assert health[0] == health[1]
    assert len(health[0]) == 3 * 2
    # Its publisher keeps only the newest: on a busy machine the recorder may receive only the end.
    assert first.pop("/run/state")[-1] == second.pop("/run/state")[-1]
    assert first == second
    assert len(first["/pmu/frames"]) == 120
    assert {"/plant/state", "/plant/events", "/link/statistics", "/controller_0_LLC/state"} <= set(first)


def test_real_time_loses_nothing_and_keeps_the_clock(domain: int, tmp_path: Path) -> None:
    began = time.monotonic()
    case = load_case(None, ["duration=2", "link=delay_100ms"])
    outcome = graph.run(case, "realtime", tmp_path, quiet)
    assert time.monotonic() - began > 2.0
    assert outcome.messages_lost == 0
    recorded, computed = load(outcome.recording), loop.run(case)
    assert len(recorded.time_ns) == 120
    # Delays are simulated: as long as no deadline is missed, the clock changes nothing.
    if outcome.deadline_misses == 0:
        assert_same(recorded, computed)
    else:
        assert len(recorded.delivered) == len(computed.delivered)


def test_graph_that_keeps_real_time_gives_the_in_process_run(loopback: Any, tmp_path: Path) -> None:
    began = time.monotonic()
    outcome = graph.run(load_case(None, EVERY_NODE), "realtime", tmp_path, quiet)
    assert 2.5 < time.monotonic() - began < 4.0
    assert (outcome.messages_lost, outcome.deadline_misses) == (0, 0)
    assert_same(load(outcome.recording), loop.run(load_case(None, EVERY_NODE)))


@pytest.mark.parametrize(
    ("node", "number", "expected"),
    [
        ("controller_0_LLC", signal.SIGKILL, "controller_0_LLC was killed by SIGKILL"),
        ("wan_link", signal.SIGKILL, "wan_link was killed by SIGKILL"),
        ("plant_sim", signal.SIGKILL, "plant_sim was killed by SIGKILL"),
        ("recorder", signal.SIGKILL, "recorder was killed by SIGKILL"),
        ("controller_0_LLC", signal.SIGSTOP, "controller_0_LLC is silent"),
        ("wan_link", signal.SIGSTOP, "wan_link is silent"),
        ("plant_sim", signal.SIGSTOP, "plant_sim is silent"),
    ],
)
def test_dead_or_silent_node_is_named(
    loopback: Any, tmp_path: Path, started: dict[str, Any], node: str, number: int, expected: str
) -> None:
    assert_named([], tmp_path, started, node, number, expected)


def test_silent_node_is_named_on_dds(domain: int, tmp_path: Path, started: dict[str, Any]) -> None:
    assert_named([], tmp_path, started, "wan_link", signal.SIGSTOP, "wan_link is silent")


def test_nodes_share_no_memory_and_ask_nobody_for_types(domain: int, tmp_path: Path, started: dict[str, Any]) -> None:
    """A node that is killed would leave the one to whoever comes next, and the other without an answer."""
    mapped: dict[str, list[str]] = {}  # as often as looked: one that is ending has next to nothing
    threads: set[str] = set()

    def look(_done: int, _of: int) -> None:
        for name, node in started.items():
            with suppress(OSError):  # it has ended
                process = Path(f"/proc/{node.process.pid}")
                mapped.setdefault(name, []).append((process / "maps").read_text())
                threads.update(path.read_text().strip() for path in process.glob("task/*/comm"))

    graph.run(load_case(None, ["duration=2"]), "realtime", tmp_path, look)
    assert {"wan_link", "recorder"} <= set(mapped)
    for name, texts in mapped.items():
        assert any(re.search("/libfast(dds|rtps)", text) for text in texts), name
        assert not any("/dev/shm/fast" in text for text in texts), name
    assert any(name.startswith("dds.udp") for name in threads)
    assert not any(name.startswith(("dds.shm", "dds.tls")) for name in threads)


def test_killed_recorder_leaves_what_it_had_flushed(domain: int, tmp_path: Path, started: dict[str, Any]) -> None:
    def kill_recorder(_done: int, _of: int) -> None:
        if recorded_bytes(tmp_path) > 200_000:
            started["recorder"].process.kill()

    with pytest.raises(RunError, match=r"^recorder was killed by SIGKILL"):
        graph.run(load_case(None, ["duration=1000"]), "lockstep", tmp_path, kill_recorder)
    assert nodes_left(tmp_path) == []
    recorded = load(tmp_path / "recording")
    assert len(recorded.time_ns) > 100
    assert recorded.notes
    computed = loop.run(load_case(None, ["duration=10"]))
    ticks = min(len(recorded.time_ns), len(computed.time_ns))
    assert recorded.frames[:ticks].tobytes() == computed.frames[:ticks].tobytes()


def _as_at_a_terminal() -> None:
    """Where the tests themselves run in the background, or by nohup, what they start would ignore these."""
    for number in (signal.SIGINT, signal.SIGHUP):
        signal.signal(number, signal.SIG_DFL)


@pytest.fixture
def command(domain: int, tmp_path: Path) -> Iterator[subprocess.Popen[str]]:
    # A grid that holds its frequency: without governors the run ends after 92 s, within some 4 s of wall time.
    run = ["run", "two_area_free", "--set", "duration=1000", "--out", str(tmp_path / "out")]
    arguments = ["-m", "facts_damping.cli.main", *run]
    popen = subprocess.Popen(
        [sys.executable, *arguments],
        stderr=subprocess.PIPE,
        text=True,
        preexec_fn=_as_at_a_terminal,  # noqa: PLW1509 (no threads here)
    )
    yield popen
    if popen.poll() is None:
        popen.kill()
    popen.wait()
    if popen.stderr is not None:
        popen.stderr.close()


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_interrupted_command_leaves_no_process_and_a_sound_recording(
    command: Any, tmp_path: Path, number: signal.Signals
) -> None:
    wait_until_recording(tmp_path)
    if number == signal.SIGTERM:
        assert_kept_apart(["duration=5"], tmp_path / "second")
        assert command.poll() is None
    command.send_signal(number)
    _, errors = command.communicate(timeout=PATIENCE_S)
    assert command.returncode == 128 + number
    assert errors == "facts-damping: interrupted; what was recorded by then is readable\n"
    assert nodes_left(tmp_path) == []
    recorded = load(tmp_path / "out" / "recording")
    assert (tmp_path / "out" / "recording" / "metadata.yaml").exists()
    assert len(recorded.time_ns) > 100
    (note,) = recorded.notes
    assert note.startswith("the run was stopped: the record ends with tick ")
    assert note.endswith(" s of 1000 s")


@pytest.mark.parametrize(("number", "after_s"), [(signal.SIGINT, 0.3), (signal.SIGINT, 1.6), (signal.SIGKILL, 1.6)])
def test_command_that_is_interrupted_at_its_start_says_one_line(
    domain: int, tmp_path: Path, number: int, after_s: float
) -> None:
    """By Ctrl-C, which all processes of a terminal get. Nothing is left in the temporary folder, as after a kill."""
    popen = subprocess.Popen(
        [sys.executable, "-m", "facts_damping.cli.main", "run", "--out", str(tmp_path / "out")],
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, "TMPDIR": str(tmp_path)},
        preexec_fn=_as_at_a_terminal,  # noqa: PLW1509 (no threads here)
        start_new_session=True,
    )
    time.sleep(after_s)
    (os.killpg if number == signal.SIGINT else os.kill)(popen.pid, number)
    _, errors = popen.communicate(timeout=PATIENCE_S)
    if popen.returncode == 130:
        assert errors.startswith("facts-damping: interrupted")
        assert errors.count("\n") == 1, errors
    else:  # before Python itself had begun
        assert popen.returncode in (-signal.SIGKILL, -signal.SIGINT, 1)
    wait_until(lambda: not [path for path in tmp_path.iterdir() if path.name.startswith(("pymp", "tmp"))])


def test_killed_command_takes_its_nodes_along(command: Any, tmp_path: Path) -> None:
    wait_until_recording(tmp_path)
    command.kill()
    command.wait()
    wait_until(lambda: not nodes_left(tmp_path))


def test_json_of_run_and_simulate_agree(loopback: Any, tmp_path: Path, capsys: Any) -> None:
    results = []
    for verb in (["run", "--out", str(tmp_path / "out")], ["simulate"]):
        assert main([*verb, "two_area_small", "--set", "duration=3", "--json", "-"]) == 0
        results.append(json.loads(capsys.readouterr().out))
    recorded, computed = results
    assert recorded["recording"] == str(tmp_path / "out" / "recording")
    assert computed["recording"] is None
    for key in computed.keys() - {"wall_s", "recording", "versions"}:
        assert recorded[key] == computed[key], key
    assert f"digest: '\"{computed['digest']}\"'" in (tmp_path / "out/recording/metadata.yaml").read_text()
    assert load(tmp_path / "out/recording").notes == []
