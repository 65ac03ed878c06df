"""The graph with real nodes and real DDS: its recording equals the in-process run, and it fails by name."""

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
from facts_damping.errors import RunError
from facts_damping.nodes import graph
from facts_damping.nodes.loopback.opening import opened
from facts_damping.recording.reader import load
from facts_damping.simulation import loop
from tests.nodes.graphs import (
    PATIENCE_S,
    assert_kept_apart,
    assert_named,
    assert_same,
    nodes_left,
    payloads,
    quiet,
    run_graph,
    wait_until_recording,
)

if TYPE_CHECKING:
    from collections.abc import Iterator


@pytest.mark.parametrize("delay_s", [0.0, 0.1, 0.1234])
@pytest.mark.parametrize("scenario", ["small", "large", "multiple"])
def test_lockstep_recording_equals_in_process_run_bit_for_bit(
    loopback: Any, tmp_path: Path, scenario: str, delay_s: float
) -> None:
    sets = [f"scenario={scenario}", f"link.up.0.delay={delay_s / 2}", f"link.down.0.delay={delay_s / 2}"]
    recorded = run_graph(tmp_path, sets)
    computed = loop.run(load_case(None, sets))
    assert len(recorded.time_ns) == 1200
    assert np.any(recorded.applied["value"] != 0.0)
    assert_same(recorded, computed)


EXAMPLES = Path(__file__).parents[2] / "examples"
LEAD_LAG = f"{EXAMPLES / 'lead_lag.py'}:LeadLag"
LLC = {"name": "LLC", "signals": ["speed"]}
SVC = {"kind": "svc", "v_max": 0.05, "rate_max": 5, "B_max": 2, "B_min": -1, "K": 30}
PLANTS = {
    "SSSC and STATCOM, two controllers": [
        "scenario=large",
        "devices=[sssc, statcom]",
        "controllers=" + json.dumps([{**LLC, "devices": ["statcom"]}, {**LLC, "devices": ["sssc"]}]),
    ],
    "infinite bus, dispatch of the scenario": ["system=smib", "scenario=light", "duration=10"],
    "loads of constant power, salient machines": [
        *("system=wscc_9_constant_power", "devices=[]", "controllers=[]", "duration=10"),
        "scenario=" + json.dumps([{"time": 1.0, "kind": "load_step", "load": "load_A", "change": 0.1}]),
    ],
    "two SVCs, a controller at one": [
        *("system=kundur_12_6", "scenario=bus8_fault", "devices=[b, a]", "duration=10"),
        "system.devices=" + json.dumps([{**SVC, "name": "a", "bus": "B8"}, {**SVC, "name": "b", "bus": "B9", "K": 10}]),
        "controllers=" + json.dumps([{"name": "LLC", "signals": ["w13"], "devices": ["a"]}]),
    ],
    "PMUs of class M, noise, wrong clocks and data": [
        *("scenario=large", "duration=8", "measurement=m_class", "measurement.quantisation=int16", "link=pdci"),
        "controllers=" + json.dumps([{"name": "HBsWC", "signals": ["frequency"]}]),
        "measurement.stations={G1: {clock: {offset: 2.0e-5, lost: 2.0, drift: 1.0e-5}}, G2: {noise: {angle: 0.002}}}",
        "measurement.bad_data="
        + json.dumps(
            [
                {"kind": "stuck", "stations": ["G4"], "start": 3.0, "duration": 0.5},
                {"kind": "spike", "stations": ["G1", "TIE"], "probability": 0.05},
                {"kind": "invalid", "stations": ["G3"], "start": 5.0, "duration": 0.2},
                {"kind": "wrong_sign", "stations": ["TIE"], "start": 6.0},
            ]
        ),
    ],
    "a linear law of one's own": [
        *("scenario=large", "duration=5", "link=pdci"),
        "controllers="
        + json.dumps([{"name": "my_damper", "signals": ["w13"], "linear": {"num": [50, 20], "den": [0.1, 1.1, 1]}}]),
    ],
    "a class of one's own": [
        *("scenario=large", "duration=5", "link=pdci"),
        "controllers=" + json.dumps([{"name": "mine", "policy": LEAD_LAG}]),
    ],
    "stabilisers and governors": [
        *("devices=[statcom]", "controllers=[]", "scenario=multiple", "link=delay_100ms"),
        *(f"system.{table}.{g}.enabled=true" for table in ("stabilisers", "governors") for g in range(4)),
    ],
}


