"""Records of PSS/E files are the same in whatever legal way they are written; all that is wrong is told at once."""

from __future__ import annotations

import math
import re
from typing import TYPE_CHECKING, Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from facts_damping.cli.main import main
from facts_damping.errors import InputError
from facts_damping_grids.psse.conversion import import_case
from facts_damping_grids.psse.reading import read_dyr, read_raw
from facts_damping_grids.psse.records import columns_of, row
from tests.grids.test_psse import DYR, RAW, imported, raw_with, voltages

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

# One record

NUMBERS = st.one_of(
    st.integers(-99999, 99999).map(float), st.floats(-1e6, 1e6).map(lambda x: float(f"{x:.6g}")), st.just(0.0)
)
NAMES = st.text("ABCxyz019 /,.&~-", max_size=12).map(str.strip)


@st.composite
def written_values(draw: st.DrawFn, values: list[float | str | None]) -> str:
    """Values as a record: blanks, tabs or commas between them, numbers and text in any form, None as nothing."""
    commas = [",", ", ", " , ", "\t,"]
    text = draw(st.sampled_from(["", " ", "   ", "\t"]))
    for i, value in enumerate(values):
        if i > 0:
            text += draw(st.sampled_from(commas if None in values[i - 1 : i + 1] else [*commas, " ", "\t"]))
        text += _written(draw, value)
    end = ["," if values[-1] is None else "", ", ", " / end, 'of' it", "/", "\t/ 5 'x"]
    return text + draw(st.sampled_from(end))


def _written(draw: st.DrawFn, value: float | str | None) -> str:
    if value is None:
        return ""
    if isinstance(value, str):
        quote = draw(st.sampled_from("'\""))
        return f"{quote}{' ' * draw(st.integers(0, 2))}{value}{' ' * draw(st.integers(0, 4))}{quote}"
    forms = [repr(value), f"{value:.9E}", f"{value:.9E}".replace("E", "D"), f"{value:+.9e}".replace("e", "d")]
    return draw(st.sampled_from([*forms, *([f"{value:.0f}"] if value.is_integer() else [])]))


@settings(max_examples=150, deadline=None)
@given(st.data())
def test_record_is_the_same_in_whatever_way_it_is_written(data: st.DataObject) -> None:
    """Behind a value that is not given stands a comma, since a blank would have the next one in its place."""
    section, version = data.draw(
        st.sampled_from([("bus", 33), ("bus", 23), ("generator", 35), ("branch", 34), ("load", 34)])
    )
    columns = columns_of(section, version)
    values: list[float | str | None] = []
    expected: dict[str, object] = {}
    for column in columns.split():
        name, _, default = column.partition("=")
        text = name in ("NAME", "ID", "CKT")
        value: Any = data.draw(NAMES if text else st.integers(1, 999999).map(float) if name in ("I", "J") else NUMBERS)
        absent = "=" in column and data.draw(st.booleans())
        values.append(None if absent else value)
        expected[name] = (default if text else float(default)) if absent else value if value != "" else default
    while values and values[-1] is None and data.draw(st.booleans()):
        values.pop()  # what is missing at the end is the default, too
    problems: list[str] = []
    assert row(columns, data.draw(written_values(values)), "here", problems) == expected
    assert problems == []


@pytest.mark.parametrize(
    ("line", "name"),
    [
        ("7,'O'BRIEN / 2, A',138", "O'BRIEN / 2, A"),
        ("7,'O''BRIEN',138", "O'BRIEN"),
        ("7 'it''s' 138", "it's"),
        ("7, NORTH, 138", "NORTH"),
        ('7, "A, B/C" 138', "A, B/C"),
        ("7,'',138", ""),
    ],
)
def test_names_with_quotes_slashes_and_commas(line: str, name: str) -> None:
    problems: list[str] = []
    read = row(columns_of("bus", 33), line, "here", problems)
    assert (read["NAME"], read["BASKV"], problems) == (name, 138.0, [])


# RAW


