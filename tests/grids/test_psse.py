"""PSS/E cases become systems: beside ANDES, in all versions, whatever the units of a record, and with bad records."""

from __future__ import annotations

import json
import os
import random
import re
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from facts_damping.case.loading import load_system
from facts_damping.cli.main import main
from facts_damping.plant.build import build
from facts_damping.plant.grid.power_flow import solve
from facts_damping.small_signal.linearisation import linearise
from facts_damping_grids.psse.conversion import import_case
from tests.andes_cases import with_torques

if TYPE_CHECKING:
    from collections.abc import Callable

    from facts_damping.parameters.plant.system import System

GRID_FILES = int(os.environ.get("GRID_FILES", "160"))  # more of it: GRID_FILES=5000 python -m pytest tests/grid_formats
DATA = Path(__file__).parents[1] / "data"
RAW, DYR = DATA / "three_machines.raw", DATA / "three_machines.dyr"
THREE_BUSES = DATA / "psse_three_buses.raw"
ANDES = json.loads((DATA / "three_machines_andes.json").read_text(encoding="utf-8"))


def imported(folder: Path, raw: str, dyr: str | None = None) -> System:
    """A case, imported as a user does it."""
    paths = [folder / "case.raw", *([folder / "case.dyr"] if dyr is not None else [])]
    for path, text in zip(paths, (raw, dyr), strict=False):
        path.write_text(str(text), encoding="utf-8")
    assert main(["import", *map(str, paths), "--out", str(folder / "case.yaml")]) == 0
    return load_system(str(folder / "case.yaml"))


def raw_with(*changes: tuple[str, str]) -> str:
    """The case's text with lines that match replaced."""
    text = RAW.read_text(encoding="utf-8")
    for before, after in changes:
        assert re.search(before, text, re.MULTILINE), before
        text = re.sub(before, after, text, count=1, flags=re.MULTILINE)
    return text


def voltages(system: System) -> dict[str, complex]:
    flow = solve(system, [])
    return dict(zip(flow.names, flow.voltage, strict=True))


# Beside ANDES


def test_power_flow_and_all_modes_are_those_of_andes(tmp_path: Path) -> None:
    """Which counts states that cancel: of ours each has its own, of its some are at -1/T of such a block."""
    system = with_torques(imported(tmp_path, RAW.read_text(), DYR.read_text()))
    solved = voltages(system)
    for bus, (size, angle) in ANDES["voltages"].items():
        assert solved[f"B{bus}"] == pytest.approx(size * np.exp(1j * angle), abs=1e-6)
    theirs = [complex(*pair) for pair in ANDES["eigenvalues"]]
    ours = np.linalg.eigvals(linearise(build(system, [], []))[0])
    for value in ours[np.abs(ours) > 1e-3]:
        assert min(abs(value - other) for other in theirs) < 1e-4
    for value in theirs:
        if abs(value.imag) > 1e-3:
            assert np.abs(ours - value).min() < 1e-4


# Beside PSS/E


@pytest.mark.parametrize(("S10", "S12", "angle_deg"), [(0.1, 0.8, 55.0949), (0.0, 1.0, 58.9624), (0.5, 1.3, 48.0636)])
def test_start_has_the_rotor_angle_of_psse(S10: float, S12: float, angle_deg: float, tmp_path: Path) -> None:
    """PSS/E takes S(1.0) = 0 as no saturation at all."""
    source = "101 'GENCLS' 1 300 0 /\n102 'GENROU' 1 8 0.03 0.4 0.05 6.175 0.05 1.8 1.7 0.3 0.55 0.25 0.2"
    case = build(imported(tmp_path, THREE_BUSES.read_text(), f"{source} {S10} {S12} /\n"), [], [])
    start = dict(zip(case.state_names, case.state.x, strict=False))
    assert np.degrees(start["G102.delta"]) == pytest.approx(angle_deg, abs=1e-4)


# Versions and units


