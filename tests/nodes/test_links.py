"""Controllers with links and namespaces of their own, as nodes: same bits as in process, failures by name.

On the loopback; test_graph.py has such a graph on DDS.
"""

from __future__ import annotations

import json
import os
import shutil
import signal
import time
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st

from facts_damping.case.loading import load_case
from facts_damping.control.compensation import COMPENSATIONS
from facts_damping.nodes.launching import graph
from facts_damping.parameters.yaml_text import dump
from facts_damping.recording.reader import load
from facts_damping.simulation import loop
from tests.link.test_presets import any_link
from tests.nodes.graphs import (
    LOADED_S,
    PATIENCE_S,
    as_in_process,
    assert_kept_apart,
    assert_named,
    assert_same,
    payloads,
    quiet,
    set_parameter,
)
from tests.two_devices import ACTUATORS

if TYPE_CHECKING:
    from pathlib import Path


pytestmark = pytest.mark.usefixtures("loopback")


def link(up: float, down: float = 0.0) -> dict[str, Any]:
    """A link inline, delays in s."""
    return {"up": [{"delay": up / 2}, {"delay": up / 2}], "down": [{"delay": down}]}


def sets(sssc: dict[str, Any], statcom: dict[str, Any], *more: str) -> list[str]:
    """A run of two controllers: what they have beside a device each."""
    rows = [
        {"name": "LLC", "signals": ["speed"], "devices": ["sssc"], **sssc},
        {"name": "LLC", "signals": ["speed"], "devices": ["statcom"], "parameters": {"gain": 5.0}, **statcom},
    ]
    return ["devices=[sssc, statcom]", "scenario=large", "duration=2", f"controllers={json.dumps(rows)}", *more]


ROUGH = {
    "up": [
        {"model": "gamma", "delay": 0.01, "shape": 2.0, "scale": 0.02},
        {"model": "gilbert_elliott", "p_GB": 0.1, "p_BG": 0.3},
        {"model": "duplicate", "probability": 0.3},
        {"model": "uniform", "low": 0.0, "high": 0.05},
        {"model": "wait", "wait": 0.03, "missing": "hold", "channels": ["w13"]},
    ],
    "down": [{"model": "lognormal", "median": 0.02, "sigma": 1.0}, {"model": "duplicate", "probability": 0.5}],
}
WRONG = {
    "up": [
        {"model": "normal", "mean": 0.03, "std": 0.02},
        {"model": "spoof", "offset": 0.02, "start": 1.2, "channels": ["w13"]},
        {"model": "replay", "window": 0.3, "start": 1.3, "duration": 0.4},
        {"model": "ramp", "rate": 0.01, "start": 1.6},
        {"model": "noise", "std": 1e-4, "measurement": "speed_deviation"},
    ],
    "down": [{"model": "bernoulli", "loss": 0.2}, {"model": "in_order"}, {"model": "playout", "delay": 0.1}],
}
HBSWC = {"name": "HBsWC", "scheme": "indirect", "signals": ["w13"], "parameters": {}}
RUNS = {
    "the run's link and an own one, other actuators": [
        *sets({"devices": ["bess", "shed"]}, {"devices": ["tcsc", "avr"], "link": link(0.1)}),
        *(f"system.devices.{2 + i}={json.dumps(row)}" for i, row in enumerate(ACTUATORS)),
        "devices=[bess, shed, tcsc, avr]",
    ],
    "two own ones, 0 and 123.4 ms, in namespaces": sets(
        {"link": "ideal", "namespace": "tie"}, {"link": link(0.0617, 0.0617), "namespace": "east/substation"}
    ),
    "two own ones, 123.4 and 100 ms, one namespace": sets(
        {"link": link(0.0, 0.1234), "namespace": "area"}, {"link": "delay_100ms", "namespace": "area"}
    ),
    "namespaces alone": sets({"namespace": "tie"}, {"namespace": "substation"}, "link=delay_100ms"),
    "identifier on an own link in a namespace": sets({}, {**HBSWC, "link": link(0.05, 0.0234), "namespace": "here"}),
    "jitter, bursts of loss, copies, a concentrator": sets(
        {"link": ROUGH}, {**HBSWC, "link": "plc", "namespace": "here"}, "seed=5"
    ),
    "compensation by a phasor of jitter, by lead of a constant delay": sets(
        {"compensation": "lead", "link": link(0.1, 0.1)}, {**HBSWC, "compensation": "phasor", "link": "plc"}
    ),
    "disturbed data, wrong stamps, order": sets({"link": WRONG}, {"link": "pdci"}, "seed=6"),
    "identifier in a namespace on the run's link": sets(
        {"link": link(0.1)}, {**HBSWC, "namespace": "here"}, "link.up.0.delay=0.0333"
    ),
}