def as_23(text: str) -> str:
    """The case as version 23 writes it: loads and shunts at buses, transformers as branches with a ratio."""
    lines = text.splitlines()
    section, tables = "bus", dict[str, list[list[str]]]()
    for line in lines[3:]:
        if line.startswith("0 /"):
            section = "".join(re.findall(r"BEGIN (.*) DATA", line)).lower()
        elif line != "Q":
            tables.setdefault(section, []).append(line.split(","))
    loads = {values[0]: values[5:7] for values in tables["load"]}
    written = ["0  100.000", "", ""]
    for n, name, kV, kind, area, _zone, _owner, VM, VA, *_ in tables["bus"]:
        written.append(",".join([n, kind, *loads.get(n, ["0", "0"]), "0", "0", area, VM, VA, name, kV, "1"]))
    written += ["0", *(",".join(values[:18]) for values in tables["generator"]), "0 / END OF GENERATOR DATA"]
    for values in tables["branch"]:
        written.append(",".join([*values[:9], "0", "0", *values[9:14]]))
    quadruples = [tables["transformer"][i : i + 4] for i in range(0, len(tables["transformer"]), 4)]
    for ends, impedance, winding, _ in quadruples:
        written.append(
            ",".join([ends[0], f"-{ends[1]}", "'T '", *impedance[:2], "0,0,0,0", winding[0], winding[2], "0,0,0,0,1"])
        )
    return "\n".join([*written, "0 / END OF BRANCH DATA", "0", "0", "0", "8,0,1.1,0.9,0,25,1,25", "0"])


def test_version_23_is_the_same_grid(tmp_path: Path) -> None:
    """It has no version in its head; its switched shunts have fewer columns."""
    shunt = ("^0 / END OF SWITCHED", "8,1,0,1,1,1,0,100,' ',25\n0 / END OF SWITCHED")
    (tmp_path / "a").mkdir()
    modern = imported(tmp_path / "a", raw_with(shunt), DYR.read_text())
    old = imported(tmp_path, as_23(raw_with(shunt)), DYR.read_text())
    assert voltages(old) == pytest.approx(voltages(modern), abs=1e-12)
    assert [m.model_dump() for m in old.machines] == [m.model_dump() for m in modern.machines]
    assert len(old.transformers) == 3


def test_charging_of_a_transformer_of_version_23_is_that_of_its_two_port(tmp_path: Path) -> None:
    """Both halves are behind the ratio, as that of a line with an ideal transformer at its first bus."""
    text = as_23(RAW.read_text()).replace("1,-4,'T ',0,0.0576,0,0,0,0,1,0", "1,-4,'T ',0,0.0576,0.2,0,0,0,1.05,5")
    system = imported(tmp_path, text)
    assert {s.name: pytest.approx(s.Q) for s in system.shunts} == {
        "fixed_1_T14": 10.0 / 1.05**2,
        "fixed_4_T14": 10.0,
        "switched_8": 25.0,
    }
    (transformer,) = (t for t in system.transformers if t.name == "T1_4_T")
    assert (transformer.tap, transformer.phase_shift) == (1.05, 5.0)


HEADS: list[tuple[str, Callable[[str], str]]] = [
    ("version in the comment", lambda t: t.replace("0, 100.0, 33, 0, 1, 60.0 /", "0,  100.000\t\t / PSS/E-33.2 ")),
    (
        "version in another comment",
        lambda t: t.replace("100.0, 33, 0, 1, 60.0 /", "100.0 / PSS(R)E 33 RAW created by x"),
    ),
    ("blanks", lambda t: t.replace("0, 100.0, 33, 0, 1, 60.0 /", "  0   100 33 / ")),
    (
        "lines of comments",
        lambda t: "@!IC,SBASE,REV\n" + t.replace("0 / END OF BUS", "@! x\n/ a comment\n\n// b\n 0 /END OF BUS"),
    ),
    ("no more than is needed", lambda t: t.split("0 / END OF AREA")[0]),
    ("end of the file in time", lambda t: t.split("0 / END OF AREA")[0] + " Q \nanything, 'at' all"),
    ("Windows", lambda t: t.replace("\n", "\r\n")),
]


@pytest.mark.parametrize("change", [change for _, change in HEADS], ids=[name for name, _ in HEADS])
def test_heads_comments_and_ends_of_a_raw_file(change: Callable[[str], str], tmp_path: Path) -> None:
    (tmp_path / "case.raw").write_bytes(change(RAW.read_text()).encode())
    case, plain = read_raw(tmp_path / "case.raw"), read_raw(RAW)
    assert (case.version, case.base_power, case.frequency) == (33, 100.0, 60.0)
    for section, rows in plain.tables.items():
        assert [r | {"line": 0} for r in case.tables[section]] == [r | {"line": 0} for r in rows], section