def as_34(text: str, version: int) -> str:
    """The same case as later versions write it: names and twelve ratings of branches, other sections, comments."""
    lines, section = [text.splitlines()[0].replace(", 33,", f", {version},"), "", ""], "bus"
    lines += ["@!   what stands where", "GENERAL, THRSHZ=0.0001", "0 / END OF SYSTEM-WIDE DATA, BEGIN BUS DATA"]
    for line in text.splitlines()[3:]:
        if line.startswith("0 /"):
            name = re.findall(r"BEGIN (.*) DATA", line)
            section = name[0] if name else ""
            lines.append(line)
            if section == "TRANSFORMER":
                lines.append("0 / END OF SYSTEM SWITCHING DEVICE DATA")
            continue
        values = line.split(",")
        if section == "BRANCH":
            values[6:9] = ["'a line, named'", *["0"] * 12]
        if section == "GENERATOR" and version == 35:
            values.insert(8, "0")
        lines.append(",".join(values))
    return "\n".join(lines)


@pytest.mark.parametrize("version", [32, 34, 35])
def test_psse_versions_give_the_same_system(version: int, tmp_path: Path) -> None:
    text = RAW.read_text()
    converted = text.replace(", 33,", ", 32,", 1) if version == 32 else as_34(text, version)
    (tmp_path / "a").mkdir()
    plain = imported(tmp_path / "a", text, DYR.read_text())
    assert imported(tmp_path, converted, DYR.read_text()) == plain


TRANSFORMER = r"^2,7,0,'1 ',1,1,1,.*\n0,0.0625,100\n1,0,(.*)\n1,0$"


@pytest.mark.parametrize(
    "record",
    [
        "2,7,0,'1 ',1,2,1,0,0,2,'T',1,1,1\n0,0.125,200\n1,0,\\1\n1,0",  # CZ 2: p.u. of its rating
        "2,7,0,'1 ',2,1,1,0,0,2,'T',1,1,1\n0,0.0625,100\n18,0,\\1\n230,0",  # CW 2: kV
        "2,7,0,'1 ',3,1,1,0,0,2,'T',1,1,1\n0,0.0625,100\n1,18,\\1\n1,230",  # CW 3: p.u. of the nominal voltage
        "2,7,0,'1 ',1,3,1,0,0,2,'T',1,1,1\n0,0.0625,100\n1,0,\\1\n1,0",  # CZ 3: load loss in W, |Z|
        "2 7 0 '1 ' 1 1 1 0 0 2 'T' 1 1 1 / blanks\n 0  6.25D-2  100\n1 0 \\1\n1 0",
        "2,7,,'1 ',,,,,,,'T',,,\n,0.0625,100\n,,\\1\n,",  # defaults
    ],
)
def test_units_and_forms_of_a_transformer(record: str, tmp_path: Path) -> None:
    (tmp_path / "a").mkdir()
    plain, other = imported(tmp_path / "a", RAW.read_text()), imported(tmp_path, raw_with((TRANSFORMER, record)))
    for name, voltage in voltages(plain).items():
        assert voltages(other)[name] == pytest.approx(voltage, abs=1e-9)


def test_taps_on_both_sides_and_shifts_are_those_of_the_two_port(tmp_path: Path) -> None:
    """V1 / t1 - V2 / t2 drives the current through the impedance."""
    record = "2,7,0,'1 ',1,1,1,0,0,2,'T',1,1,1\n0.01,0.0625,100\n1.05,0,30,0,0,0\n0.98,0,0"
    flow = solve(imported(tmp_path, raw_with((TRANSFORMER, record))), [])
    v = dict(zip(flow.names, flow.voltage, strict=True))
    first = 1.05 * np.exp(1j * np.radians(30.0))
    current = (v["B2"] / first - v["B7"] / 0.98) / (0.01 + 0.0625j)
    assert flow.generation["G2"] == pytest.approx(v["B2"] * np.conj(current / np.conj(first)), abs=1e-8)


