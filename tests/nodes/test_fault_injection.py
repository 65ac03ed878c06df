"""Faults of campaigns in graphs, on the loopback.

Over DDS: killed processes in `test_kills.py`, cases of a campaign in `tests/cli/test_campaign_graphs.py`.
"""

from __future__ import annotations

from contextlib import ExitStack
from typing import TYPE_CHECKING, Any

import pytest

from facts_damping.case.loading import load_case
from facts_damping.errors import RunError
from facts_damping.nodes.launching import processes
from facts_damping.parameters.security import add_key
from facts_damping.simulation import loop
from facts_damping_studies.campaigns import fault_injection
from facts_damping_studies.campaigns import graphs as campaign_graphs
from facts_damping_studies.campaigns.fault_injection import LOCKSTEP, REALTIME, GraphFault, run_with_fault
from facts_damping_studies.campaigns.invariants import alone, late_ticks
from tests.nodes.graphs import PATIENCE_S, assert_let_go, nodes_left

if TYPE_CHECKING:
    from pathlib import Path

RUN = "two_area_supervised"
NOTHING = GraphFault("", 0.0, None)


def test_simulated_fault_gives_the_bits_of_the_in_process_run(loopback: Any, tmp_path: Path) -> None:
    case = load_case(RUN, ["duration=3", "controllers.0.faults=[{kind: wrong_sign, start: 1.5}]"])
    faulted = run_with_fault(case, LOCKSTEP, tmp_path, NOTHING, 0)
    computed = loop.run(case)
    assert campaign_graphs.as_computed(case, faulted, computed, False, "")
    assert campaign_graphs.recorded(case, faulted, computed, False, "")
    assert (faulted.begun_s, faulted.forged) == (None, {})


def test_without_its_supervisor_the_device_lets_go(loopback: Any, tmp_path: Path) -> None:
    case = load_case(RUN, ["duration=3"])
    faulted = run_with_fault(case, REALTIME, tmp_path, GraphFault("kill supervisor", 1.5, None), 0)
    assert faulted.outcome.fallen == ["supervisor_0_LLC was killed by SIGKILL"]
    assert faulted.begun_s == pytest.approx(1.5, abs=0.3)
    misses = faulted.outcome.deadline_misses
    assert_let_go(case, faulted.record, misses)
    assert all(alone(case, faulted.record, late_ticks(faulted.record, misses)).values())
    assert campaign_graphs.recorded(case, faulted, faulted.record, True, "kill")
    assert not campaign_graphs.recorded(case, faulted, faulted.record, True, "")


def test_message_forged_with_the_key_of_the_graph_changes_no_bit(loopback: Any, tmp_path: Path) -> None:
    keys = tmp_path / "keys.yaml"
    add_key(keys)
    case = load_case(RUN, ["duration=3", f"security.keys={keys}", "controllers.0.name=ANFLeC"])
    faulted = run_with_fault(case, LOCKSTEP, tmp_path / "out", GraphFault("forge signed", 1.5, None), 0)
    computed = loop.run(case)
    assert campaign_graphs.as_computed(case, faulted, computed, False, "forge")
    assert campaign_graphs.nothing_forged_acts(case, faulted, computed, False, "forge")
    assert faulted.forged["supervisor_0_ANFLeC/supervised"] == faulted.forged["pmu/frames"] == 30


def test_graph_ends_when_it_is_not_wanted_any_more(
    domain: int, tmp_path: Path, started: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(processes, "STOP_S", PATIENCE_S)
    with pytest.raises(RunError, match="interrupted"):
        run_with_fault(load_case(RUN, ["duration=1000"]), LOCKSTEP, tmp_path, NOTHING, domain, lambda: False)
    assert {node.process.exitcode for node in started.values()} == {0}
    assert nodes_left(tmp_path) == []


def test_graphs_have_ros_domains_of_their_own() -> None:
    with ExitStack() as reserved:
        domains = [reserved.enter_context(fault_injection.own_domain()) for _ in range(2)]
        assert len(set(domains)) == 2
        assert set(domains) <= set(fault_injection.DOMAINS)
