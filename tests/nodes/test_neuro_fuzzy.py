"""Neuro-fuzzy controllers as nodes, with the identifier: same bits as in process, weights kept, parameters live.

On the loopback; test_graph.py has such a graph by the clock, and on DDS.
"""

from __future__ import annotations

import signal
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from facts_damping_msgs.msg import ControllerState, JacobianEstimate
from rclpy.serialization import deserialize_message

from facts_damping.case.loading import load_case
from facts_damping.neurofuzzy.table import VARIANTS
from facts_damping.nodes.launching import graph
from facts_damping.parameters.files import read_table
from facts_damping.recording.reader import load
from facts_damping.simulation import adapted_weights, loop
from tests.nodes.graphs import LOADED_S, as_in_process, assert_named, assert_same, payloads, quiet, set_parameter
from tests.two_devices import centralised

if TYPE_CHECKING:
    from pathlib import Path

pytestmark = pytest.mark.usefixtures("loopback")

SCENARIOS = [
    *(["system=two_area", f"scenario={name}"] for name in ("small", "large", "multiple")),
    *(["system=smib", f"scenario={name}"] for name in ("nominal", "light", "heavy", "multiple")),
]
# Every variant; schemes, scenarios and links in turn. All of them together: benchmarks/graphs.py.
RUNS = [
    (name, ("indirect", "direct")[i % 2], SCENARIOS[i % len(SCENARIOS)], ("ideal", "delay_100ms")[i % 3 == 2])
    for i, name in enumerate([*VARIANTS, "b-spline-interpolated+fourier"])
]
MIMO = [
    ("LLC", None, "large", "ideal"),
    ("LQG", None, "large", "delay_100ms"),
    ("ANFTSC", "indirect", "large", "delay_100ms"),
    ("ANFFsC", "direct", "multiple", "ideal"),
    ("ANFTrMoC", "indirect", "small", "ideal"),
    ("ANFLeWC", "indirect", "multiple", "ideal"),
    ("HBsWC", "direct", "large", "ideal"),
    ("HBsWC", "indirect", "small", "ideal"),
]
HBSWC = ["controllers.0.name=HBsWC", "controllers.0.scheme=indirect", "scenario=large"]


# The matrices of an LQG are made in each process; with a part of a frame of delay, and over a link that loses frames.
LINKS = {"delay": "link.up=[{delay: 0.0712}]", "loss": "link.up=[{delay: 0.05}, {model: bernoulli, loss: 0.1}]"}


@pytest.mark.parametrize("link", LINKS)
@pytest.mark.parametrize("system", [["system=two_area", "scenario=large"], ["system=smib", "scenario=heavy"]])
def test_graph_with_an_lqg_is_the_in_process_run_bit_for_bit(tmp_path: Path, system: list[str], link: str) -> None:
    case = load_case(None, [*system, "controllers.0.name=LQG", LINKS[link], "duration=2.5"])
    assert np.abs(as_in_process(tmp_path, case).applied["value"]).max() > 0.01


@pytest.mark.parametrize("name", ["LQG", "Hinf", "ANFTSC"])
def test_graph_of_the_deployment_is_the_in_process_run_bit_for_bit(tmp_path: Path, name: str) -> None:
    """Its controllers and supervisors are designed on another system than its plant."""
    sets = [f"controllers.0.name={name}", "system.machines.0.H=5", "system.loads.0.P=900", "duration=2.5"]
    case = load_case("two_area_deployment", sets)
    assert case.designed_on.machines[0].H != case.system.machines[0].H
    assert np.abs(as_in_process(tmp_path, case).applied["value"]).max() > 0.01


@pytest.mark.parametrize(("name", "scheme", "scenario", "link"), RUNS, ids=[f"{n}-{s}" for n, s, _, _ in RUNS])
def test_graph_with_identifier_is_the_in_process_run_bit_for_bit(
    tmp_path: Path, name: str, scheme: str, scenario: list[str], link: str
) -> None:
    run_sets = [f"controllers.0.name={name}", f"controllers.0.scheme={scheme}", f"link={link}", "duration=2"]
    case = load_case(None, [*scenario, *run_sets])
    computed = as_in_process(tmp_path, case)
    assert np.any(computed.applied["value"] != 0.0)
    assert len(computed.estimates) == (120 if scheme == "indirect" else 0)


@pytest.mark.parametrize(("name", "scheme", "scenario", "link"), MIMO, ids=[f"{n}-{s}" for n, s, _, _ in MIMO])
def test_centralised_graph_is_the_in_process_run_bit_for_bit(
    tmp_path: Path, name: str, scheme: str | None, scenario: str, link: str
) -> None:
    """Two signals, two devices; all of them: benchmarks/graphs.py."""
    run_sets = [*centralised(name, scheme), f"scenario={scenario}", f"link={link}", "duration=2"]
    case = load_case(None, run_sets)
    computed = as_in_process(tmp_path, case)
    assert {0, 1} == set(computed.issued["device"])
    assert len(computed.estimates) == (4 * 120 if scheme == "indirect" else 0)