def test_three_windings_are_a_star(tmp_path: Path) -> None:
    """A third winding that carries nothing changes nothing; one with a load draws it through its arm."""
    record = "2,7,10,'1 ',1,1,1,0,0,2,'T',1,1,1\n0,0.0625,100,0,0.1,100,0,0.09,100,1,0\n1,0,0,\\1\n1,0,0,0\n1,0,0,0"
    bus = ("^0 / END OF BUS", "10,'NEW         ',33,1,1,1,1,1,0\n0 / END OF BUS")
    (tmp_path / "a").mkdir()
    plain, star = imported(tmp_path / "a", RAW.read_text()), imported(tmp_path, raw_with(bus, (TRANSFORMER, record)))
    solved = voltages(star)
    for name, voltage in voltages(plain).items():
        assert solved[name] == pytest.approx(voltage, abs=1e-9)
    arms = {t.name: complex(t.r, t.x) for t in star.transformers if t.name.startswith("T2_7_10")}
    assert arms["T2_7_10_1"] + arms["T2_7_10_2"] == pytest.approx(0.0625j)
    assert arms["T2_7_10_2"] + arms["T2_7_10_3"] == pytest.approx(0.1j)
    assert arms["T2_7_10_3"] + arms["T2_7_10_1"] == pytest.approx(0.09j)


def test_machines_side_by_side_share_a_bus(tmp_path: Path) -> None:
    """Two of half the rating each are one."""
    half = "2,'1 ',81.5,0,300,-300,1.025,0,96,0,0.2,0,0,1,1,100,300,10,1,1"
    two = ("^2,'1 ',163.*$", f"{half}\n{half.replace(chr(39) + '1 ', chr(39) + '2 ')}")
    dyr = DYR.read_text()
    more = "\n".join(re.sub(r"' 1 ", "' 2 ", line) for line in dyr.splitlines() if line.startswith("2 "))
    (tmp_path / "a").mkdir()
    single, both = imported(tmp_path / "a", RAW.read_text(), dyr), imported(tmp_path, raw_with(two), f"{dyr}{more}\n")
    assert [m.name for m in both.machines] == ["G1", "G2_1", "G2_2", "G3"]
    theirs = np.linalg.eigvals(linearise(build(both, [], []))[0])
    for value in np.linalg.eigvals(linearise(build(single, [], []))[0]):
        assert np.abs(theirs - value).min() < 1e-4 or abs(value) < 1e-3


def test_loads_and_shunts_of_all_kinds(tmp_path: Path) -> None:
    """Constant power, current and impedance; a shunt that stands switched."""
    load = ("^5,'1 ',1,1,1,125,50,0,0,0,0", "5,'1 ',1,1,1,100,40,10,5,15,-5")
    shunt = ("^0 / END OF SWITCHED", "8,1,0,1,1,1,0,100,' ',25\n0 / END OF SWITCHED")
    system = imported(tmp_path, raw_with(load, shunt))
    assert {(x.name, x.P, x.Q, x.at) for x in system.loads if x.bus == "B5"} == {
        ("load_5", 100.0, 40.0, "solved"),
        ("load_5_current", 10.0, 5.0, "nominal"),
        ("load_5_impedance", 15.0, 5.0, "nominal"),
    }
    assert [(s.name, s.bus, s.Q) for s in system.shunts] == [("switched_8", "B8", 25.0)]


