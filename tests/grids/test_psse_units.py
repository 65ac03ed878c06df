"""What stands for the generators of a PSS/E case: machines, infinite sources, constant currents."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

import numpy as np
import pytest

from facts_damping.cli.main import main
from facts_damping.plant.build import build
from facts_damping.plant.grid.power_flow import solve
from facts_damping.small_signal.linearisation import linearise
from facts_damping_grids.psse.conversion import import_case
from tests.grids.test_psse import DYR, RAW, THREE_BUSES, imported, one_line, raw_with, voltages

if TYPE_CHECKING:
    from pathlib import Path

    from facts_damping.parameters.plant.system import System

ROUND = "8 0.03 0.4 0.05 6.175 0.05 1.8 1.7 0.3 0.55 0.25 0.2 0.1 0.8"


def equal_voltages(system: System, other: System) -> None:
    """Of the buses of the other system."""
    here = voltages(system)
    for bus, voltage in voltages(other).items():
        assert here[bus] == pytest.approx(voltage, abs=1e-9), bus


# Infinite sources


def test_infinite_source_stands_behind_its_impedance(tmp_path: Path) -> None:
    """GENCLS with H = 0; E = V + ZSORCE conj(S / V), ZSORCE in p.u. of MBASE. It is no place of a series device."""
    generator = r"^   101,'1 ',(.*),     0,   100.000, 0.00000E\+0, 1.00000E-5,"
    raw, count = re.subn(generator, r"   101,'1 ',\1,0,500,0.01,0.2,", THREE_BUSES.read_text(), flags=re.MULTILINE)
    assert count == 1
    for folder in ("a", "b"):
        (tmp_path / folder).mkdir()
    machines = imported(tmp_path / "a", raw, f"101 'GENROU' 1 {ROUND} /\n102 'GENROU' 1 {ROUND} /\n")
    system = imported(tmp_path / "b", raw, f"101 'GENCLS' 1 0.0 0.0 /\n102 'GENROU' 1 {ROUND} /\n")
    equal_voltages(system, machines)
    flow = solve(machines, [])
    V, S, z = flow.by_bus["B101"], flow.generation["G101"], complex(0.01, 0.2) / 5
    E = V + z * np.conj(S / V)
    (source,) = system.infinite_buses
    assert source.V * np.exp(1j * np.radians(source.angle)) == pytest.approx(E, abs=1e-9)
    (impedance,) = system.transformers
    assert (impedance.from_bus, impedance.to_bus, impedance.rating) == ("B101", source.bus, 500)
    assert complex(impedance.r, impedance.x) == pytest.approx(5 * z)
    assert {line.name for line in system.lines} == {"line_101_102", "line_101_103", "line_102_103"}
    assert {bus.nominal_voltage for bus in system.buses} == {138}
    assert [(machine.name, machine.slack) for machine in system.machines] == [("G102", False)]


def test_several_sources_beside_a_machine_keep_the_power_flow(tmp_path: Path) -> None:
    """Each keeps the reactive power that the case stores for it: two at one bus, a machine among them, and a third."""
    half = "2,'{} ',81.5,{},300,-300,1.025,0,96,0,0.2,0,0,1,1,100,300,10,1,1"
    two = ("^2,'1 ',163.*$", "\n".join(half.format(*row) for row in (("1", 40), ("S", -20))))
    dyr = DYR.read_text()
    more = "2 'GENROU' S 6.0 0.03 0.5 0.05 3.33 0 1.7 1.6 0.3 0.5 0.25 0.2 0 0 /\n"
    for folder in ("a", "b"):
        (tmp_path / folder).mkdir()
    machines = imported(tmp_path / "a", raw_with(two), dyr + more)
    dyr = "".join(line + "\n" for line in dyr.splitlines() if not line.startswith("3 "))
    system = imported(tmp_path / "b", raw_with(two), f"{dyr}2 'GENCLS' S 0 0 /\n3 'gencls' 1 0 0 /\n")
    equal_voltages(system, machines)
    assert [source.name for source in system.infinite_buses] == ["G2_S", "G3"]
    assert not any(machine.slack for machine in system.machines)
    theirs, ours = solve(machines, []).generation, solve(system, []).generation
    assert theirs["G2_1"].imag - theirs["G2_S"].imag == pytest.approx(0.6)
    for name in ("G1", "G2_1"):
        assert ours[name] == pytest.approx(theirs[name], abs=1e-9)


def test_inertia_below_zero_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "case.dyr").write_text("101 'GENCLS' 1 0 0 /\n102 'GENCLS' 1 -1 0 /\n")
    message = one_line([str(THREE_BUSES), str(tmp_path / "case.dyr")], capsys)
    assert "case.dyr: line 2: GENCLS: H = -1 given; allowed: above 0, or 0 for an infinite source" in message


def test_case_without_machines_has_a_power_flow_and_no_modes(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A source and an inverter; without a source nothing would hold the voltage."""
    system = imported(tmp_path, THREE_BUSES.read_text(), "101 'GENCLS' 1 0 0 /\n102 'REGCA1' 1 0 0.02 /\n")
    assert system.machines == []
    assert voltages(system)["B102"] == pytest.approx(1.02 * np.exp(-1j * np.radians(0.944)), abs=1e-5)
    assert linearise(build(system, [], []))[0].shape == (0, 0)
    assert main(["modes", str(tmp_path / "case.yaml")]) == 0
    (tmp_path / "case.dyr").write_text("101 'REGCA1' 1 0 0 /\n")
    message = one_line([str(THREE_BUSES), str(tmp_path / "case.dyr")], capsys)
    said = "2 given that become constant currents; allowed: at least one machine or infinite source among them"
    assert f"generator: {said}" in message