@pytest.mark.parametrize("sets", PLANTS.values(), ids=PLANTS)
def test_other_plants_are_recorded_bit_for_bit_too(loopback: Any, tmp_path: Path, sets: list[str]) -> None:
    computed = loop.run(load_case(None, sets))
    assert computed.in_synchronism.all()
    assert_same(run_graph(tmp_path, sets), computed)


ON_DDS = {
    "lead-lag, constant delay": ["scenario=large", "link=delay_100ms", "duration=3"],
    "neuro-fuzzy, indirect, PMUs of class M": [
        "duration=3",
        *PLANTS["PMUs of class M, noise, wrong clocks and data"][2:],
    ],
    "two controllers with links of their own": [
        *("devices=[sssc, statcom]", "scenario=large", "duration=3"),
        "controllers="
        + json.dumps(
            [{**LLC, "devices": ["statcom"], "link": "pdci", "namespace": "east"}, {**LLC, "devices": ["sssc"]}]
        ),
    ],
}


@pytest.mark.parametrize("sets", ON_DDS.values(), ids=ON_DDS)
def test_dds_gives_the_recording_of_the_loopback(domain: int, tmp_path: Path, sets: list[str]) -> None:
    """Both give that of the run in process; the other kinds are run on the loopback alone."""
    recorded = run_graph(tmp_path / "dds", sets)
    assert_same(recorded, loop.run(load_case(None, sets)))
    with opened():
        assert_same(run_graph(tmp_path / "loopback", sets), recorded)


def test_unstable_run_ends_where_the_in_process_run_ends(loopback: Any, tmp_path: Path) -> None:
    sets = ["scenario=large", "controllers=[]", "frame_rate=30"]
    recorded, computed = run_graph(tmp_path, sets), loop.run(load_case(None, sets))
    assert_same(recorded, computed)
    assert len(recorded.time_ns) < 600
    assert list(np.flatnonzero(~recorded.in_synchronism)) == [len(recorded.time_ns) - 1]


def test_two_runs_give_identical_recordings_but_for_wall_clock_stamps(domain: int, tmp_path: Path) -> None:
    sets = ["duration=4", "link=delay_100ms"]
    run_graph(tmp_path / "a", sets)
    run_graph(tmp_path / "b", sets)
    first, second = payloads(tmp_path / "a"), payloads(tmp_path / "b")
    # Who of several nodes speaks first is chance, and the recorder speaks by the wall clock.
    told = [sorted(one for one in bag.pop("/diagnostics") if b"recorder" not in one) for bag in (first, second)]
    assert told[0] == told[1]
    assert len(told[0]) == 3 * 4
    assert first == second
    assert len(first["/pmu/frames"]) == 240
    assert {"/plant/state", "/plant/events", "/link/statistics", "/controller_0_LLC/state"} <= set(first)


def test_real_time_loses_nothing_and_keeps_the_clock(domain: int, tmp_path: Path) -> None:
    began = time.monotonic()
    case = load_case(None, ["duration=3", "link=delay_100ms"])
    outcome = graph.run(case, "realtime", tmp_path, quiet)
    assert time.monotonic() - began > 3.0
    assert outcome.messages_lost == 0
    recorded = load(outcome.recording)
    assert len(recorded.time_ns) == 180
    # Delays are simulated: as long as no deadline is missed, the clock changes nothing.
    if outcome.deadline_misses == 0:
        assert_same(recorded, loop.run(case))
    else:
        assert len(recorded.delivered) == len(loop.run(case).delivered)


@pytest.mark.parametrize(
    ("node", "number", "said"),
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
    domain: int, tmp_path: Path, started: dict[str, Any], node: str, number: int, said: str
) -> None:
    assert_named([], tmp_path, started, node, number, said)


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

    graph.run(load_case(None, ["duration=2"]), "lockstep", tmp_path, look)
    assert {"wan_link", "recorder"} <= set(mapped)
    for name, texts in mapped.items():
        assert any(re.search("/libfast(dds|rtps)", text) for text in texts), name
        assert not any("/dev/shm/fast" in text for text in texts), name
    assert any(name.startswith("dds.udp") for name in threads)
    assert not any(name.startswith(("dds.shm", "dds.tls")) for name in threads)


