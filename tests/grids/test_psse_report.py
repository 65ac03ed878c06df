"""The report of an import: what became of each record of a PSS/E case, as a table, as an error, and what is wrong."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

import pytest

from facts_damping.case.loading import load_system
from facts_damping.cli.main import main
from facts_damping_grids.psse.conversion import import_case
from tests.grids.test_psse import DYR, RAW, raw_with

if TYPE_CHECKING:
    from pathlib import Path

    from facts_damping_grids.psse.report import Records

DC = ("^0 / END OF VSC", "1,2,3\n0 / END OF VSC")
MORE = """\
2 'MAXEX2' 1 0.01 0.05 /
7 'USRMDL' 1 5 /
3 'USRMDL' 1 1 2 /
4 'GENROU' 1 8.0 0.03 0.4 0.05 9.55 0 1.8 1.7 0.3 0.55 0.25 0.2 0 0 /
"""
OFF = "4,'1 ',0,0,0,0,1,0,100,0,0.2,0,0,1,0,100,300,10,1,1"  # a generator out of service


@pytest.fixture
def case(tmp_path: Path) -> tuple[Path, Path]:
    """A case with records that are exact, replaced, left out and idle."""
    raw, dyr = tmp_path / "case.raw", tmp_path / "case.dyr"
    raw.write_text(raw_with(DC, ("^0 / END OF GENERATOR", f"{OFF}\n0 / END OF GENERATOR")))
    dyr.write_text(DYR.read_text().replace("3 'GENROU'", "3 'REGCA1'").replace("0 0 20 0.1", "0 0 20 0.001") + MORE)
    return raw, dyr


def numbers(row: Records) -> tuple[int, int, int, int, int]:
    return row.read, row.exact, row.replaced, row.left_out, row.idle


def test_each_record_is_exact_or_replaced_or_left_out_or_idle(case: tuple[Path, Path]) -> None:
    rows = {row.name: row for row in import_case(*case).records}
    assert {name: numbers(row) for name, row in rows.items() if numbers(row) != (row.read, row.read, 0, 0, 0)} == {
        "VSC dc": (1, 0, 0, 1, 0),
        "generator": (4, 3, 0, 0, 1),
        "GENROU": (3, 2, 0, 0, 1),
        "REGCA1": (1, 0, 1, 0, 0),
        "SEXS": (1, 0, 0, 1, 0),
        "IEEEG1": (1, 0, 1, 0, 0),
        "MAXEX2": (1, 0, 0, 1, 0),
        "USRMDL": (2, 0, 0, 2, 0),
    }
    assert rows["branch"].exact == 6
    assert rows["SEXS"].effects == ("its field voltage stays: voltages sag further and swings are damped otherwise",)


def test_report_is_shown_and_stands_at_the_head_of_the_file(
    case: tuple[Path, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Beside a file on standard output; with the system there, on standard error."""
    assert main(["import", *map(str, case), "--out", str(tmp_path / "case.yaml")]) == 0
    shown = capsys.readouterr()
    assert re.search(r"^USRMDL +2 +0 +0 +2 +0$", shown.out, re.MULTILINE)
    text = (tmp_path / "case.yaml").read_text()
    table = [*shown.out.splitlines(), *(line.removeprefix("facts-damping: ") for line in shown.err.splitlines())]
    assert [line.removeprefix("# ") for line in text.splitlines()[1 : 1 + len(table)]] == table
    assert main(["import", *map(str, case)]) == 0
    again = capsys.readouterr()
    assert again.out == text
    assert again.err == shown.out + shown.err
    assert len(load_system(str(tmp_path / "case.yaml")).machines) == 2


