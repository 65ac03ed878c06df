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
    """GENCLS with H = 0; E = V + ZSORCE conj(S / V), ZSORCE in p.u. of MBASE."""
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
    (line,) = [line for line in system.lines if line.to_bus == source.bus]
    assert line.from_bus == "B101"
    assert complex(line.r, line.x) == pytest.approx(z)
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


def test_case_of_sources_alone_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "case.dyr").write_text("101 'GENCLS' 1 0 0 /\n102 'GENCLS' 1 0 0 /\n")
    message = one_line([str(THREE_BUSES), str(tmp_path / "case.dyr")], capsys)
    assert "generator: none that swings given, 2 in service; allowed: at least one machine" in message


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
    assert "case.dyr: line 4: REGCA1: of G3: a constant current stands for the inverter" in errors
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