def test_killed_recorder_leaves_what_it_had_flushed(domain: int, tmp_path: Path, started: dict[str, Any]) -> None:
    def strike(done: int, _of: int) -> None:
        if done > 1000:
            started["recorder"].process.kill()

    with pytest.raises(RunError, match="recorder was killed"):
        graph.run(load_case(None, ["duration=1000"]), "lockstep", tmp_path, strike)
    recorded = load(tmp_path / "recording")
    assert len(recorded.time_ns) > 100
    assert recorded.notes
    computed = loop.run(load_case(None, ["duration=30"]))
    ticks = min(len(recorded.time_ns), len(computed.time_ns))
    assert recorded.frames[:ticks].tobytes() == computed.frames[:ticks].tobytes()


def _as_at_a_terminal() -> None:
    """Where the tests themselves run in the background, what they start would ignore interrupts."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


@pytest.fixture
def command(domain: int, tmp_path: Path) -> Iterator[subprocess.Popen[str]]:
    arguments = ["-m", "facts_damping.cli.main", "run", "--set", "duration=1000", "--out", str(tmp_path / "out")]
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


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_interrupted_command_leaves_no_process_and_a_sound_recording(
    command: subprocess.Popen[str], tmp_path: Path, number: signal.Signals
) -> None:
    wait_until_recording(tmp_path)
    command.send_signal(number)
    _, errors = command.communicate(timeout=PATIENCE_S)
    assert command.returncode == 130
    assert errors.count("\n") == 1
    assert nodes_left(tmp_path) == []
    recorded = load(tmp_path / "out" / "recording")
    assert (tmp_path / "out" / "recording" / "metadata.yaml").exists()
    assert len(recorded.time_ns) > 100


@pytest.mark.parametrize("after_s", [0.3, 1.6])
def test_a_command_that_is_interrupted_at_its_start_says_one_line(domain: int, tmp_path: Path, after_s: float) -> None:
    """By Ctrl-C, which all processes of a terminal get. Nothing is left in the temporary folder, as after a kill."""
    for number in (signal.SIGINT, signal.SIGKILL):
        command = [sys.executable, "-m", "facts_damping.cli.main", "run", "--out", str(tmp_path / f"{number}")]
        popen = subprocess.Popen(
            command,
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
        deadline = time.monotonic() + PATIENCE_S
        while left := [path for path in tmp_path.iterdir() if path.name.startswith(("pymp", "tmp"))]:
            assert time.monotonic() < deadline, left
            time.sleep(0.05)


def test_killed_command_takes_its_nodes_along(command: subprocess.Popen[str], tmp_path: Path) -> None:
    wait_until_recording(tmp_path)
    command.kill()
    command.wait()
    deadline = time.monotonic() + PATIENCE_S
    while nodes_left(tmp_path):
        assert time.monotonic() < deadline, nodes_left(tmp_path)
        time.sleep(0.1)


def test_json_of_run_and_simulate_agree(domain: int, tmp_path: Path) -> None:
    arguments = ["two_area_small", "--set", "duration=3", "--json", "-"]
    results = []
    for verb in (["run", "--out", str(tmp_path / "out")], ["simulate"]):
        done = subprocess.run(
            [sys.executable, "-m", "facts_damping.cli.main", *verb, *arguments],
            capture_output=True,
            text=True,
            check=True,
        )
        results.append(json.loads(done.stdout))
    recorded, computed = results
    assert recorded["recording"] == str(tmp_path / "out" / "recording")
    assert computed["recording"] is None
    for key in computed.keys() - {"wall_s", "recording", "versions"}:
        assert recorded[key] == computed[key], key
    assert f"digest: '\"{computed['digest']}\"'" in (tmp_path / "out/recording/metadata.yaml").read_text()
    assert load(tmp_path / "out/recording").notes == []


def test_two_graphs_in_the_same_domain_are_kept_apart(command: subprocess.Popen[str], tmp_path: Path) -> None:
    wait_until_recording(tmp_path)
    assert_kept_apart(["duration=5"], tmp_path / "second")
    assert command.poll() is None