def test_raw_without_a_version_anywhere_is_refused_with_those_allowed(tmp_path: Path) -> None:
    (tmp_path / "case.raw").write_text(RAW.read_text().replace("0, 100.0, 33, 0, 1, 60.0", "0, 100.0"))
    with pytest.raises(InputError, match="line 1: REV, the version: none given; allowed: 23, 32, 33, 34, 35"):
        read_raw(tmp_path / "case.raw")


def test_switches_and_generation_at_loads_of_version_34(tmp_path: Path) -> None:
    """A closed switch joins buses as a zero-impedance line does; the threshold is that of the file."""
    text = RAW.read_text().replace(", 33,", ", 34,", 1)
    head, buses = text.split("\n1,'BUS 1", 1)
    buses = "1,'BUS 1" + buses.replace("0 / END OF BUS", "10,'NEW',230,1\n11,'OPEN',230,4\n0 / END OF BUS")
    buses = re.sub("5,'1 ',1,1,1,125,50,0,0,0,0,1,1,0", "10,'1 ',1,1,1,130,51,0,0,0,0,1,1,0,5,1,1", buses)
    buses = re.sub(r"^(\d,\d,'1 ',[\d.]+,[\d.]+,[\d.]+),0,0,0", rf"\1,'name'{',0' * 12}", buses, flags=re.MULTILINE)
    switches = f"5,10,'@1',0.0004{',0' * 12},1\n5,11,'@1',0.0004{',0' * 12},0\n0 / END OF SWITCHES"
    buses = buses.replace("0 / END OF BRANCH DATA", f"0 / END OF BRANCH DATA\n{switches}")
    system = imported(tmp_path, f"{head}\nGENERAL, THRSHZ=0.0005, PQBRAK=0.7\n0 / END OF SYSTEM-WIDE\n{buses}")
    (tmp_path / "a").mkdir()
    plain = voltages(imported(tmp_path / "a", RAW.read_text()))
    assert voltages(system)["B10"] == pytest.approx(plain["B5"], abs=1e-4)
    assert [line.name for line in system.lines if line.name.startswith("switch")] == ["switch_5_10"]


