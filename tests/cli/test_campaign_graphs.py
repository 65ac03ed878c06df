"""Draws of a campaign as real graphs."""

from __future__ import annotations

from typing import TYPE_CHECKING

from facts_damping.output.terminal import Progress
from facts_damping_studies.campaigns import campaign
from facts_damping_studies.campaigns import graphs as campaign_graphs
from facts_damping_studies.campaigns.invariants import INVARIANTS

if TYPE_CHECKING:
    from pathlib import Path

    import pytest

CAMPAIGN = """
seed: 6
draws: 1
graphs: 2
graph_duration: 4
base_runs: {smib: {run: smib_supervised, choose: {link: {ideal: {link: ideal}, late: {link: delay_100ms}}}}}
faults: {biased: 1, hung: 1}
window: [1, 2]
"""


def test_graphs_are_made_once_and_hold(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "small.yaml").write_text(CAMPAIGN)
    plan, out = campaign.plan(str(tmp_path / "small.yaml")), tmp_path / "out"
    rows = campaign_graphs.graphs(plan, out, 2, Progress("test", "graphs"))
    assert [(row.number, row.graph, row.error) for row in rows] == [(0, True, None), (1, True, None)]
    assert {row.cells["fault"]: row.cells["mode"] for row in rows} == {"biased": "lockstep", "hung": "realtime"}
    assert all(isinstance(row.invariants[name], bool) for row in rows for name in INVARIANTS)
    same = {row.cells["mode"]: row.invariants["as_computed"] for row in rows}
    assert same == {"lockstep": True, "realtime": None}
    assert all(row.invariants[name] for row in rows for name in ("recorded", "within_limits", "lets_go"))

    def never(*_: object) -> None:
        raise AssertionError

    monkeypatch.setattr(campaign_graphs, "one_graph", never)
    assert campaign_graphs.graphs(plan, out, 2, Progress("test", "graphs")) == rows


def test_draw_without_its_fault_is_the_same_otherwise(tmp_path: Path) -> None:
    (tmp_path / "small.yaml").write_text(CAMPAIGN)
    plan = campaign.plan(str(tmp_path / "small.yaml"), ["frame_rate=50"])
    for number in range(4):
        drawn = campaign.draw(plan, number, real=True)
        case, healthy = campaign.case_of(plan, drawn), campaign.case_of(plan, campaign.healthy(plan, drawn))
        assert (case.run.seed, case.duration, case.run.frame_rate) == (healthy.run.seed, 4.0, 50)
        assert healthy.run.controllers[0].faults == []
        assert [type(stage) for stage in healthy.link.up] == [
            type(stage) for stage in case.link.up[: len(healthy.link.up)]
        ]