@pytest.mark.parametrize("run", RUNS.values(), ids=RUNS)
def test_graph_with_own_links_is_the_in_process_run_bit_for_bit(tmp_path: Path, run: list[str]) -> None:
    case = load_case(None, run)
    computed = as_in_process(tmp_path, case)
    assert np.unique(computed.delivered["link"]).tolist() == list(range(len(case.links)))
    assert len(np.unique(computed.applied["device"])) == len(case.run.devices)
    again = loop.run(load_case(str(tmp_path / "run.yaml")))  # the stored run has all links inline
    assert again.applied.tobytes() == computed.applied.tobytes()


@settings(
    deadline=None,
    max_examples=6,
    phases=[Phase.explicit, Phase.reuse, Phase.generate],  # without shrinking: a failure names its run as it is
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.function_scoped_fixture],
)
@given(
    first=any_link("sssc"),
    other=any_link("statcom"),
    scheme=st.sampled_from([{}, {"name": "HBsWC", "scheme": "direct"}, {"name": "ANFTSC", "scheme": "indirect"}]),
    compensation=st.sampled_from(list(COMPENSATIONS)),
    seed=st.integers(0, 2**31 - 1),
)
def test_graph_with_any_links_is_the_in_process_run_bit_for_bit(
    tmp_path_factory: pytest.TempPathFactory,
    first: dict[str, Any],
    other: dict[str, Any],
    scheme: dict[str, Any],
    compensation: str,
    seed: int,
) -> None:
    seeded = [f"link={json.dumps(first)}", f"seed={seed}", "duration=2"]
    case = load_case(None, sets(scheme, {"signals": ["w13"], "compensation": compensation, "link": other}, *seeded))
    as_in_process(tmp_path_factory.mktemp("graph"), case)


def test_unstable_run_with_own_links_ends_where_the_in_process_run_ends(tmp_path: Path) -> None:
    idle = {"parameters": {"gain": 0.0}}
    case = load_case(
        None, [*sets({**idle, "link": link(0.1)}, {**idle, "link": "ideal"}), "duration=20", "frame_rate=30"]
    )
    assert not as_in_process(tmp_path, case).in_synchronism[-1]


APART = sets({"link": link(0.1), "namespace": "tie"}, {"link": link(0.01), "namespace": "substation"})
TIE, SUBSTATION = "tie/controller_0_LLC", "substation/controller_1_LLC"


def test_topics_stand_in_the_controllers_namespaces(tmp_path: Path) -> None:
    graph.run(load_case(None, [*APART, "duration=1.1"]), "lockstep", tmp_path, quiet, LOADED_S)
    assert set(payloads(tmp_path)) == {
        *(f"/{name}" for name in ("pmu/frames", "plant/state", "plant/events", "diagnostics", "run/state")),
        *(f"/{namespace}/{name}" for namespace in (TIE, SUBSTATION) for name in ("setpoints", "state")),
        *(
            f"/{namespace}/{name}"
            for namespace in ("tie", "substation")
            for name in ("pmu/delivered", "setpoints/delivered", "link/statistics")
        ),
    }


def test_links_that_are_late_by_turns_change_nothing(tmp_path: Path, started: dict[str, Any]) -> None:
    turns = iter([f"{place}/wan_link" for place in ("tie", "substation")] * 2 + [TIE, SUBSTATION])

    def hold(_done: int, _of: int) -> None:
        node = next(turns, None)
        if node is not None:
            pid = started[node].process.pid
            os.kill(pid, signal.SIGSTOP)
            time.sleep(0.3)
            os.kill(pid, signal.SIGCONT)

    case = load_case(None, APART)
    graph.run(case, "lockstep", tmp_path, hold, LOADED_S)
    assert next(turns, "none left") == "none left"
    assert_same(load(tmp_path / "recording"), loop.run(case))


