"""MATPOWER cases: the same power flow as the shipped system, dynamics from a file or typical, bad input in one line."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from facts_damping.case.loading import load_system
from facts_damping.cli.main import main
from facts_damping.errors import InputError
from facts_damping.parameters.yaml_text import dump
from facts_damping.plant.build import build
from facts_damping.plant.grid.power_flow import solve
from facts_damping.small_signal.linearisation import linearise
from facts_damping_grids.matpower_conversion import MatpowerCase, convert
from facts_damping_grids.matpower_reading import import_case, read_case
from facts_damping_grids.text import document
from tests.commands import assert_one_line

if TYPE_CHECKING:
    from facts_damping.parameters.plant.system import System
    from facts_damping_grids.matpower_conversion import Imported

CASE = Path(__file__).parents[1] / "data" / "nine_bus.m"


def loaded(folder: Path, dynamics: dict[str, Any] | None = None, case: Path = CASE) -> tuple[System, list[str], str]:
    """A case imported, written and read again; the notes and the text too."""
    dynamics_path = None
    if dynamics is not None:
        dynamics_path = folder / "dynamics.yaml"
        dynamics_path.write_text(dump(dynamics), encoding="utf-8")
    case_imported = import_case(case, dynamics_path)
    text = document(case_imported.content, case_imported.typical, case.name)
    notes = case_imported.notes
    path = folder / "imported.yaml"
    path.write_text(text, encoding="utf-8")
    return load_system(str(path)), notes, text


def tables(**changes: Any) -> MatpowerCase:
    """Two buses, a generator at each, two branches; `bus_1={...}` changes row 1 of the table of buses."""
    common = {"PD": 0.0, "QD": 0.0, "GS": 0.0, "BS": 0.0, "VM": 1.0, "VA": 0.0, "BASE_KV": 230.0}
    unit = {"PG": 40.0, "QG": 0.0, "VG": 1.0, "MBASE": 100.0, "GEN_STATUS": 1, "PMAX": 90.0, "PMIN": 0.0}
    branch = {"F_BUS": 1, "T_BUS": 2, "BR_R": 0.01, "BR_X": 0.1, "BR_B": 0.02}
    branch |= {"TAP": 0.0, "SHIFT": 0.0, "BR_STATUS": 1}
    rows: dict[str, list[dict[str, float]]] = {
        "bus": [{"BUS_I": 1, "BUS_TYPE": 3} | common, {"BUS_I": 2, "BUS_TYPE": 2} | common],
        "gen": [{"GEN_BUS": 1} | unit, {"GEN_BUS": 2} | unit],
        "branch": [branch, dict(branch)],
    }
    for key, change in changes.items():
        table, _, number = key.rpartition("_")
        index = int(number) - 1
        while index >= len(rows[table]):
            rows[table].append(dict(rows[table][-1]))
        rows[table][index] |= change
    return MatpowerCase("two_buses", 100.0, rows["bus"], rows["gen"], rows["branch"])


def converted(dynamics: dict[str, Any] | None = None, **changes: Any) -> Imported:
    return convert(tables(**changes), dynamics)


def test_nine_buses_have_the_power_flow_of_the_shipped_system(tmp_path: Path) -> None:
    system, _, _ = loaded(tmp_path)
    ours, theirs = solve(load_system("wscc_9")), solve(system)
    assert ours.names == theirs.names
    np.testing.assert_allclose(theirs.voltage, ours.voltage, rtol=0, atol=1e-12)
    np.testing.assert_allclose(list(theirs.generation.values()), list(ours.generation.values()), rtol=0, atol=1e-11)
    assert [t.name for t in system.transformers] == ["T1_4", "T2_7", "T3_9"]
    assert [m.rating for m in system.machines] == [247.5, 192, 128]


def test_typical_data_are_named_as_such(tmp_path: Path) -> None:
    system, notes, text = loaded(tmp_path)
    assert [note for note in notes if "typical data" in note] == notes
    assert "# Typical data, not from the case" in text
    assert {m.model for m in system.machines} == {"genrou"}
    values = np.linalg.eigvals(linearise(build(system, [], []))[0])
    assert values.real.max() < 1e-3


def test_dynamics_from_a_file_give_the_shipped_system(tmp_path: Path) -> None:
    shipped = load_system("wscc_9")
    keys = ("rating", "model", "H", "Xd", "Xd1", "Td01", "Xq", "Xq1", "Tq01")
    rows = [{key: getattr(m, key) for key in keys} for m in shipped.machines]
    exciters = [e.model_dump() for e in shipped.exciters]
    where: list[dict[str, Any]] = [{"bus": "B1"}, {"generator": 2}, {"bus": "B3"}]
    machines = [row | at for row, at in zip(rows, where, strict=True)]
    system, notes, text = loaded(tmp_path, {"machines": machines, "exciters": exciters, "name": "mine"})
    assert system.name == "mine"
    assert notes == []
    assert "Typical" not in text
    eigenvalues, other = (np.sort_complex(np.linalg.eigvals(linearise(build(s, [], []))[0])) for s in (shipped, system))
    np.testing.assert_allclose(other[np.abs(other) > 0.1], eigenvalues[np.abs(eigenvalues) > 0.1], rtol=0, atol=1e-6)


def test_command_writes_a_file_and_says_what_it_assumed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    target = tmp_path / "nine.yaml"
    assert main(["import", str(CASE), "--out", str(target)]) == 0
    written = capsys.readouterr()
    assert written.out == ""
    assert written.err.startswith("facts-damping: nine_bus.m: no dynamic data for all machines")
    assert main(["import", str(CASE)]) == 0
    assert capsys.readouterr().out == target.read_text(encoding="utf-8")


def test_ratio_or_a_shift_makes_a_transformer() -> None:
    content, _, notes = converted(branch_2={"TAP": 0.95, "SHIFT": 10.0})
    assert content["lines"] == [{"name": "line_1_2", "from": "B1", "to": "B2", "r": 0.01, "x": 0.1, "b": 0.02}]
    (transformer,) = content["transformers"]
    assert (transformer["tap"], transformer["phase_shift"], transformer["rating"]) == (0.95, 10.0, 100.0)
    assert [s["Q"] for s in content["shunts"]] == pytest.approx([1 / 0.95**2, 1.0])  # Mvar: b/2 at 100 MVA
    assert any("charging is two shunts" in note for note in notes)


def test_parallel_lines_have_names_of_their_own() -> None:
    assert [line["name"] for line in converted().content["lines"]] == ["line_1_2", "line_1_2_2"]


def test_elements_out_of_service_are_left_out_with_a_note() -> None:
    content, _, notes = converted(branch_2={"BR_STATUS": 0}, gen_3={"GEN_STATUS": 0})
    assert len(content["lines"]) == 1
    assert len(content["machines"]) == 2
    assert "branch 2 from bus 1 to bus 2 is out of service: left out" in notes
    assert "generator 3 at bus 2 is out of service: left out" in notes


def test_dc_lines_are_left_out_and_said(tmp_path: Path) -> None:
    limits = "10 -10 10 -10 10 1 0"
    rows = f"mpc.dcline = [\n1 4 1 10 8.9 0 0 1 1 1 {limits};\n5 9 0 1 1 0 0 1 1 1 {limits};\n];\n"
    path = tmp_path / "dc.m"
    path.write_text(CASE.read_text(encoding="utf-8") + rows, encoding="utf-8")
    _, notes, _ = loaded(tmp_path, case=path)
    assert "dc.m: 1 DC lines are left out, and the power that they carry" in notes


def test_generators_at_one_bus_are_joined() -> None:
    content, _, notes = converted(gen_3={"PG": 10.0, "MBASE": 50.0})
    assert content["machines"][1]["P"] == 50
    assert content["machines"][1]["rating"] == 150
    assert "generators 2, 3 at bus 2 are joined into one machine" in notes


def test_dispatchable_load_is_a_load() -> None:
    content, _, notes = converted(gen_3={"PG": -10.0, "QG": -2.0, "PMIN": -20.0, "PMAX": 0.0})
    assert content["loads"] == [{"name": "load_2", "bus": "B2", "P": 10.0, "Q": 2.0}]
    assert any("dispatchable load" in note for note in notes)


def test_generator_at_a_bus_without_voltage_control_holds_the_voltage_of_the_bus() -> None:
    content, _, notes = converted(bus_2={"BUS_TYPE": 1, "VM": 0.98})
    assert content["machines"][1]["V"] == 0.98
    assert any("is of type 1" in note for note in notes)


def test_shunts_and_loads_keep_their_signs() -> None:
    content, _, _ = converted(bus_2={"PD": 30.0, "QD": -5.0, "GS": 1.0, "BS": -20.0})
    assert content["loads"] == [{"name": "load_2", "bus": "B2", "P": 30.0, "Q": -5.0}]
    assert content["shunts"] == [{"name": "shunt_2", "bus": "B2", "Q": -20.0, "P": 1.0}]


def test_rating_below_the_dispatch_is_not_taken() -> None:
    content, _, _ = converted(gen_1={"PG": 250.0, "PMAX": 300.0}, gen_2={"PG": 250.0, "PMAX": 1e10})
    assert [m["rating"] for m in content["machines"]] == [300, 250]


BAD = [
    ({"bus_2": {"BUS_TYPE": 3}}, r"mpc.bus: 2 reference buses \(type 3\) given; allowed: exactly one"),
    ({"bus_1": {"BUS_TYPE": 2}}, r"mpc.bus: 0 reference buses \(type 3\) given; allowed: exactly one"),
    ({"bus_2": {"BUS_TYPE": 4}}, r"isolated buses given \(2\); allowed: buses that .* join to bus 1"),
    ({"bus_3": {"BUS_I": 7, "BUS_TYPE": 1}}, r"isolated buses given \(7\)"),
    ({"bus_2": {"BUS_I": 1}}, "2 rows for 1 buses given; allowed: each bus once"),
    ({"bus_2": {"BUS_I": 1.5}}, "bus number 1.5 given; allowed: a positive integer"),
    ({"gen_2": {"GEN_BUS": 5}}, "mpc.gen, row 2: bus 5 given; allowed: a bus of mpc.bus"),
    ({"branch_2": {"T_BUS": 5}}, "mpc.branch, row 2: bus 5 given; allowed: a bus of mpc.bus"),
    ({"branch_1": {"BR_X": 0.0}}, r"mpc.branch, row 1 \(1 to 2\): x = 0 given; allowed: any but 0"),
    ({"branch_1": {"BR_R": -0.1}}, r"row 1 \(1 to 2\): r = -0.1 given; allowed: 0 or more"),
    ({"gen_1": {"GEN_STATUS": 0}}, "no generator in service at the reference bus; allowed: at least one there"),
    ({"gen_1": {"GEN_STATUS": 0}, "gen_2": {"GEN_STATUS": 0}}, "no generator in service given; allowed: at least one"),
]


@pytest.mark.parametrize(("changes", "message"), BAD)
def test_bad_case_is_refused(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message) as caught:
        converted(**changes)
    assert "\n" not in str(caught.value)


BAD_DYNAMICS: list[tuple[dict[str, Any], str]] = [
    ({"machine": []}, r"--dynamics: 'machine' given \(did you mean machines\?\); allowed: machines, name"),
    ({"machines": {}}, "machines: {} given; allowed: a list of rows"),
    ({"machines": [{"H": 4.0}]}, "machines.0: {'H': 4.0} given; allowed: a row with either `bus` or `generator`"),
    ({"machines": [{"bus": "B9"}]}, "machines.0: 'B9' given; allowed: B1, B2"),
    ({"machines": [{"generator": 3}]}, "machines.0: 3 given; allowed: 1, 2"),
    ({"machines": [{"bus": ["B1"]}]}, r"machines.0: \['B1'\] given; allowed: B1, B2"),
    ({"machines": [{"bus": "B1", "P": 1.0}]}, "machines.0.P: 1.0 given; allowed: none, the case says it"),
    ({"machines": [{"bus": "B1"}, {"generator": 1}]}, "machines.1: 1 given; allowed: one row for the machine at bus 1"),
]


@pytest.mark.parametrize(("dynamics", "message"), BAD_DYNAMICS)
def test_bad_dynamics_are_refused(dynamics: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message):
        converted(dynamics)


def test_dynamics_that_no_system_takes_are_refused_by_field(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"nine_bus.m with .*dynamics.yaml: machines.0.H: -1 given; allowed: greater"):
        loaded(tmp_path, {"machines": [{"bus": "B1", "model": "classical", "Xd1": 0.3, "H": -1}]})


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (None, "no such case; allowed: an existing MATPOWER file"),
        ("hello\n", "not a MATPOWER case; allowed: a MATPOWER case of version 2"),
        ("function mpc = a\nmpc.baseMVA = 100;\n", "not a MATPOWER case"),
        ("function mpc = a\nmpc.bus(:, 3) = 2;\n", "line 2: computes in a table"),
        (CASE.read_text().replace("0.0576", "1/0"), "mpc.branch, row 1: BR_X: '1/0' given; allowed: a finite number"),
        (CASE.read_text().replace("0.0576", "Inf"), "mpc.branch, row 1: BR_X: inf given; allowed: a finite number"),
    ],
)
def test_file_that_is_no_case_is_refused(tmp_path: Path, text: str | None, message: str) -> None:
    path = tmp_path / "case.m"
    if text is not None:
        path.write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match=message) as caught:
        read_case(path)
    assert "\n" not in str(caught.value)


def test_missing_library_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "matpowercaseframes", None)
    with pytest.raises(InputError, match=r"matpowercaseframes is not installed; .*pip install -e '\.\[matpower\]'"):
        read_case(CASE)


@pytest.mark.parametrize("target", ["missing/nine.yaml", "."])
def test_file_that_cannot_be_written_is_refused_first(
    tmp_path: Path, target: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert_one_line(
        2, ["import", str(CASE), "--out", target], f"--out {target}: cannot be written; allowed: a file", capsys
    )