def test_two_indirect_controllers_each_with_its_identifier(tmp_path: Path) -> None:
    rows = [
        {"name": "ANFTSC", "signals": ["speed"], "devices": ["sssc"]},
        {"name": "LLC", "signals": ["w13"], "devices": ["statcom"]},
    ]
    rows[1] |= {"name": "HBsWC", "scheme": "indirect"}
    sets = ["devices=[sssc, statcom]", f"controllers={rows}", "scenario=large", "duration=3"]
    assert set(as_in_process(tmp_path, load_case(None, sets)).estimates["controller"]) == {0, 1}


def test_weights_are_saved_and_a_run_goes_on_from_them(tmp_path: Path) -> None:
    case = load_case(None, [*HBSWC, "duration=2"])
    built = loop.build_loop(case)
    loop.finish(case, built)
    graph.run(case, "lockstep", tmp_path / "first", quiet, LOADED_S)
    (file,) = (tmp_path / "first").glob("*.weights.yaml")
    (learnt,) = adapted_weights.all_adapted(case, built).values()
    assert read_table(file) == learnt.model_dump()
    warm = load_case(None, [*HBSWC, "duration=2", f"controllers.0.weights={file}"])
    graph.run(warm, "lockstep", tmp_path / "second", quiet, LOADED_S)
    recorded = load(tmp_path / "second" / "recording")
    assert_same(recorded, loop.run(warm))
    assert recorded.configuration["controllers"][0]["weights"] == learnt.model_dump()
    assert recorded.issued.tobytes() != load(tmp_path / "first" / "recording").issued.tobytes()


def test_inner_state_and_estimates_are_published_every_tick(tmp_path: Path) -> None:
    case = load_case(None, [*HBSWC, "duration=3"])
    graph.run(case, "lockstep", tmp_path, quiet, LOADED_S)
    messages = payloads(tmp_path)
    states = [deserialize_message(data, ControllerState) for data in messages["/controller_0_HBsWC/state"]]
    estimates = [deserialize_message(data, JacobianEstimate) for data in messages["/identifier_0_ANFGuMoI/estimate"]]
    assert len(states) == len(estimates) == 180
    built = loop.build_loop(case)
    loop.finish(case, built)
    learner, last = built.control.bank_state.learner, states[-1]
    assert last.parameter_groups == ["degree", "w", "tau", "nu"]
    for g, norm in enumerate(last.parameter_norms):
        assert norm == pytest.approx(np.linalg.norm(learner.theta[0][learner.group[0] == g]))
    assert list(last.firing_strengths) == learner.passed.firing[0].tolist()
    assert last.learnt
    assert not states[0].learnt
    assert any(state.saturated[0] for state in states)
    assert all(rate > 0.0 for rate in last.learning_rates)
    assert estimates[-1].output_names == ["speed"]
    assert estimates[-1].input_names == ["sssc"]
    assert list(estimates[-1].jacobian) == built.control.identifier_state.jacobian[0].ravel().tolist()


@pytest.mark.parametrize(
    ("node", "number", "expected"),
    [
        ("identifier_0_ANFGuMoI", signal.SIGKILL, "identifier_0_ANFGuMoI was killed by SIGKILL"),
        ("identifier_0_ANFGuMoI", signal.SIGSTOP, "identifier_0_ANFGuMoI is silent"),
    ],
)
def test_dead_or_silent_identifier_is_named(
    tmp_path: Path, started: dict[str, Any], node: str, number: int, expected: str
) -> None:
    assert_named(HBSWC, tmp_path, started, node, number, expected)


def test_parameters_that_are_safe_to_change_change_while_it_runs(start: Any, client: Any) -> None:
    common = {"set": "[controllers.0.name=HBsWC]", "start_timeout": 60.0}
    for name in ("controller", "identifier", "wan_link"):
        start(name, **common)
    start("plant_sim", mode="realtime", duration=1000.0, **common)
    change = partial(set_parameter, client)
    assert change("controller", "eta", 0.01).successful
    assert change("controller", "rate", "lyapunov").successful
    assert change("identifier", "identifier_eta", 0.01).successful
    assert change("identifier", "projection", "off").successful
    refused = change("controller", "rate", "fast")
    assert not refused.successful
    assert "allowed: fixed, lyapunov, lyapunov-groups" in refused.reason
    assert not change("controller", "hbar", -1.0).successful
    assert not change("controller", "width", 2.0).successful  # where it starts from is past
    assert not change("identifier", "identifier_weight", 2.0).successful


def test_unstable_run_with_identifier_ends_where_the_in_process_run_ends(tmp_path: Path) -> None:
    sets = [*HBSWC, "controllers.0.parameters.weight=0", "controllers.0.parameters.eta=0", "frame_rate=30"]
    assert not as_in_process(tmp_path, load_case(None, sets)).in_synchronism[-1]


@pytest.mark.parametrize("loss", ["", ", {model: bernoulli, loss: 0.1}"])
def test_graph_with_prediction_is_the_in_process_run_bit_for_bit(tmp_path: Path, loss: str) -> None:
    link = f"link.up=[{{delay: 0.1}}{loss}]"
    case = load_case(
        None, [*HBSWC, "controllers.0.compensation=prediction", link, "link.down=[{delay: 0.1}]", "duration=3"]
    )
    estimates = as_in_process(tmp_path, case).estimates
    assert np.isfinite(estimates["change"]).mean() > 0.8
    assert np.any(estimates["change"] != 0.0)
    assert estimates["ahead"] == pytest.approx(0.2)