def test_strict_refuses_all_that_is_replaced_or_left_out(
    case: tuple[Path, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "case.yaml"
    assert main(["import", *map(str, case), "--strict", "--out", str(out)]) == 2
    lines = capsys.readouterr().err.splitlines()
    assert not out.exists()
    assert lines[-1] == f"facts-damping: --strict: {len(lines) - 1} replaced or left out given; allowed: none"
    assert [re.findall(r"case\.\w+: line (\d+)", line)[0] for line in lines[:-1]] == [
        *("46", "12", "8", "11", "4", "7", "13"),
    ]
    assert main(["import", str(RAW), str(DYR), "--strict", "--out", str(out)]) == 0


def test_strict_does_not_take_typical_data(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["import", str(RAW), "--strict"]) == 2
    assert "line 19: generator: no dynamic data: typical data of synchronous machines" in capsys.readouterr().err


def test_all_problems_of_records_are_told_at_once(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Each with file and line, of the network, of machines and of controls."""
    raw, dyr = tmp_path / "case.raw", tmp_path / "case.dyr"
    raw.write_text(raw_with(("^4,5,'1 ',0.01,0.085,", "4,5,'1 ',0.01,0,")))
    text = DYR.read_text().replace("9.55 0 1.8", "-9.55 0 1.8").replace("2 'EXST1' 1 ", "1 'EXST1' 1 ")
    dyr.write_text(text.replace("0.4 5.0 20 0.1 -10 10", "0.4 5.0 20 nought -10 10") + "2 'GENROU' 1 1 2 3 /\n")
    assert main(["import", str(raw), str(dyr)]) == 2
    lines = capsys.readouterr().err.splitlines()
    assert [re.sub(r".*/case", "case", line).partition(" given")[0] for line in lines] == [
        "case.raw: line 23: branch: X = 0 with R = 0.01",
        "case.dyr: line 11: GENROU: a second model of machine 1 at bus 2",
        "case.dyr: line 2: GENROU: H = -9.55",
        "case.dyr: line 6: EXST1: G1 has one of the exciters already; allowed: one",
        "case.dyr: line 7: SEXS: value 4: 'nought'",
    ]


def test_problems_of_generators_are_told_beside_those_of_machines(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    raw, dyr = tmp_path / "case.raw", tmp_path / "case.dyr"
    raw.write_text(raw_with(("^3,'1 ',85,0,300,-300,1.025", "3,'1 ',85,0,300,-300,0")))
    dyr.write_text(DYR.read_text().replace("9.55 0 1.8", "-9.55 0 1.8"))
    assert main(["import", str(raw), str(dyr)]) == 2
    lines = [re.sub(r".*/case", "case", line) for line in capsys.readouterr().err.splitlines()]
    assert [line.partition(" given")[0] for line in lines] == [
        "case.raw: line 21: generator: G3: V: 0.0",
        "case.dyr: line 2: GENROU: H = -9.55",
    ]
    raw.write_text(raw_with(("^3,'1 ',85.*$", "2,'1 ',85/"), ("^1,'BUS 1       ',16.5,3", "1,'BUS 1       ',16.5,2")))
    assert main(["import", str(raw)]) == 2
    lines = [re.sub(r".*/case", "case", line) for line in capsys.readouterr().err.splitlines()]
    assert [line.partition(" given")[0] for line in lines if "island" not in line] == [
        "case.raw: line 21: generator: 1 stands twice at bus 2; allowed: each machine once",
        "case.raw: generator: none at a bus of type 3",
    ]


def test_constants_that_no_equation_can_be_made_of_are_told_with_their_lines(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Beside those that are only unusual."""
    (tmp_path / "case.dyr").write_text(
        DYR.read_text().replace("1  8.0 0.03", "1  8.0 0").replace("1  5.9 0.03", "1  -5.9 0.03")
    )
    assert main(["import", str(RAW), str(tmp_path / "case.dyr")]) == 2
    lines = [re.sub(r".*/case", "case", line) for line in capsys.readouterr().err.splitlines()]
    assert [line.partition(" given")[0] for line in lines] == [
        "case.dyr: line 2: GENROU: of G1: Td02: 0.0",
        "case.dyr: line 4: GENROU: of G3: Td01: -5.9",
    ]


def test_unusual_constants_are_told_and_taken(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    dyr = tmp_path / "case.dyr"
    dyr.write_text(re.sub(r"1  [68].0 0.03", "1  999 999", DYR.read_text()))
    out = tmp_path / "case.yaml"
    assert main(["import", str(RAW), str(dyr), "--out", str(out)]) == 0
    said = "case.dyr: GENROU: Td02 is unusual; usual: at most 10 s (2 machines: G1, G2)"
    assert f"facts-damping: {said}" in capsys.readouterr().err.splitlines()
    system = load_system(str(out))
    assert system.ranges == "physical"
    assert {machine.Td02 for machine in system.machines} == {999.0, 0.03}


# Controls that act otherwise than in PSS/E

SEXS = "2 'SEXS' 1 0.4 5 20 0.1 -10 10 /\n"
SHAPED = "0 0 0 0 0 0 0.1 0.02 0.1 0.02 1.65 1.65 3 0.1 -0.1 0 0 /"
STEAM = "20 0.1 0.05 0.2 1 -1 2 0 0.3 0.3 {K2} 5 0.4 0 0.5 0.2 0 0.15 0.1 0"
POINTS = "0 0 0 0 0 0 0 0 0 0"
FREQUENCY = "the speed of the machine stands for the frequency of a bus"
OTHER_BUS = "the voltage of the machine stands for that of another bus"
SHAFT = "all its power acts on this machine, none on that at JBUS"


@pytest.mark.parametrize(
    ("records", "said"),
    [
        (SEXS + f"2 'IEEEST' 1 1 3 {SHAPED}", ""),
        (SEXS + f"2 'IEEEST' 1 2 0 {SHAPED}", FREQUENCY),
        (SEXS + f"2 'IEEEST' 1 5 0 {SHAPED}", ""),
        (SEXS + f"2 'IEEEST' 1 5 3 {SHAPED}", OTHER_BUS),
        (SEXS + f"2 'IEEEST' 1 6 0 {SHAPED}", "has an input that is not modelled, IC 6: left out"),
        (SEXS + "2 'PSS2A' 1 1 0 2 0 5 1 2 2 0 2 0 2 0.3 1 0.5 0.1 10 0.2 0.02 0.2 0.02 1 -1 /", FREQUENCY),
        (f"2 'IEEEG1' 1 3 1 {STEAM.format(K2=0)} /", ""),
        (f"2 'IEEEG1' 1 0 0 {STEAM.format(K2=0.2)} /", ""),
        (f"2 'IEEEG1' 1 3 1 {STEAM.format(K2=0.2)} /", SHAFT),
        (f"2 'WSIEG1' 1 0 0 {STEAM.format(K2=0)} 0 0 0 {POINTS} 0 /", ""),
        (f"2 'WSIEG1' 1 0 0 {STEAM.format(K2=0)} 0 0 0.01 {POINTS} 0 /", "its valve has no play DB2"),
        (f"2 'WSIEG1' 1 0 0 {STEAM.format(K2=0)} 0 0 0 {POINTS} 1 /", "its valve is not blocked as IBLOCK says"),
    ],
)
def test_control_that_acts_otherwise_than_in_psse_is_not_exact(records: str, said: str, tmp_path: Path) -> None:
    dyr = tmp_path / "case.dyr"
    rest = "".join(f"{line}\n" for line in DYR.read_text().splitlines() if not re.match(r"2 '(?!GENROU)", line))
    dyr.write_text(rest + records)
    case = import_case(RAW, dyr)
    model = records.split("'")[-2]
    row = {row.name: row for row in case.records}[model]
    (inexact,) = case.inexact or [""]
    assert inexact == (f"case.dyr: line {len((rest + records).splitlines())}: {model}: of G2: {said}" if said else "")
    assert (row.replaced, row.left_out) == (int(bool(said) and "left" not in said), int("left" in said))
    assert row.effects == (("swings are less damped" if "left" in said else said,) if said else ())


def test_wsieg1_may_end_where_the_rest_is_zero(tmp_path: Path) -> None:
    """As in public files; JBUS to K5."""
    dyr = tmp_path / "case.dyr"
    rest = "".join(f"{line}\n" for line in DYR.read_text().splitlines() if not line.startswith("2 'TGOV1"))
    dyr.write_text(f"{rest}2 'WSIEG1' 1 0 0 25 0 0 0.1 1 -10 1.01 0 0.3 1 0 0 0 0 0 0 /\n")
    (governor,) = [row for row in import_case(RAW, dyr).content["governors"] if row["machine"] == "G2"]
    assert [governor[name] for name in ("K1", "K5", "K6", "T7", "DB1", "PGV5")] == [1, 0, 0, 0, 0, 0]


def test_saturation_that_falls_is_replaced_by_none(tmp_path: Path) -> None:
    text = re.sub(r"(?m)^(2 'GENROU'.*) \S+ \S+ /", r"\1 0.3 0.2 /", DYR.read_text(), count=1)
    assert text != DYR.read_text()
    (tmp_path / "case.dyr").write_text(text)
    case = import_case(RAW, tmp_path / "case.dyr")
    (said,) = case.inexact
    assert said.endswith("GENROU: of G2: S(1.2) is not above S(1.0): without saturation")


def test_dynamic_data_without_a_record_are_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "case.dyr").write_text("// nothing\n")
    assert main(["import", str(RAW), str(tmp_path / "case.dyr")]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.endswith("case.dyr: no record given; allowed: at least one")


def test_gate_that_does_not_admit_the_start_is_widened_like_other_limits(tmp_path: Path) -> None:
    (tmp_path / "case.dyr").write_text(
        DYR.read_text().replace(
            "2 'TGOV1' 1   0.05 0.49 2 0 2.1 7.0 0.1 /", "2 'HYGOV' 1 0.04 0.4 5 0.05 0.5 0.2 0.5 0 1 1.2 0 0.1 /"
        )
    )
    case = import_case(RAW, tmp_path / "case.dyr")
    (text,) = [text for text in case.inexact if "HYGOV" in text]
    gate = 163 / 192 / 1.2 + 0.1  # P / (rating At) + q_nl
    said = f"gate is {gate:.4g} p.u. at the start; allowed by its limits: 0.001 to 0.5"
    assert text == f"case.dyr: line 9: HYGOV: of G2: {said}; gate_max: 0.5 is set to {1.1 * gate:.4g}"
    assert {row.name: row.replaced for row in case.records}["HYGOV"] == 1


def test_options_of_psse_are_refused_for_other_cases(capsys: pytest.CaptureFixture[str]) -> None:
    for option in (["--strict"], ["--loads", "P: current"]):
        assert main(["import", "tests/data/nine_bus.m", *option]) == 2
        assert "given with nine_bus.m; allowed: with a RAW file" in capsys.readouterr().err
