"""Inverters of PSS/E cases: converters with their controls, where these measure, and what becomes of gaps."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from facts_damping.parameters.plant.system import System
from facts_damping.plant.build import build
from facts_damping.plant.grid.power_flow import solve
from facts_damping.small_signal.linearisation import linearise
from facts_damping_grids.psse.conversion import import_case
from tests.grids.test_psse import DYR, RAW, imported, one_line, raw_with
from tests.grids.test_psse_units import equal_voltages
from tests.plant.inverter_rows import CONSTANTS
from tests.plant.inverters import SOURCES, VALUES

if TYPE_CHECKING:
    from pathlib import Path

    from facts_damping_grids.psse.conversion import ImportedCase

REGCA1 = f"3 'REGCA1' 1 {VALUES['REGCA1']} /\n"
REECB1 = f"3 'REECB1' 1 {VALUES['REECB1']} /\n"
MACHINES = "".join(f"{line}\n" for line in DYR.read_text().splitlines() if not line.startswith("3 "))
GRID_FORMING = "0 1 0.01 0.01 0.01 1.2 1.5 0.1 1.1 -0.1 1 -1 0.01 0.05 0.01 0.1 3 20 0 0"
TURBINE = {model: f"3 '{model}' 1 {CONSTANTS[model]} /\n" for model in ("WTDTA1", "WTARA1", "WTPTA1", "WTTQA1")}
REECA1 = f"3 'REECA1' 1 0 {CONSTANTS['REECA1'].split(' ', 1)[1]} /\n"


def plant(places: str = "0 0 0 '0 '", model: str = "'REPCA1' 1") -> str:
    """The record of a plant control: regulated bus, ends and circuit of its branch."""
    return f"3 {model} {places} {VALUES['REPCA1'].split(' ', 4)[4]} /\n"


def case_of(tmp_path: Path, *records: str, raw: str | None = None) -> ImportedCase:
    """The case with two machines, and records of the third unit."""
    paths = tmp_path / "case.raw", tmp_path / "case.dyr"
    paths[0].write_text(raw or RAW.read_text())
    paths[1].write_text(MACHINES + "".join(records))
    return import_case(*paths)


def placed(case: ImportedCase) -> dict[str, Any]:
    """Where the plant control of a case measures."""
    (row,) = [row for row in case.content["inverter_controls"] if row["model"] == "REPCA1"]
    return {name: row[name] for name in ("bus", "branch") if name in row}


def test_inverter_with_its_controls_keeps_the_power_flow_and_is_at_rest(tmp_path: Path) -> None:
    for folder in ("a", "b"):
        (tmp_path / folder).mkdir()
    machines = imported(tmp_path / "a", RAW.read_text(), DYR.read_text())
    system = imported(tmp_path / "b", RAW.read_text(), MACHINES + REGCA1 + REECB1 + plant())
    equal_voltages(system, machines)
    (inverter,) = system.inverters
    power = solve(machines, []).generation["G3"] * 100.0
    assert (inverter.name, inverter.bus, inverter.rating, inverter.V) == ("G3", "B3", 128.0, None)
    row = inverter.model_dump()
    assert complex(row["P"], row["Q"]) == pytest.approx(power, abs=1e-6)
    assert row["Lvpl1"] == 1.22
    assert [(row.inverter, row.model) for row in system.inverter_controls] == [("G3", "REECB1"), ("G3", "REPCA1")]
    assert inverter.area == "area_1"
    slow = imported(tmp_path / "b", RAW.read_text(), MACHINES + REGCA1 + REECB1)
    for each in (system, slow):
        matrix = linearise(build(each, [], []))[0]
        assert np.isfinite(matrix).all()
    assert np.linalg.eigvals(matrix).real.max() < 1e-6


def test_records_of_an_inverter_are_exact(tmp_path: Path) -> None:
    case = case_of(tmp_path, REGCA1, REECB1, plant())
    assert case.inexact == []
    rows = {row.name: (row.read, row.exact) for row in case.records}
    assert [rows[model] for model in ("REGCA1", "REECB1", "REPCA1")] == [(1, 1)] * 3


@pytest.mark.parametrize(
    ("places", "expected"),
    [
        ("0 0 0 '0 '", {}),
        ("3 0 0 0", {}),  # its own
        ("9 0 0 '1'", {"bus": "B9"}),
        ("9 9 8 '1 '", {"bus": "B9", "branch": "line_8_9"}),
        ("9 9 8 'A1'", {"bus": "B9", "branch": "line_8_9_A1"}),
        ("9 9 3 1", {"bus": "B9", "branch": "T3_9"}),
        ("3 3 9 '1 '", {"bus": "B3", "branch": "T3_9"}),
    ],
)
def test_plant_control_measures_at_a_bus_and_a_branch_by_name(
    places: str, expected: dict[str, str], tmp_path: Path
) -> None:
    second = "^8,9,'1 ',(.*)$", r"8,9,'1 ',\1\n8,9,'A1',0.02,0.3,0,0,0,0,0,0,0,0,1,1,0,1,1"
    case = case_of(tmp_path, REGCA1, REECB1, plant(places), raw=raw_with(second))
    assert placed(case) == expected
    assert case.inexact == []


def test_record_of_a_user_model_is_read_behind_its_counts(tmp_path: Path) -> None:
    case = case_of(tmp_path, REGCA1, REECB1, plant("9 9 8 '1 '", "'USRMDL' 1 'REPCA1' 107 0 7 27 7 9"))
    assert placed(case) == {"bus": "B9", "branch": "line_8_9"}


@pytest.mark.parametrize(
    ("places", "said"),
    [
        ("99 0 0 '0 '", "BUSR = 99 given; allowed: 0, or a bus in service"),
        ("0 98 99 1", "BUSF = 98, BUST = 99 given; allowed: 0, or a bus in service"),
        ("0 9 8 2", "a branch from bus 9 to bus 8, circuit 2 given; allowed: one in service, with two ends"),
        ("0 9 7 1", "a branch from bus 9 to bus 7, circuit 1 given; allowed: one in service, with two ends"),
    ],
)
def test_place_that_is_not_there_is_one_error(
    places: str, said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "case.dyr"
    path.write_text(MACHINES + REGCA1 + REECB1 + plant(places))
    line = len(path.read_text().splitlines())
    assert f"case.dyr: line {line}: REPCA1: {said}" in one_line([str(RAW), str(path)], capsys)


@pytest.mark.parametrize(
    ("records", "said"),
    [
        ([REECB1, plant("0 9 8 1")], "REPCA1: of G3: it regulates the voltage at the bus of its branch, not at BUSR"),
        ([REECA1.replace("1 0", "1 9", 1)], "REECA1: of G3: it sees the voltage of the inverter, not that at BUSR"),
        ([REECA1.replace("1 0", "1 3", 1)], ""),
        ([REECA1, *TURBINE.values()], ""),
        ([REECA1, *TURBINE.values(), "TRATE"], "WTTQA1: of G3: its powers are p.u. of MBASE, not of TRATE"),
        ([REECB1, plant(), "3 'SEXS' 1 0.4 5 20 0.1 -10 10 /\n"], "SEXS: of G3: does not act on an inverter: left out"),
        ([REECB1, "3 'REPCTA1' 1 0 0 /\n"], "REPCTA1: of G3: is not modelled: left out"),
    ],
)
def test_record_that_acts_otherwise_is_told(records: list[str], said: str, tmp_path: Path) -> None:
    texts = [text for text in records if text != "TRATE"]
    if len(texts) > 2 and len(texts) == len(records) - 1:
        texts[-1] = texts[-1].replace(" 0 /", " 150 /")
    (inexact,) = case_of(tmp_path, REGCA1, *texts).inexact or [""]
    assert re.sub(r"^case.dyr: line \d+: ", "", inexact) == said


def test_rating_of_a_turbine_that_is_that_of_the_machine_is_exact(tmp_path: Path) -> None:
    turbine = TURBINE | {"WTTQA1": TURBINE["WTTQA1"].replace(" 0 /", " 128 /")}
    case = case_of(tmp_path, REGCA1, REECA1, *turbine.values())
    assert case.inexact == []
    assert [row["model"] for row in case.content["inverter_controls"]] == ["REECA1", *TURBINE]


def test_turbine_without_a_drive_train_is_left_out_and_the_rest_stays(tmp_path: Path) -> None:
    """As in public files: no record gives the speed, which stays then."""
    case = case_of(tmp_path, REGCA1, REECA1, *(TURBINE[m] for m in ("WTARA1", "WTPTA1", "WTTQA1")))
    assert [row["model"] for row in case.content["inverter_controls"]] == ["REECA1", "WTARA1"]
    texts = [re.sub(r"^case.dyr: line \d+: ", "", text) for text in case.inexact]
    assert texts == [
        "WTPTA1: of G3: needs speed_turbine, which no control that is modelled gives: left out",
        "WTTQA1: of G3: needs speed_generator, which no control that is modelled gives: left out",
    ]
    build_of(case)


def build_of(case: ImportedCase) -> None:
    """Whether a case has a start."""
    build(System.model_validate(case.content), [], [])


@pytest.mark.parametrize(
    ("records", "said"),
    [
        ([], "needs Ipcmd, Iqcmd, which no control that is modelled gives: "),
        ([plant()], "needs Ipcmd, Iqcmd, which no control that is modelled gives: "),
        (["3 'REECC1' 1 0 0 /\n"], "needs Ipcmd, Iqcmd, which no control that is modelled gives: "),
        ([REECB1.replace(" 0.02 /", " /")], "needs Ipcmd, Iqcmd, which no control that is modelled gives: "),
    ],
)
def test_converter_without_commands_is_a_constant_current(records: list[str], said: str, tmp_path: Path) -> None:
    case = case_of(tmp_path, REGCA1, *records)
    assert "inverters" not in case.content
    assert "inverter_controls" not in case.content
    (load,) = [row for row in case.content["loads"] if row["P"] < 0.0]
    assert (load["name"], load["P"]) == ("current_G3", pytest.approx(-85.0))
    text = "a constant current stands for the inverter"
    assert [re.sub(r"^case.dyr: line \d+: ", "", line) for line in case.inexact] == [
        f"REGCA1: of G3: {said}{text}",
        *(f"{record.split(chr(39))[1]}: of G3: {text}" for record in records),
    ]


def test_second_control_of_a_sort_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "case.dyr"
    path.write_text(MACHINES + REGCA1 + REECB1 + REECA1)
    line = len(path.read_text().splitlines())
    said = f"case.dyr: line {line}: REECA1: given beside REECB1 of G3; allowed: one control of a sort"
    assert said in one_line([str(RAW), str(path)], capsys)


def test_limit_of_a_control_that_excludes_the_start_is_widened(tmp_path: Path) -> None:
    """85 MW of 128 MVA are beyond Pmax 0.5."""
    low = VALUES["REECB1"].split()
    low[-4] = "0.5"
    case = case_of(tmp_path, REGCA1, f"3 'REECB1' 1 {' '.join(low)} /\n", plant())
    (text,) = case.inexact
    P = 85.0 / 128.0
    assert re.sub(r"^case.dyr: line \d+: ", "", text) == (
        f"REECB1: of G3: Pord is {P:.4g} p.u. at the start; allowed by its limits: 0 to 0.5; "
        f"Pmax: 0.5 is set to {1.1 * P:.4g}"
    )
    (control,) = [row for row in case.content["inverter_controls"] if row["model"] == "REECB1"]
    assert control["Pmax"] == pytest.approx(1.1 * P)


@pytest.mark.parametrize("model", ["REGFMA1", "REGFM_A1"])
def test_grid_forming_inverter_has_the_impedance_of_its_generator(model: str, tmp_path: Path) -> None:
    """ZR + j ZX of the RAW file, which the record has not; and if there is no machine, the largest one is the slack."""
    raw = raw_with(
        ("^3,'1 ',85,0,300,-300,1.025,0,128,0,0.2,", "3,'1 ',85,0,300,-300,1.025,0,128,0.002,0.15,"),
        ("^1,'1 ',71.64,0,300,-300,1.04,0,247.5,0,0.2,", "1,'1 ',71.64,0,300,-300,1.04,0,247.5,0.001,0.1,"),
    )
    (tmp_path / "case.raw").write_text(raw)
    forming = [f"{bus} '{model}' 1 {GRID_FORMING} /\n" for bus in (1, 3)]
    case = case_of(tmp_path, forming[1], raw=raw)
    (inverter,) = case.content["inverters"]
    assert (inverter["Re"], inverter["Xe"], inverter["model"]) == (0.002, 0.15, "REGFMA1")
    (tmp_path / "case.dyr").write_text("".join(forming) + f"2 'REGCA1' 1 {VALUES['REGCA1']} /\n")
    alone = import_case(tmp_path / "case.raw", tmp_path / "case.dyr")
    assert [(row["name"], row.get("slack"), "P" in row) for row in alone.content["inverters"]] == [
        ("G1", True, False),
        ("G3", None, True),
    ]
    assert "machines" not in alone.content
    build_of(alone)


def test_virtual_machines_alone_are_a_grid_too(tmp_path: Path) -> None:
    """REGFMB1's angle is that of a PLL, and it forms a grid none the less."""
    (tmp_path / "case.raw").write_text(RAW.read_text())
    constants = " ".join(SOURCES["REGFMB1"].split()[:-2])  # without Re, Xe
    (tmp_path / "case.dyr").write_text("".join(f"{bus} 'REGFMB1' 1 {constants} /\n" for bus in (1, 2, 3)))
    alone = import_case(tmp_path / "case.raw", tmp_path / "case.dyr")
    assert [(row["name"], row.get("slack")) for row in alone.content["inverters"]] == [
        ("G1", True),
        ("G2", None),
        ("G3", None),
    ]
    build_of(alone)


def test_inverter_stands_behind_the_step_up_transformer_of_its_record(tmp_path: Path) -> None:
    """With the power that it has there: V / t + Z I."""
    behind = "^3,'1 ',85,0,300,-300,1.025,0,128,0,0.2,0,0,1,", "3,'1 ',85,0,300,-300,1.025,0,128,0,0.2,0.01,0.1,1.05,"
    plain, case = case_of(tmp_path, REGCA1, REECB1), case_of(tmp_path, REGCA1, REECB1, raw=raw_with(behind))
    (before,), (after,) = (x.content["inverters"] for x in (plain, case))
    S = complex(before["P"], before["Q"]) / 100.0
    loss = complex(0.01, 0.1) / 1.28 * abs(1.05 * S / 1.025) ** 2
    assert after["bus"] == "G3_terminal"
    assert complex(after["P"], after["Q"]) / 100.0 == pytest.approx(S + loss, abs=1e-8)