# Constant currents

INVERTERS = ("3 'GENROU'", "3 'REGCA1'"), ("3 'SEXS' 1 ", "3 'REECA1' 1 "), ("2 'GENROU'", "2 'WT4G1'")


def with_inverters(text: str) -> str:
    """The machines' data, of which two become inverters."""
    for before, after in INVERTERS:
        assert before in text
        text = text.replace(before, after)
    return text


def test_inverters_are_constant_currents_that_keep_the_power_flow(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Of the power that they have where they hold their voltages."""
    for folder in ("a", "b"):
        (tmp_path / folder).mkdir()
    machines = imported(tmp_path / "a", RAW.read_text(), DYR.read_text())
    capsys.readouterr()
    system = imported(tmp_path / "b", RAW.read_text(), with_inverters(DYR.read_text()))
    errors = capsys.readouterr().err
    said = "REGCA1: of G3: has 14 of 15 constants: a constant current stands for the inverter"
    assert f"case.dyr: line 4: {said}" in errors
    assert "line 9: TGOV1: of G2: is left out with its machine, for which a constant current stands" in errors
    equal_voltages(system, machines)
    assert [machine.name for machine in system.machines] == ["G1"]
    currents = {load.name: load for load in system.loads if load.P < 0}
    assert {name: load.P for name, load in currents.items()} == pytest.approx({"current_G2": -163, "current_G3": -85})
    assert {load.P_fractions.current for load in currents.values()} == {1.0}
    assert {load.Q_fractions.current for load in currents.values()} == {1.0}
    assert main(["modes", str(tmp_path / "b" / "case.yaml")]) == 0


def test_slack_that_is_an_inverter_hands_over_to_the_largest_machine(tmp_path: Path) -> None:
    for folder in ("a", "b"):
        (tmp_path / folder).mkdir()
    machines = imported(tmp_path / "a", RAW.read_text(), DYR.read_text())
    system = imported(tmp_path / "b", RAW.read_text(), DYR.read_text().replace("1 'GENROU'", "1 'REGFM_A1'"))
    equal_voltages(system, machines)
    assert [machine.name for machine in system.machines if machine.slack] == ["G2"]


def test_generator_without_a_record_is_a_constant_current(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """It is not given the data of some machine; without any DYR file all are."""
    lines = [line for line in DYR.read_text().splitlines() if not line.startswith("3 ")]
    system = imported(tmp_path, RAW.read_text(), "\n".join(lines))
    said = "case.raw: line 21: generator: G3 has no record in case.dyr: a constant current of its P and Q"
    assert said in capsys.readouterr().err
    assert [machine.name for machine in system.machines] == ["G1", "G2"]
    system = imported(tmp_path, RAW.read_text())
    said = "no dynamic data: typical data of synchronous machines (Kundur, table 4.2) (3 machines: G1, G2, G3)"
    assert said in capsys.readouterr().err
    assert [machine.name for machine in system.machines] == ["G1", "G2", "G3"]


# Step-up transformers of generator records


def test_step_up_of_a_record_leaves_the_bus_as_it_is(tmp_path: Path) -> None:
    """The machine's terminals are at V / t + Z I behind it, with V, P and Q of the bus as without it."""
    for folder in ("a", "b"):
        (tmp_path / folder).mkdir()
    plain = imported(tmp_path / "a", RAW.read_text(), DYR.read_text())
    behind = (
        "^2,'1 ',163,0,300,-300,1.025,0,192,0,0.2,0,0,1,",
        "2,'1 ',163,0,300,-300,1.025,0,192,0,0.2,0.01,0.1,1.05,",
    )
    system = imported(tmp_path / "b", raw_with(behind), DYR.read_text())
    equal_voltages(system, plain)
    before, after = solve(plain, []), solve(system, [])
    current = 1.05 * np.conj(before.generation["G2"] / before.by_bus["B2"])
    V = before.by_bus["B2"] / 1.05 + complex(0.01, 0.1) / 1.92 * current
    assert after.by_bus["G2_terminal"] == pytest.approx(V, abs=1e-9)
    assert after.generation["G2"] == pytest.approx(V * np.conj(current), abs=1e-9)
    assert np.linalg.eigvals(linearise(build(system, [], []))[0]).real.max() < 1e-6


# Conventions of records


def generator(name: str, **values: object) -> tuple[str, str]:
    """A change of a generator's record: of its fields by their places."""
    places = {"ID": 1, "QG": 3, "QT": 4, "QB": 5, "VS": 6, "IREG": 7, "MBASE": 8, "ZX": 10, "STAT": 14}
    line = next(line for line in RAW.read_text().splitlines() if re.match(rf"{name},'1 ',[\d.]+,0,300", line))
    fields = line.split(",")
    for field, value in values.items():
        fields[places[field]] = str(value)
    return f"^{re.escape(line)}$", ",".join(fields)


@pytest.mark.parametrize(("base", "rating"), [("0", 100.0), ("", 100.0), ("-128", 128.0)])
def test_base_of_a_machine_that_is_none(base: str, rating: float, tmp_path: Path) -> None:
    """0 is the system base; of one below 0 the magnitude counts."""
    system = imported(tmp_path, raw_with(generator("3", MBASE=base)), DYR.read_text())
    assert {machine.name: machine.rating for machine in system.machines}["G3"] == rating


def test_identifiers_have_quotes_blanks_and_any_letters(tmp_path: Path) -> None:
    """A machine and its records are found by them, in capital letters."""
    raw = raw_with(generator("2", ID="' a#'"), generator("3", ID='"W "'))
    dyr = re.sub(r"^(2 '\w+' *) 1 ", r"\1 'A# ' ", DYR.read_text(), flags=re.MULTILINE)
    system = imported(tmp_path, raw, re.sub(r"^(3 '\w+' *) 1 ", r"\1 w ", dyr, flags=re.MULTILINE))
    assert [machine.name for machine in system.machines] == ["G1", "G2", "G3"]
    assert [exciter.machine for exciter in system.exciters] == ["G1", "G2", "G3"]
    again = raw_with(("^3,'1 ',85.*$", "3,'W ',40,0,99,-99,1.025,0,64,0,0.2/\n3,'W#',45,0,99,-99,1.025,0,64,0,0.2/"))
    assert [m.name for m in imported(tmp_path, again).machines] == ["G1", "G2", "G3_W", "G3_Wx"]


def test_generator_out_of_service_is_none(tmp_path: Path) -> None:
    system = imported(tmp_path, raw_with(generator("3", STAT=0)), DYR.read_text())
    assert [machine.name for machine in system.machines] == ["G1", "G2"]
    assert [exciter.machine for exciter in system.exciters] == ["G1", "G2"]


@pytest.mark.parametrize(
    ("values", "V"),
    [
        ({}, 1.025),
        ({"QG": 300}, 1.01),  # at the limit that keeps the voltage there
        ({"QG": -300}, 1.025),
        ({"QG": 0, "QT": 0, "QB": 0}, 1.01),
        ({"IREG": 8}, 1.01),  # of another bus
        ({"IREG": 2}, 1.025),  # of its own
    ],
)
def test_machine_that_does_not_hold_its_bus_starts_at_the_solved_voltage(
    values: dict[str, object], V: float, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bus = ("^2,'BUS 2       ',18,2,1,1,1,1.0250", "2,'BUS 2       ',18,2,1,1,1,1.0100")
    system = imported(tmp_path, raw_with(bus, generator("2", **values)), DYR.read_text())
    assert {machine.name: machine.V for machine in system.machines}["G2"] == V
    said = "G2 starts at the voltage of the bus table, 1.01 p.u., not at 1.025"
    assert (said in capsys.readouterr().err) == (V == 1.01)


def test_machines_at_a_bus_keep_the_reactive_power_of_the_file(tmp_path: Path) -> None:
    """They start with it; what the solution has more is shared by ratings."""
    rows = (("1", 81.5, 30, 64), ("2", 81.5, -10, 128))
    two = "\n".join(f"2,'{mark}',{P},{Q},300,-300,1.025,0,{S},0,0.2,0,0,1,1" for mark, P, Q, S in rows)
    system = imported(tmp_path, raw_with(("^2,'1 ',163.*$", two)))
    Q = {name: 100.0 * power.imag for name, power in solve(system, []).generation.items()}
    rest = Q["G2_1"] + Q["G2_2"] - 20.0
    assert abs(rest) > 1.0
    assert Q["G2_1"] == pytest.approx(30.0 + rest / 3.0)
    assert Q["G2_2"] == pytest.approx(-10.0 + 2.0 * rest / 3.0)


def test_classical_machine_has_its_damping_and_no_exciter(tmp_path: Path) -> None:
    """Its field is constant: an exciter's record has no effect in PSS/E either."""
    dyr = "".join(f"{line}\n" for line in DYR.read_text().splitlines() if not line.startswith("3 'GENROU'"))
    system = imported(tmp_path, RAW.read_text(), dyr + "3 'GENCLS' 1 2.35 1.5 /\n")
    (machine,) = [machine for machine in system.machines if machine.name == "G3"]
    assert (machine.model, machine.H, machine.D, machine.Xd1) == ("classical", 2.35, 1.5, 0.2)
    assert [exciter.machine for exciter in system.exciters] == ["G1", "G2"]


def test_damping_below_zero_is_taken(tmp_path: Path) -> None:
    """It adds -D / (2 H) to the growth of all modes together."""
    growth = []
    for D in ("0", "-2"):
        (tmp_path / D).mkdir()
        dyr = DYR.read_text().replace("3.33 0 1.7", f"3.33 {D} 1.7")
        growth.append(linearise(build(imported(tmp_path / D, RAW.read_text(), dyr), [], []))[0].trace())
    assert growth[1] - growth[0] == pytest.approx(2 / (2 * 3.33), rel=1e-6)


def test_load_compensation_goes_to_the_exciter(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Of either record, wherever it stands; without an exciter it has none to act on."""
    dyr = "3 'COMP' 1 0.04 /\n1 'IEEEVC' 1 0.01 0.05 /\n2 'COMP' 1 0.04 /\n"
    dyr += "".join(f"{line}\n" for line in DYR.read_text().splitlines() if not line.startswith("2 'EXST1'"))
    system = imported(tmp_path, RAW.read_text(), dyr)
    exciters = [exciter.model_dump() for exciter in system.exciters]
    parts = {row["machine"]: (row["RC"], row["XC"]) for row in exciters}
    assert parts == {"G1": (0.01, 0.05), "G3": (0.0, -0.04)}
    assert "line 3: COMP: of G2: has no exciter to act on: left out" in capsys.readouterr().err
    (tmp_path / "bad.dyr").write_text(dyr.replace("'SEXS' 1    0.4", "'SEXS' 1 nought"))
    said = "SEXS: value 1: 'nought' given; allowed: a number"
    assert said in one_line([str(RAW), str(tmp_path / "bad.dyr")], capsys)


def test_control_whose_record_lacks_constants_is_left_out_with_what_acts_on_it(tmp_path: Path) -> None:
    """All else stays; constants at the end of a record that all versions of a model may lack are 0."""
    path = tmp_path / "case.dyr"
    text = DYR.read_text().replace("0.5 -0.5 0 0 /", "0.5 -0.5 /")
    path.write_text(text)
    whole = import_case(RAW, path)
    assert whole.inexact == []
    path.write_text(text.replace("50 0.05 10 -10 0.05 0.02 1.0 /", "/").replace("0.05 0.49 2 0 2.1 7.0 0.1", "0.05"))
    case = import_case(RAW, path)
    assert sorted(case.inexact) == [
        "case.dyr: line 10: ST2CUT: of G2: has no exciter to act on: left out",
        "case.dyr: line 6: EXST1: of G2: has 5 of 12 constants: left out",
        "case.dyr: line 9: TGOV1: of G2: has 1 of 7 constants: left out",
    ]
    assert {row.name: row.left_out for row in case.records if row.left_out} == {"EXST1": 1, "TGOV1": 1, "ST2CUT": 1}
    for table in ("machines", "exciters", "governors", "stabilisers"):
        left = [row for row in whole.content[table] if table == "machines" or row["machine"] != "G2"]
        assert case.content.get(table, []) == left


def test_reactance_of_the_source_that_is_not_that_of_the_machine_is_told(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    imported(tmp_path, raw_with(*(generator(n, ZX=0.25) for n in "12"), generator("3", ZX=0.3)), DYR.read_text())
    (line,) = [line for line in capsys.readouterr().err.splitlines() if "ZX" in line]
    assert line == "facts-damping: case.dyr: line 4: GENROU: of G3: ZX of the RAW file is not X''d: X''d counts"


def test_distance_to_the_voltages_of_the_file_is_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Of three buses that PSS/E has solved, and of one that is moved."""
    dyr = f"101 'GENCLS' 1 0 0 /\n102 'GENROU' 1 {ROUND} /\n"
    imported(tmp_path, THREE_BUSES.read_text(), dyr)
    (apart,) = re.findall(r"power flow: within (\S+) p\.u\. of the file's voltages", capsys.readouterr().err)
    assert float(apart) < 1e-5
    imported(tmp_path, THREE_BUSES.read_text().replace("0.99341,  -8.7697", "0.98341,  -8.7697"), dyr)
    said = "within 0.01 p.u. of the file's voltages; at bus 103 0.99341 p.u., -8.770 deg, in the file 0.98341 p.u."
    assert said in capsys.readouterr().err
