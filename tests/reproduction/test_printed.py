"""The thesis's figures as data: whole, as printed, and its slips."""

from __future__ import annotations

import csv
import shutil
from collections import Counter
from typing import TYPE_CHECKING

import numpy as np
import pytest

from facts_damping.analysis.indices import INDICES
from facts_damping.errors import InputError
from facts_damping.neurofuzzy.table import VARIANTS
from facts_damping.parameters.files import shipped
from facts_damping_reproduction import printed
from facts_damping_reproduction.printed import (
    DIRECT,
    LLC,
    TABLES,
    Cell,
    ControllerId,
    cells,
    folder,
    inconsistent,
    operations,
)

if TYPE_CHECKING:
    from pathlib import Path

IMPROVEMENTS = ("4.1", "4.2", "5.1", "5.3", "6.2")
Key = tuple[str, str, str, str]


def pair(cell: Cell) -> Key:
    """A cell and its partner: table, scenario, controller, index."""
    return cell.table, cell.scenario, cell.controller, cell.quantity


def cell_of(table: str, scenario: str, who: ControllerId, quantity: str, against: ControllerId | None = None) -> Cell:
    """The only cell of a place."""
    (cell,) = [
        c for c in cells((table,)) if (c.scenario, c.who, c.quantity, c.against) == (scenario, who, quantity, against)
    ]
    return cell


def test_printed_cells_have_distinct_places_and_known_names() -> None:
    printed_cells = cells()
    assert len(printed_cells) == sum(table.figures for table in TABLES.values())
    assert len({c[:8] for c in printed_cells}) == len(printed_cells)
    assert {c.controller for c in printed_cells} == {"LLC", *VARIANTS}
    assert {c.quantity for c in printed_cells} == {*INDICES, "roughness"}
    assert {f"{c.system}/{c.scenario}" for c in printed_cells} <= set(shipped("scenarios"))
    assert all((c.scheme is None) == (c.controller == "LLC") for c in printed_cells)
    assert all((c.against is None) == (c.quantity == "roughness") for c in printed_cells)
    assert all(c.who != c.against for c in printed_cells)
    assert all(float(f"{c.printed:.{c.decimals}f}") == c.printed for c in printed_cells)


def test_figures_stand_where_they_are_printed() -> None:
    direct, hbs = ControllerId("MISO", "ANFBsC", "direct"), ControllerId("MIMO", "HBsWC", "indirect")
    assert cell_of("4.1", "light", direct, "ITAE", DIRECT).printed == 26.56
    assert cell_of("4.1", "light", DIRECT, "ISE", LLC).printed == -3.296
    assert cell_of("4.1", "light", DIRECT, "IAE", LLC).decimals == 3
    assert cell_of("5.1", "multiple", ControllerId("MISO", "HBsWC", "indirect"), "ISE", LLC).printed == 46.48
    assert cell_of("5.2", "multiple", ControllerId("MISO", "ANFGuMeC", "indirect"), "roughness").printed == 11704
    assert cell_of("5.4", "large", LLC, "roughness").printed == 10829
    assert cell_of("6.1", "multiple", hbs, "roughness").printed == 26.24
    assert cell_of("6.1", "large", ControllerId("MIMO", "LLC", None), "roughness").printed == 275.66
    assert cell_of("6.2", "large", hbs, "IAE", DIRECT).printed == 53.56
    assert cell_of("6.2", "small", ControllerId("MIMO", "LLC", None), "ISE", LLC).printed == 1.826


def test_miso_columns_of_6_1_repeat_5_4() -> None:
    figures = {(c.scenario, c.who): c.printed for c in cells(("5.4",))}
    repeated = [c for c in cells(("6.1",)) if c.architecture == "MISO"]
    assert len(repeated) == 21
    assert all(figures[c.scenario, c.who] == c.printed for c in repeated)


def test_roughness_in_the_text_of_the_thesis_agrees_with_its_tables() -> None:
    """11.48 % of HBsWC over ANFLeWC (6.5); 99.64 and 99.61 % of ANFGuMeC and HBsWC by indirect control (5.4.2)."""

    def reduced(a: Cell, b: Cell) -> float:
        return round(100 * (a.printed - b.printed) / a.printed, 2)

    mimo = [
        cell_of("6.1", "small", ControllerId("MIMO", name, "indirect"), "roughness") for name in ("ANFLeWC", "HBsWC")
    ]
    assert reduced(*mimo) == 11.48
    for name, percent in (("ANFGuMeC", 99.64), ("HBsWC", 99.61)):
        both = [cell_of("5.4", "small", ControllerId("MISO", name, s), "roughness") for s in ("direct", "indirect")]
        assert reduced(*both) == percent


def test_corrections_are_a_cell_of_each_pair_that_contradicts_itself_and_no_other() -> None:
    printed_cells = cells()
    broken = [pair(b.over_anftsc) for b in inconsistent(printed_cells)]
    corrected = Counter(pair(c) for c in printed_cells if c.reason)
    assert corrected == Counter(broken)
    assert len(broken) == 25
    assert all(c.printed == c.corrected for c in printed_cells if not c.reason)