def test_parallel_branches_and_their_shunts(tmp_path: Path) -> None:
    """Another line beside one, with a shunt at its end; a transformer's magnetising branch in either unit."""
    shunts = []
    for i, magnetising in enumerate(("1,0.001,-0.01", f"2,100000,{abs(0.001 - 0.01j)!r}")):
        record = f"2,7,0,'1 ',1,1,{magnetising},2,'T',1,1,1\n0,0.0625,100\n1,0,\\1\n1,0"
        line = ("^0 / END OF BRANCH", "4,5,'2 ',0.01,0.085,0.176,0,0,0,0.002,0.03,0,0,1\n0 / END OF BRANCH")
        bus = ("^0 / END OF BUS", "10,'ALONE       ',33,4,1,1,1,1,0\n0 / END OF BUS")
        (folder := tmp_path / str(i)).mkdir()
        system = imported(folder, raw_with(bus, line, (TRANSFORMER, record)))
        assert {"line_4_5", "line_4_5_2"} <= {drawn_line.name for drawn_line in system.lines}
        assert "B10" not in {drawn_bus.name for drawn_bus in system.buses}
        shunts.append({shunt.name: pytest.approx((shunt.P, shunt.Q)) for shunt in system.shunts})
    assert shunts[0] == {"magnetising_T2_7": (0.1, -1.0), "shunt_line_4_5_2_4": (0.2, 3.0)}
    assert {name: approximate.expected for name, approximate in shunts[1].items()} == shunts[0]


# What is not modelled