def test_all_that_is_wrong_is_told_at_once(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Unreadable values of both files, buses that are not there, and what no equation can be made of."""
    raw = raw_with(
        ("^2,'BUS 2       ',18,2", "2,'BUS 2       ',18,two"),
        ("^5,'1 ',1,1,1,125", "55,'1 ',1,1,1,125"),
        ("^4,5,'1 ',0.01,0.085", "4,5,'1 ',0.01,0"),
        ("^0,0.0586,100", "0,0.05.86,100"),
        (r"^1,0,0,0,0,0,0,0,1.1(.*\n){2}2,7", "0,0,0,0\n1,0\n2,7"),
    )
    (tmp_path / "case.raw").write_text(raw)
    (tmp_path / "case.dyr").write_text(DYR.read_text() + "2 'IEEEST' 1 5")
    assert main(["import", str(tmp_path / "case.raw"), str(tmp_path / "case.dyr")]) == 2
    errors = capsys.readouterr().err.splitlines()
    for said in (
        "case.raw: line 5: bus: IDE: 'two' given; allowed: a number",
        "case.raw: line 14: load: I = 55 given; allowed: a bus",
        "case.raw: line 23: branch: X = 0 with R = 0.01 given; allowed: ",
        "case.raw: line 30: transformer: WINDV1 = 0 given; allowed: more than 0",
        "case.raw: line 39: transformer: X1: '0.05.86' given; allowed: a number",
        "case.dyr: line 11: \"2 'IEEEST' 1\": not ended; allowed: a record that `/` ends",
    ):
        assert any(said in line for line in errors), said
    assert len(errors) == 6


def test_of_many_problems_the_first_ones_are_told_and_how_many_more(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    shunts = "".join(f"{n},'1 ',1,0,5\n" for n in range(100, 130))
    (tmp_path / "case.raw").write_text(raw_with(("^0 / END OF FIXED", f"{shunts}0 / END OF FIXED")))
    assert main(["import", str(tmp_path / "case.raw")]) == 2
    errors = capsys.readouterr().err.splitlines()
    assert len(errors) == 21
    assert errors[-1] == "facts-damping: and 10 more"


# DYR


MODELS = st.sampled_from(["GENROU", "SEXS", "TGOV1", "USRMDL", "IEEEST"])


@st.composite
def dyr_text(draw: st.DrawFn, records: list[tuple[int, str, str, list[float]]]) -> str:
    """Records in any legal form: over lines, with comments, in lower case, a whole one behind another on a line."""
    text = ""
    for bus, model, machine, values in records:
        name = draw(st.sampled_from([model, model.lower()]))
        words = [str(bus), draw(st.sampled_from([f"'{name}'", f'"{name} "']))]
        words.append(draw(st.sampled_from([machine, f"'{machine}'", f"'{machine} '", f'"{machine}"'])))
        record = "".join(word + draw(st.sampled_from([" ", " , ", ", ", "\t"])) for word in words)
        between = [" ", ",", "\n ", ",\n", "\n@! between\n ", "\n// between\n"]
        record += "".join(_written(draw, value) + draw(st.sampled_from(between)) for value in values) + "/"
        alone = "\n" in record or not text.rpartition("\n")[2].strip(" /")  # a line that begins with `/` is a comment
        text += draw(st.sampled_from(BEHIND if alone else [" ", *BEHIND])) if text else ""
        text += record
    return text + draw(st.sampled_from(BEHIND))


BEHIND = ["\n", " a comment, 'it' is\n", "USRWHT\n", "\n\n/ 5 'GENCLS' 1 1 /\n"]
RECORDS = st.lists(
    st.tuples(
        st.integers(1, 999999), MODELS, st.sampled_from(["1", "A", "G2"]), st.lists(NUMBERS, min_size=1, max_size=6)
    ),
    min_size=1,
    max_size=4,
)


@settings(max_examples=100, deadline=None)
@given(st.data())
def test_dyr_is_the_same_in_whatever_way_it_is_written(
    tmp_path_factory: pytest.TempPathFactory, data: st.DataObject
) -> None:
    records = data.draw(RECORDS)
    path = tmp_path_factory.getbasetemp() / "any.dyr"
    path.write_text(data.draw(dyr_text(records)))
    read = read_dyr(path)
    assert [(r.bus, r.model, r.machine, list(r.values)) for r in read.records] == records
    assert read.unread == []


def test_models_of_users_are_known_by_their_names_and_left_out(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """One whose name is that of a model here is that model: its record has counts before the constants."""
    text = DYR.read_text().replace("3 'SEXS' 1 ", "3 'USRMDL' 1 'SEXS' 4 0 0 6 2 2 ")
    system = imported(
        tmp_path,
        RAW.read_text(),
        text + "2 'USRMDL' 1 'MYPSS' 3 0 1 2 1 1\n 5 0.1 0.2 'A' /\n5 'USRLOD' 1 'CMLD' 12 1 /\n",
    )
    assert [e.model for e in system.exciters if e.machine == "G3"] == ["SEXS"]
    errors = capsys.readouterr().err
    assert "MYPSS: of G2: is not modelled: left out" in errors
    assert "5 'USRLOD' 1 ... is no record of a machine: left out" in errors


def test_constant_that_is_no_number_is_told_of_a_model_that_is_known(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "case.dyr").write_text(DYR.read_text().replace("0.05 9.55", "0.05 1..2", 1))
    assert main(["import", str(RAW), str(tmp_path / "case.dyr")]) == 2
    assert "GENROU: value 5: '1..2' given; allowed: a number" in capsys.readouterr().err


def test_record_without_an_end_ends_where_the_next_begins(tmp_path: Path) -> None:
    path = tmp_path / "case.dyr"
    path.write_text("1 'SEXS' 1 0.1 10\n 100 0.1 0 3\n2 'TGOV1' 1 0.05 0.05 1 0 0.5 3 0 /\n")
    first, second = read_dyr(path).records
    assert (first.values, second.model) == ((0.1, 10.0, 100.0, 0.1, 0.0, 3.0), "TGOV1")


def test_import_is_of_the_files_and_nothing_else() -> None:
    """No value that is not a number comes through."""
    content = import_case(RAW, DYR).content
    numbers = [v for table in content.values() if isinstance(table, list) for r in table for v in r.values()]
    assert not any(isinstance(v, float) and math.isnan(v) for v in numbers)
