"""Static var compensators of PSS/E cases, which stand where the case has a generator."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from facts_damping.plant.build import build
from facts_damping.plant.grid.power_flow import solve
from facts_damping_grids.psse.conversion import import_case
from facts_damping_validation.psse import folder
from tests.grids.test_psse import DYR, RAW, THREE_BUSES, imported, one_line, raw_with, voltages
from tests.plant.running import slopes

if TYPE_CHECKING:
    from pathlib import Path

    from facts_damping.parameters.plant.system import System

COMPENSATOR = "3 'CSVGN1' 1 20 0 1 0.15 1 0.005 0 1 0 {} /\n"  # of 128 MVA
GENERATOR = "^3,'1 ',85.*$"
HELD = "3,'1 ',{},0,300,-300,1.025,0,128,0,0.2,{},1,1,100,300,10,1,1"


def dyr_with(record: str) -> str:
    """The machines' data with another record for the third one."""
    lines = DYR.read_text(encoding="utf-8").splitlines(keepends=True)
    return "".join(record if line.startswith("3 'GENROU'") else line for line in lines)


def device(system: System) -> Any:
    (only,) = system.devices
    return only


def test_start_of_a_case_of_psse_is_that_of_another_program() -> None:
    """Of PowerSimulationsDynamics.jl (BSD-3, commit f77d3df, test49_x0_init): y, and the voltages of its buses."""
    place = folder() / "CSVGN1"
    case = import_case(place / "3_BUS_System_CSVGN1.raw", place / "3_BUS_System_CSVGN1.dyr")
    assert case.inexact == []
    assert [row["name"] for row in case.content["loads"]] == ["load_2", "load_3"]
    (row,) = case.content["devices"]
    assert (row["CBASE"] - row["Q"] / 1.015**2) / row["MBASE"] == pytest.approx(0.07769908351960009, abs=1e-9)


@pytest.mark.parametrize("step_up", [False, True])
def test_compensator_keeps_the_power_flow_with_its_reactive_power(
    step_up: bool, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Of a machine in its place, which takes reactive power; what acts on a machine is left out, active power stays."""
    raw = raw_with((GENERATOR, HELD.format(5, "0.01,0.1,1.02" if step_up else "0,0,1")))
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
    machine = imported(tmp_path / "a", raw, DYR.read_text())
    capsys.readouterr()
    system = imported(tmp_path / "b", raw, dyr_with(COMPENSATOR.format(60)))
    errors = capsys.readouterr().err
    here = voltages(system)
    for bus, voltage in voltages(machine).items():
        assert here[bus] == pytest.approx(voltage, abs=1e-9), bus
    generation = solve(machine, []).generation["G3"] * 100
    svc, (current,) = device(system), [load for load in system.loads if load.name.startswith("current")]
    assert complex(-current.P, svc.Q) == pytest.approx(generation, abs=1e-6)
    assert (svc.kind, svc.bus) == ("csvgn1", "G3_terminal" if step_up else "B3")
    assert [m.name for m in system.machines] == ["G1", "G2"]
    assert np.abs(slopes(build(system, [], []))).max() < 1e-6
    assert "case.dyr: line 7: SEXS: of G3: does not act on CSVGN1: left out" in errors
    assert "case.dyr: line 4: CSVGN1: of G3: gives 5" in errors
    assert ("controls the voltage at its terminals" in errors) is step_up


@pytest.mark.parametrize(
    ("field", "record", "limit"),
    [
        ("VMAX", "3 'CSVGN1' 1 20 0 1 0.15 1 0.005 0 0.5 0 60 /\n", "0.5"),
        ("VMIN", "3 'CSVGN1' 1 20 0 1 0.15 1 0.005 0 1 0.9 60 /\n", "0.9"),
        ("RMIN", "3 'CSVGN1' 1 20 0 1 0.15 1 0.005 110 1 0 60 /\n", "110"),
    ],
)
def test_limit_that_excludes_the_start_is_widened_and_said(
    field: str, record: str, limit: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    system = imported(tmp_path, raw_with((GENERATOR, HELD.format(0, "0,0,1"))), dyr_with(record))
    errors = capsys.readouterr().err
    svc = device(system)
    y = (60 - svc.Q / 1.025**2) / 128
    moved = {"VMAX": 1.1 * y, "VMIN": 0.9 * y, "RMIN": 0.9 * y * 128}[field]
    assert getattr(svc, field) == pytest.approx(moved, rel=1e-3)
    said = f"CSVGN1: of G3: {field} excludes the start: {limit} is set to {moved:.4g}"
    assert f"case.dyr: line 4: {said}" in errors
    build(system, [], [])


def test_reactor_that_is_too_small_for_the_start_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    paths = [tmp_path / "case.raw", tmp_path / "case.dyr"]
    for path, text in zip(
        paths, (raw_with((GENERATOR, HELD.format(0, "0,0,1"))), dyr_with(COMPENSATOR.format(200))), strict=True
    ):
        path.write_text(text)
    message = one_line([str(path) for path in paths], capsys)
    least = 1.025**2 * (200 - 128)
    assert "case.dyr: line 4: CSVGN1: of G3: Q = " in message
    assert f"Mvar given at 1.025 p.u. of voltage; allowed: at least {least:.4g}, by CBASE and MBASE" in message


def test_short_times_are_those_that_the_device_takes(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """T1 needs T3; a T4 without T2 is none."""
    record = "3 'CSVGN1' 1 20 0.1 0 0 0.0002 0 0 1 0 60 /\n"
    system = imported(tmp_path, raw_with((GENERATOR, HELD.format(0, "0,0,1"))), dyr_with(record))
    svc = device(system)
    assert (svc.T1, svc.T2, svc.T3, svc.T4, svc.T5) == (0.1, 0.0, 0.001, 0.0, 0.001)
    said = "CSVGN1: of G3: T3, T4, T5 below 0.001 s: taken as 0.001 and 0 and 0.001"
    assert said in capsys.readouterr().err


def test_compensator_beside_a_machine_of_its_own_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "case.dyr").write_text(DYR.read_text() + COMPENSATOR.format(60))
    message = one_line([str(RAW), str(tmp_path / "case.dyr")], capsys)
    assert "CSVGN1: a second model of machine 1 at bus 3 given; allowed: one" in message


def test_case_of_compensators_alone_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    records = "".join(f"{n} 'CSVGN1' 1 20 0 1 0.15 1 0.005 -999 9 -9 0 /\n" for n in (101, 102))
    (tmp_path / "case.dyr").write_text(records)
    message = one_line([str(THREE_BUSES), str(tmp_path / "case.dyr")], capsys)
    assert "2 given that become devices or constant currents; allowed: at least one machine" in message