def test_psse_record_without_a_model_is_named_with_its_substitute(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    dyr = DYR.read_text().replace("'IEEEG1' 1  0 0 20 0.1", "'IEEEG1' 1  0 0 20 0.001")
    more = "2 'MAXEX2' 1 0.01 0.05 /\n7 'USRMDL' 1 5 /\n3 'USRMDL' 1 1 2 /\n9 'GENROU' 1 1 2 /\nsomething else /\n"
    more += "2 'DC4B' 1 0.01 200 50 50 0.01 10 -10 1 0.02 /\n"  # ours has another order
    imported(
        tmp_path,
        raw_with(("^0 / END OF VSC", "1,2,3\n" * 3 + "0 / END OF VSC")),
        dyr.replace("3 'GENROU'", "3 'GENXYZ'") + more,
    )
    errors = capsys.readouterr().err
    for said in (
        "case.raw: line 45: VSC dc: is not modelled: left out",
        "line 11: MAXEX2: of G2: is not modelled: left out",
        "line 12: USRMDL: no machine 1 at bus 7 in the case: left out",
        "line 13: USRMDL: of G3: is no machine model that is known: left out",
        "line 15: something else ... is no record of a machine: left out",
        "line 16: DC4B: of G2: is not modelled: left out",
        "line 4: GENXYZ: of G3: is no machine model that is known: left out",
        "line 21: generator: G3 has only GENXYZ, SEXS, USRMDL in case.dyr: a constant current of its P and Q",
        "line 7: SEXS: of G3: is left out with its machine, for which a constant current stands",
        "line 8: IEEEG1: of G1: T1 below 0.002 s: taken as 0",
    ):
        assert said in errors


@pytest.mark.parametrize(
    ("name", "written", "said"),
    [
        ("ieee14.xlsx", True, "ieee14.xlsx: a file of format '.xlsx' given; allowed: a MATPOWER case (.m) or a PSS/E"),
        ("ieee14.xlsx", False, "ieee14.xlsx: no such file; allowed: a MATPOWER case (.m) or a PSS/E case (.raw)"),
        ("ieee14.raw", False, "ieee14.raw: no such file; allowed: an existing PSS/E RAW file"),
        ("ieee14.m", False, "ieee14.m: no such case; allowed: an existing MATPOWER file (.m)"),
    ],
)
def test_case_that_is_none_is_refused_with_what_is_allowed(
    name: str, written: bool, said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    if written:
        (tmp_path / name).write_bytes(b"PK")
    assert said in one_line([str(tmp_path / name)], capsys)


def test_equal_notes_are_one_line_with_a_count(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    gates = "".join(f"{n} 'HYGOV' 1 0.04 0.4 5 0.05 0.5 0.2 1 0 1 1.2 0 0.1 /\n" for n in (2, 3))
    more = "".join(f"{n} 'USRMDL' 1 5 /\n" for n in (1, 2, 3, 3))
    imported(
        tmp_path,
        RAW.read_text(),
        DYR.read_text().replace("2 'TGOV1' 1   0.05 0.49 2 0 2.1 7.0 0.1 /\n", "") + gates + more,
    )
    errors = capsys.readouterr().err.splitlines()
    said = "case.dyr: HYGOV: GMIN is raised to 0.001: the flow is divided by the gate (2 machines: G2, G3)"
    assert errors.count(f"facts-damping: {said}") == 1
    said = "case.dyr: USRMDL: is not modelled: left out (4 machines: G1, G2, G3 and 1 more)"
    assert f"facts-damping: {said}" in errors


def test_limit_that_does_not_admit_the_start_is_widened_and_said(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    system = imported(tmp_path, RAW.read_text(), DYR.read_text().replace("0.05 0.49 2 0", "0.05 0.49 0.5 0"))
    errors = capsys.readouterr().err
    assert (
        "case.dyr: line 9: TGOV1: of G2: valve is 0.849 p.u. at the start; allowed by its limits: 0 to 0.5; VMAX: 0.5"
        in errors
    )
    (governor,) = [g for g in system.governors if g.machine == "G2"]
    assert 0.849 * 1.05 < governor.VMAX < 0.849 * 1.15  # type: ignore[attr-defined]


# Bad input


def one_line(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> str:
    """The one line with which an import is refused."""
    capsys.readouterr()
    assert main(["import", *arguments]) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.count("\n") == 1
    return captured.err


BAD_RAW: list[tuple[Callable[[str], str], str]] = [
    (lambda _: "", "empty; allowed: a PSS/E RAW file of version 23, 32, 33, 34, 35"),
    (lambda t: t.replace(", 33,", ", 30,", 1), "line 1: REV, the version: 30 given; allowed: 23, 32, 33, 34, 35"),
    (lambda t: t.replace("163,", "16x3,", 1), "line 20: generator: PG: '16x3' given; allowed: a number"),
    (lambda t: t.replace("'BUS 3 ", "BUS 3' ", 1), "given; allowed: text with a closing quote"),
    (lambda t: t.replace("4,5,'1 '", "4,55,'1 '", 1), "line 23: branch: J = 55 given; allowed: a bus"),
    (
        lambda t: t.replace("0.085,0.176", "0,0.176", 1),
        "line 23: branch: X = 0 with R = 0.01 given; allowed: two buses, X other than 0, or R and X of 0 for a",
    ),
    (
        lambda t: t.replace("1,'BUS 1       ',16.5,3", "1,'BUS 1       ',16.5,2", 1),
        "generator: none at a bus of type 3 given",
    ),
    (lambda t: t.replace("2,'BUS 2", "1,'BUS 2", 1), "line 5: bus: 1 stands twice; allowed: each bus once"),
    (lambda t: t.replace("8,9,'1 ',0.0119", "8,8,'1 ',0.0119", 1), "bus 8 at both ends given; allowed: two buses"),
    (
        lambda t: t.replace("1,4,0,'1 ',1,1,1", "1,4,0,'1 ',1,2,1", 1).replace("0,0.0576,100", "0,0.0576,0", 1),
        "line 30: transformer: SBASE1 = 0 given; allowed: more than 0",
    ),
    (lambda t: t.split("0 / END OF BUS")[0], "no generator record given; allowed: at least one"),
    (
        lambda t: t.replace("1,4,0,'1 ',1,1,1,0,0,2,'T1          ',1,1,1", "1,4,0,'1 ',1,1,1,0,0,2,'T1 ',0", 1),
        "bus: an island with generators and no bus of type 3 given (2, 3, 4, 5, 6 and 3 more); allowed: such a bus",
    ),
]


@pytest.mark.parametrize(("change", "said"), BAD_RAW)
def test_bad_raw_file_is_told_by_line_and_field(
    change: Callable[[str], str], said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "bad.raw"
    path.write_text(change(RAW.read_text()), encoding="utf-8")
    assert main(["import", str(path)]) == 2
    errors = capsys.readouterr().err
    assert errors.startswith(f"facts-damping: {path}: ")
    assert said in errors


@pytest.mark.parametrize(
    ("before", "after", "said"),
    [
        ("0.05 9.55", "0.05 nine", "line 2: GENROU: value 5: 'nine' given; allowed: a number"),
        (
            "3 'GENROU' 1  5.9 0.03 0.6 0.05 2.35 0 1.7 1.6 0.35 0.5 0.25 0.2 0 0 /",
            "3 'GENROU' 1 5.9 0.03 /",
            "line 4: GENROU: 2 constants given; allowed: 14, Td01",
        ),
        ("3 'GENROU' 1", "2 'GENROU' 1", "line 4: GENROU: a second model of machine 1 at bus 2 given; allowed: one"),
        ("0.5 -0.5 0 0 /", "0.5 -0.5 0 0", "not ended; allowed: a record that `/` ends"),
        ("2 'EXST1'", "1 'EXST1'", "line 6: EXST1: G1 has one of the exciters already; allowed: one"),
    ],
)
def test_bad_dyr_file_is_one_line_with_its_line(
    before: str, after: str, said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "bad.dyr"
    assert before in DYR.read_text()
    path.write_text(DYR.read_text().replace(before, after, 1), encoding="utf-8")
    assert said in one_line([str(RAW), str(path)], capsys)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["nowhere.raw"], "nowhere.raw: no such file; allowed: an existing PSS/E RAW file"),
        ([str(RAW), "nowhere.dyr"], "nowhere.dyr: no such file; allowed: an existing PSS/E DYR file"),
        ([str(DATA / "nine_bus.m"), str(DYR)], "given with nine_bus.m; allowed: with a RAW file"),
        ([str(RAW), "--dynamics", "x.yaml"], "--dynamics x.yaml: given with a RAW file; allowed: with a MATPOWER case"),
    ],
)
def test_files_that_do_not_go_together(arguments: list[str], said: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert said in one_line(arguments, capsys)


def mutated(text: bytes, chance: random.Random) -> bytes:
    """A file with a few bytes changed, cut out, or doubled."""
    changed = bytearray(text)
    for _ in range(chance.randint(1, 4)):
        at = chance.randrange(len(changed))
        kind = chance.randrange(4)
        if kind == 0:
            changed[at] = chance.randrange(256)
        elif kind == 1:
            del changed[at : at + chance.randint(1, 20)]
        elif kind == 2:
            changed[at:at] = changed[at : at + chance.randint(1, 40)]
        else:
            changed[at : at + 1] = chance.choice([b"-", b"9", b"e", b"'", b"/", b",", b"\n", b"1e308", b"nan"])
    return bytes(changed) or b"0"


@pytest.mark.parametrize("kind", ["psse", "matpower"])
def test_mutated_files_are_taken_or_refused_in_lines(
    kind: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    chance, files = random.Random(1), [RAW, DYR] if kind == "psse" else [DATA / "nine_bus.m"]
    texts = {tmp_path / path.name: path.read_bytes() for path in files}
    for _ in range(GRID_FILES if kind == "psse" else GRID_FILES // 4):
        for path, text in texts.items():
            path.write_bytes(mutated(text, chance) if chance.random() < 0.6 else text)
        status = main(["import", *map(str, texts), "--out", str(tmp_path / "a.yaml")])
        captured = capsys.readouterr()
        assert status in (0, 2)
        assert "Traceback" not in captured.err
        assert all(line.startswith("facts-damping: ") for line in captured.err.splitlines())


def test_imported_case_is_checked_as_a_system_is(tmp_path: Path) -> None:
    """And its notes come with it."""
    case_imported: Any = import_case(RAW, DYR)
    assert case_imported.typical == []
    assert [note for note in case_imported.notes if not re.search("--loads|power flow|ZX", note)] == []
