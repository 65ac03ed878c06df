"""Rows of studies: the columns that are written give the same row again."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import pytest

from facts_damping_studies.campaigns.actions import Actions
from facts_damping_studies.campaigns.draw_rows import DrawnFault, DrawRow, GraphRun, GraphStart, Intervention, Law
from facts_damping_studies.campaigns.hunt_rows import HuntRow, read_hunt
from facts_damping_studies.campaigns.invariants import Effect
from facts_damping_studies.sweeps.sweep_rows import HalfStep, Interarea, SweepRow, figure_names

if TYPE_CHECKING:
    from facts_damping_studies.rows import Row

COLUMNS = {"system": "two_area", "seed": 0, "delay": 0.1}
FAILED = SweepRow(COLUMNS, error="no case")
FIGURES = dict.fromkeys(figure_names(modes=False), 0.5)
SOUND = SweepRow.read({**COLUMNS, "horizon_s": 4.0, **FIGURES, "error": None})
CHECKED = replace(
    SOUND,
    half_step=HalfStep(True, 0.0, "damped"),
    interarea=Interarea(None, None),
    asked={"ITAE_ratio": None, "right_sign.speed/sssc": 1.0},
)
DRAWN = DrawnFault("smib", "lost", "path", wrong=False, start_s=1.0, labels={"mode": "a", "link": "b", "lasts": ""})
UNMADE = DrawRow(3, error="no draw")
DRAW = replace(UNMADE, error=None, drawn=DRAWN, law=Law("LLC", None), horizon_s=3.0)
JUDGED = replace(DRAW, judgement=Intervention(Actions(), Effect(lost_s=2.0), released=True, alone={"lets_go": False}))
RAN = GraphRun(None, None, 1.0, 0, [], 0, 0, [], {"recorded": True, "as_computed": None})
GRAPH = replace(JUDGED, graph=True, horizon_s=None, graph_start=GraphStart("lockstep", ""), graph_run=RAN)
HUNTED = HuntRow("hunted", 4, [0.1, 0.2], None, {"lets_go": None}, "what", DRAWN, took_s=0.1, at_s=0.0)


@pytest.mark.parametrize(
    "row", [FAILED, SOUND, CHECKED, UNMADE, DRAW, replace(DRAW, error="dead", law=Law("", None)), JUDGED, HUNTED,
            replace(JUDGED, unsupervised=Effect(ratio=2.0).controlled)]
)  # fmt: skip
def test_row_is_read_again_as_it_was(row: Row) -> None:
    """Also with a list of labels that is named as a column of graphs."""
    cells: dict[str, Any] = json.loads(json.dumps(row.cells))
    again = read_hunt(cells) if isinstance(row, HuntRow) else type(row).read(cells)
    assert again == row
    assert json.dumps(again.cells) == json.dumps(row.cells)


def test_graph_is_read_again_as_it_was() -> None:
    graph = replace(GRAPH, drawn=DRAWN._replace(labels={"link": "b", "lasts": "2"}))
    assert DrawRow.read(json.loads(json.dumps(graph.cells))) == graph
    assert list(graph.cells)[:3] == ["number", "graph", "error"]


def test_column_that_a_figure_replaces_is_the_figure_s() -> None:
    row = replace(SOUND, columns={**COLUMNS, "duration_s": 9.0})
    again = SweepRow.read(json.loads(json.dumps(row.cells)))
    assert again.figures == row.figures
    assert again.columns["duration_s"] == 0.5
    assert list(again.cells) == list(row.cells)


def test_columns_have_the_order_of_the_table() -> None:
    assert list(FAILED.cells) == [*COLUMNS, "error"]
    checks = [*HalfStep._fields, *Interarea._fields, "ITAE_ratio", "right_sign.speed/sssc"]
    assert list(CHECKED.cells) == [*COLUMNS, "horizon_s", *figure_names(modes=False), *checks, "error"]