def test_real_time_with_own_links_loses_nothing_and_its_recording_may_be_cut(tmp_path: Path) -> None:
    case = load_case(None, [*APART, "duration=3"])
    outcome = graph.run(case, "realtime", tmp_path / "whole", quiet)
    assert (outcome.messages_lost, outcome.deadline_misses) == (0, 0)
    file, computed, ticks = next(outcome.recording.glob("*.mcap")), loop.run(case), [0]
    assert_same(load(outcome.recording), computed)
    for fraction in (0.3, 0.5, 0.7):
        cut = tmp_path / "cut.mcap"
        shutil.copy(file, cut)
        os.truncate(cut, int(fraction * file.stat().st_size))
        recorded = load(cut)
        ticks.append(len(recorded.time_ns))
        assert any("the end is missing" in note for note in recorded.notes)
        assert recorded.frames.tobytes() == computed.frames[: ticks[-1]].tobytes()
        for name in ("delivered", "issued", "applied"):
            whole = getattr(computed, name)
            assert getattr(recorded, name).tobytes() == whole[whole["tick"] < ticks[-1]].tobytes(), name
    assert 0 < ticks[1] < case.ticks
    assert ticks == sorted(ticks)


@pytest.mark.parametrize(
    ("node", "number", "expected"),
    [
        ("tie/wan_link", signal.SIGKILL, "^tie/wan_link was killed by SIGKILL"),
        ("tie/wan_link", signal.SIGSTOP, "plant_sim: tie/wan_link is silent"),
        (SUBSTATION, signal.SIGSTOP, f"substation/wan_link: {SUBSTATION} is silent"),
        ("plant_sim", signal.SIGSTOP, "wan_link: plant_sim is silent"),
    ],
)
def test_dead_or_silent_node_is_named_by_its_place(
    tmp_path: Path, started: dict[str, Any], node: str, number: int, expected: str
) -> None:
    assert_named(APART, tmp_path, started, node, number, expected)


def test_second_graph_of_other_architecture_is_kept_apart(tmp_path: Path, start: Any) -> None:
    common = {"scenario": "large", "start_timeout": PATIENCE_S}
    nodes = [start(name, **common) for name in ("wan_link", "controller")]
    plant = start("plant_sim", mode="realtime", duration=1000.0, **common)
    plant.wait(lambda: "tick" in plant.texts()[0], PATIENCE_S)
    assert_kept_apart([*APART, "duration=5"], tmp_path)
    assert all(node.poll() is None for node in (plant, *nodes))


def test_graph_with_namespaces_moves_below_another(start: Any, tmp_path: Path) -> None:
    run_file = tmp_path / "run.yaml"
    run_file.write_text(dump(load_case(None, [*APART, "duration=1"]).document()))
    common = {"run": run_file, "recorder": "true", "start_timeout": PATIENCE_S}
    refused = start("wan_link", "-r", "__ns:=/grid", index=1, **common)
    _, errors = refused.communicate(timeout=PATIENCE_S)
    assert refused.returncode == 2
    assert errors == "grid/wan_link: namespace: /grid given; allowed: one that ends with /substation (-r __ns:=...)\n"
    recorder = start("recorder", "-r", "__ns:=/grid", output=tmp_path / "bag", **common)
    for i, place in enumerate(("tie", "substation")):
        for executable in ("wan_link", "controller"):
            start(executable, "-r", f"__ns:=/grid/{place}", index=i, **common)
    plant = start("plant_sim", "-r", "__ns:=/grid", **common)
    plant.finish()
    recorder.terminate()
    assert recorder.communicate(timeout=PATIENCE_S) == ("lost 0\n", "")
    assert_same(load(tmp_path / "bag"), loop.run(load_case(str(run_file))))


def test_delay_may_be_changed_while_the_link_runs(start: Any, client: Any, tmp_path: Path) -> None:
    common = {"set": "[link.up.0.delay=0.02]", "mode": "realtime", "duration": 1000.0}
    common |= {"recorder": "true", "start_timeout": PATIENCE_S}
    recorder = start("recorder", output=tmp_path / "bag", **common)
    for name in ("wan_link", "controller"):
        start(name, **common)
    plant = start("plant_sim", **common)
    plant.wait(lambda: "tick" in plant.texts()[0], PATIENCE_S)
    time.sleep(1.0)
    assert set_parameter(client, "wan_link", "up.0.delay", 0.15).successful
    assert not set_parameter(client, "wan_link", "up.0.delay", 61.0).successful
    time.sleep(1.0)
    for node in (plant, recorder):
        node.stop()
    delivered = load(tmp_path / "bag").delivered
    late = (delivered["arrival_ns"] - delivered["measured_ns"])[np.argsort(delivered["measured_ns"], kind="stable")]
    assert set(late.tolist()) == {20_000_000, 150_000_000}
    assert (np.diff(late) >= 0).all()
