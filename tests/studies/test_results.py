"""Tables of margins, from margins that are made up."""

from __future__ import annotations

from typing import Any

import numpy as np

from facts_damping_studies.margins.margins import OverSeeds
from facts_damping_studies.sweeps.margin_plots import plot_margins
from facts_damping_studies.sweeps.results import margin_table
from facts_damping_studies.sweeps.sweep_rows import MarginRow


def margin(
    criterion: str, scenario: str, link: str, controller: str, at: float, holds: float = 0.5, **more: Any
) -> MarginRow:
    place = {"scenario": scenario, "link": link, "controller": controller, "scheme": None, "horizon_s": 20.0}
    reached = OverSeeds(at, at - 0.01, at + 0.01, 1, True, [], None, None, "delay_s")._replace(**more)
    return MarginRow(place, criterion, reached, holds, [])


MARGINS = [
    margin(criterion, scenario, link, controller, base + more)
    for scenario, base in (("small", 0.5), ("large", 0.3))
    for link, more in (("fibre", 0.1), ("plc", 0.0))
    for controller, criterion in (("A", "unstable"), ("A", "not_damped"), ("B", "unstable"), ("B", "not_damped"))
]


def blocks(lines: list[str]) -> list[list[str]]:
    """Titles and rows of the tables, without the lines below their heads."""
    text = "\n".join(lines).split(" s:\n\n")
    titles = [part.splitlines()[-1] for part in text[:-1]]
    tables = [[row for row in part.split("\n\n")[0].splitlines() if "---" not in row] for part in text[1:]]
    return [[title, *table] for title, table in zip(titles, tables, strict=True)]


def test_scenarios_stand_side_by_side_unless_another_column_does() -> None:
    tables = blocks(margin_table(MARGINS, "scenario"))
    assert [title for title, *_ in tables] == ["unstable, delay_s, horizon 20", "not_damped, delay_s, horizon 20"]
    assert tables[0][1] == "| link | controller | small [low, high] | large [low, high] |"
    assert len(tables[0]) == 2 + 4

    tables = blocks(margin_table(MARGINS, "link"))
    assert [title for title, *_ in tables] == [
        f"{criterion}, {scenario}, delay_s, horizon 20"
        for criterion in ("unstable", "not_damped")
        for scenario in ("small", "large")
    ]
    assert tables[1][1:] == [
        "| controller | fibre [low, high] | plc [low, high] |",
        "| A | 0.400 [0.39, 0.41] | 0.300 [0.29, 0.31] |",
        "| B | 0.400 [0.39, 0.41] | 0.300 [0.29, 0.31] |",
    ]


def test_margin_table_begins_with_the_largest_and_marks_open_margins() -> None:
    rows = [
        margin("unstable", "small", "fibre", "A", 0.2, monotonic=False, holds_again=[0.6, 0.7], holds=0.3),
        margin("unstable", "small", "plc", "A", 0.1),
        margin("unstable", "small", "fibre", "B", 0.9, margin_s=None, low_s=1.0, high_s=None, beyond="high"),
    ]
    ((_, _, first, second),) = blocks(margin_table(rows, "link"))
    assert first == "| B | > 1 |  |"
    assert second == "| A | 0.200 [0.19, 0.21] * 30 % | 0.100 [0.09, 0.11] |"


def test_picture_has_a_panel_for_each_place_and_a_diamond_also_where_it_fails_at_once() -> None:
    at_once = margin("not_damped", "large", "plc", "C", 0.0, margin_s=None, low_s=None, high_s=0.0, beyond="low")
    figure = plot_margins([*MARGINS, margin("unstable", "large", "plc", "C", 0.2), at_once], "link")
    titles = [axes.get_title() for axes in figure.axes]
    assert titles == [f"{s}, {link}, horizon 20 s" for s in ("small", "large") for link in ("fibre", "plc")]
    diamonds = [line for line in figure.axes[-1].lines if line.get_marker() == "D"]
    assert sorted(np.concatenate([np.asarray(line.get_xdata(), float) for line in diamonds])) == [0.0, 0.3, 0.3]