@pytest.mark.parametrize("table", IMPROVEMENTS)
def test_after_correction_no_pair_contradicts_itself(table: str) -> None:
    printed_cells = cells((table,))
    assert inconsistent(printed_cells, corrected=True) == []
    slips = {"4.1": 4, "4.2": 4, "5.1": 11, "5.3": 4, "6.2": 2}
    assert len(inconsistent(printed_cells)) == slips[table]


def test_misprint_of_one_digit_is_found_alone() -> None:
    consistent = [c._replace(printed=c.corrected) for c in cells()]
    assert inconsistent(consistent) == []
    for i, cell in enumerate(consistent):
        if cell.against == DIRECT and i % 40 < 2:
            changed = [*consistent[:i], cell._replace(printed=cell.printed + 1), *consistent[i + 1 :]]
            assert [pair(b.over_llc) for b in inconsistent(changed)] == [pair(cell)]


def test_rounding_alone_is_no_contradiction() -> None:
    """Improvements of indices that are drawn, rounded to one to three decimals."""
    rng = np.random.default_rng(1)
    printed_cells = cells(("4.1", "5.1"))
    index = {pair(c): rng.uniform(0.05, 1.1) for c in printed_cells}
    rows = []
    for cell in printed_cells:
        direct = index["4.1", cell.scenario, "ANFTSC", cell.quantity]
        decimals = int(rng.integers(1, 4))
        value = 100 * (1 - index[pair(cell)] / (direct if cell.against == DIRECT else 1.0))
        rows.append(cell._replace(printed=round(value, decimals), decimals=decimals))
    assert inconsistent(rows) == []
    broken = [row._replace(printed=row.printed + 0.5 * rng.choice([-1, 1])) for row in rows]
    assert len(inconsistent(broken)) > 300


def test_table_3_1_has_its_rows() -> None:
    rows = operations()
    assert [row.controller for row in rows] == list(VARIANTS)
    assert rows[2] == ("ANFFsC", 58, 63, 114, 5, 4, 8)
    assert rows[-2].exponentials == 0


@pytest.fixture
def copy(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The files in a folder where they may be damaged."""
    copied = tmp_path / "thesis"
    shutil.copytree(folder(), copied)
    monkeypatch.setattr(printed, "folder", lambda: copied)
    return copied


@pytest.mark.parametrize(
    ("file", "old", "new", "said"),
    [
        ("table_4_1.csv", "I,ANFTSC,,,,,47.01", "I,ANFTSC,,,,,", "335 figures given; allowed: the 336 of the table"),
        ("table_4_1.csv", "47.01", "4x.01", "ITAE_vs_LLC: '4x.01' given; allowed: a number"),
        ("table_4_1.csv", "47.01", "nan", "ITAE_vs_LLC: 'nan' given; allowed: a number"),
        ("table_4_1.csv", "47.01,", "", "line 2: 9 fields given; allowed: 10"),
        ("table_4_1.csv", "scenario,", "", "header controller,ITAE_vs_ANFTSC"),
        ("table_4_1.csv", "II,ANFLeC", "II,ANFLeX", "controller: 'ANFLeX' given (did you mean ANFLeC?); allowed: LLC"),
        ("table_4_2.csv", "III,ANFLeC", "IV,ANFLeC", "scenario: 'IV' given; allowed: I, II, III"),
        ("table_4_1.csv", "II,ANFLeC", "II,ANFBsC", "figures given; allowed: the 336 of the table"),
        ("table_5_2.csv", "1170.2", "", "91 figures given; allowed: the 92"),
        ("table_3_1.csv", "ANFSC", "ANFTSC", "rows of ANFTSC, ANFTSC, ANFFsC"),
        (
            "corrections.csv",
            "31.79",
            "31.78",
            "4.1 II ANFBsC ITSE_vs_LLC: 31.78 given; allowed: the printed figure (31.79)",
        ),
        ("corrections.csv", "4.1,II", "4.9,II", "table: '4.9' given; allowed: 4.1"),
    ],
)
def test_damaged_file_is_one_line(copy: Path, file: str, old: str, new: str, said: str) -> None:
    text = (copy / file).read_text()
    assert old in text
    (copy / file).write_text(text.replace(old, new, 1))
    with pytest.raises(InputError) as error:
        cells() and operations()
    assert said in str(error.value)
    assert str(copy / file) in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("content", [None, b"", b"\xff\xfe\x00", b'"open'])
def test_file_that_cannot_be_read_is_one_line(copy: Path, content: bytes | None) -> None:
    path = copy / "table_5_3.csv"
    path.unlink() if content is None else path.write_bytes(content)
    with pytest.raises(InputError, match=r"table_5_3\.csv") as error:
        cells()
    assert "\n" not in str(error.value)


def test_unknown_table_is_one_line() -> None:
    with pytest.raises(InputError, match=r"table: '4\.3' given; allowed: 4\.1, 4\.2"):
        cells(("4.3",))


def test_corrections_have_two_decimals_and_a_reason() -> None:
    with (folder() / "corrections.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 25
    assert all(len(row["corrected"].partition(".")[2]) == 2 and row["reason"] for row in rows)
