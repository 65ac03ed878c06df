"""Tables as text fit a terminal, and equal lines are one."""

from __future__ import annotations

from facts_damping.output.tables import WIDEST, table, with_counts

HISTORY = "; ".join(f"armed at {i:.2f} s" for i in range(20))


def test_wide_table_is_wrapped_and_loses_no_word() -> None:
    lines = table(["", "a run of a long name " * 5, "b"], [["history", HISTORY, "-"], ["ITAE", "0.1", "0.2"]])
    assert max(map(len, lines)) <= WIDEST
    assert " ".join(" ".join(lines).split()).count("armed at") == 20
    rule = next(i for i, line in enumerate(lines) if line.startswith("---"))
    assert [line.split()[0] for line in lines[rule + 1 :] if not line.startswith(" ")] == ["history", "ITAE"]


def test_table_that_fits_has_a_line_for_each_row() -> None:
    assert table(["", "a"], [["x", "1"], ["y", "22"]]) == ["    a", "-  --", "x   1", "y  22"]


def test_equal_lines_are_one_with_their_number() -> None:
    assert with_counts(["GMIN is raised", "other", "GMIN is raised"]) == ["GMIN is raised (2 times)", "other"]


def test_empty_cells_columns_and_rows_stay() -> None:
    rows = [["x", "1", ""], ["", "", ""], ["y", "2", ""]]
    assert table(["a", "b", ""], rows, rule=False) == ["a  b", "x  1", "", "y  2"]
