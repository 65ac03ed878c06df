"""PSS/E's conventions of the network: zero impedances, loads, DC lines, islands, limits; and what is unusual."""

from __future__ import annotations

import math
import re
from typing import TYPE_CHECKING

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from facts_damping.case.loading import load_system
from facts_damping.cli.main import main
from facts_damping.errors import InputError
from facts_damping.parameters.plant.system import System
from facts_damping.plant.build import build
from facts_damping.plant.grid.power_flow import solve
from facts_damping.small_signal.linearisation import linearise
from facts_damping_grids.psse.conversion import import_case
from facts_damping_grids.psse.loads import load_model
from tests.grids.test_psse import DYR, RAW, imported, raw_with, voltages

if TYPE_CHECKING:
    from pathlib import Path

BUS = ("^0 / END OF BUS", "10,'NEW         ',230,1,1,1,1,1,0\n0 / END OF BUS")
LINE = "0.01,0.085,0.176"
HYGOV = "2 'HYGOV' 1 0.05 0.4 5 0.05 {Tg} 0.2 1 0.01 1 1.2 0 0.1 /\n"


# Zero impedances


@pytest.mark.parametrize("X", ["0", "0.0001", "-0.00005"])
def test_zero_impedance_line_joins_its_buses(X: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A load behind one has the voltage and the modes that it has at the bus itself; the line may be opened."""
    line = ("^0 / END OF BRANCH", f"5,10,'1 ',0,{X},0,0,0,0,0,0,0,0,1\n0 / END OF BRANCH")
    (tmp_path / "a").mkdir()
    plain = imported(tmp_path / "a", RAW.read_text(), DYR.read_text())
    joined = imported(tmp_path, raw_with(BUS, line, ("^5,'1 ',1,1,1,125", "10,'1 ',1,1,1,125")), DYR.read_text())
    assert "line_5_10: zero impedance: a reactance of 1e-05 p.u. stands for it" in capsys.readouterr().err
    solved = voltages(joined)
    assert solved["B10"] == pytest.approx(solved["B5"], abs=2e-5)
    for name, voltage in voltages(plain).items():
        assert solved[name] == pytest.approx(voltage, abs=5e-6)
    ours, theirs = (np.linalg.eigvals(linearise(build(system, [], []))[0]) for system in (plain, joined))
    for value in ours[np.abs(ours) > 1e-3]:
        assert np.abs(theirs - value).min() < 5e-5


def test_generators_at_buses_that_are_one_hold_one_voltage(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """That of the swing bus; 0.015 p.u. between them would drive 1500 p.u. through the line."""
    bus = ("^0 / END OF BUS", "10,'NEW         ',16.5,2,1,1,1,1.025,0\n0 / END OF BUS")
    line = ("^0 / END OF BRANCH", "10,1,'1 ',0,0,0,0,0,0,0,0,0,0,1\n0 / END OF BRANCH")
    unit = ("^1,'1 ',71.64", "10,'1 ',30,0,300,-300,1.025,0,100,0,0.2,0,0,1,1\n1,'1 ',71.64")
    (tmp_path / "a").mkdir()
    plain, system = imported(tmp_path / "a", RAW.read_text()), imported(tmp_path, raw_with(bus, line, unit))
    assert "bus 10 has the voltage of bus 1, to which it is joined without impedance" in capsys.readouterr().err
    assert {m.name: m.V for m in system.machines if m.name in ("G1", "G10")} == {"G1": 1.04, "G10": 1.04}
    for name, voltage in voltages(plain).items():
        assert voltages(system)[name] == pytest.approx(voltage, abs=1e-5)


def test_zero_arm_of_a_star_and_zero_transformer(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Of windings whose impedances add up, one arm is 0: the other two are those between their buses."""
    star = "4,5,6,'1 ',1,1,1,0,0,2,'T',1,1,1\n0.01,0.1,100,0.02,0.2,100,0.03,0.3,100,1,0\n1,0,0\n1,0,0\n1,0,0"
    ideal = "5,10,0,'1 ',1,1,1,0,0,2,'T',1,1,1\n0,0,100\n1.02,0,0\n1,0"
    system = imported(tmp_path, raw_with(BUS, ("^0 / END OF TRANSFORMER", f"{star}\n{ideal}\n0 / END OF TRANSFORMER")))
    assert "transformers with X = 0" in capsys.readouterr().err
    x = {t.name: (t.r, t.x) for t in system.transformers}
    assert x["T4_5_6_1"] == pytest.approx((0.01, 0.1))
    assert x["T4_5_6_2"] == pytest.approx((0.0, 1e-5))
    assert x["T4_5_6_3"] == pytest.approx((0.02, 0.2))
    solved = voltages(system)
    assert solved["B5"] == pytest.approx(solved["B10"] * 1.02, abs=1e-6)


def test_ratio_far_from_one_and_negative_resistance_are_taken(tmp_path: Path) -> None:
    """A base voltage that does not fit: the voltage of the bus is as far from 1, and all else as it is."""
    (tmp_path / "a").mkdir()
    record = r"^1,4,0,'1 ',1,1,1,.*\n0,0.0576,100\n1,0,"
    unit = ("^1,'1 ',71.64,0,300,-300,1.04", "1,'1 ',71.64,0,300,-300,2.6")
    negative, far = (f"1,4,0,'1 ',1,1,1,0,0,2,'T1',1,1,1\n-0.001,0.0576,100\n{ratio},0," for ratio in ("1", "2.5"))
    plain = imported(tmp_path / "a", raw_with((record, negative)))
    other = imported(tmp_path, raw_with((record, far), unit))
    assert plain.ranges == other.ranges == "physical"  # where a resistance is negative, too
    solved = voltages(other)
    for name, voltage in voltages(plain).items():
        assert solved[name] == pytest.approx(voltage * (2.5 if name == "B1" else 1.0), abs=1e-9)


# Loads


@pytest.mark.parametrize(
    ("text", "P", "Q"),
    [
        ("P: current, Q: impedance", {"current": 1.0}, {"impedance": 1.0}),
        ("q:power", {"impedance": 1.0}, {"power": 1.0}),
        ("P: 40 impedance 60 current", {"impedance": 0.4, "current": 0.6}, {"impedance": 1.0}),
        ("P:40% impedance 60%current, Q: 100 power", {"impedance": 0.4, "current": 0.6}, {"power": 1.0}),
    ],
)
def test_load_model_of_an_option(text: str, P: dict[str, float], Q: dict[str, float]) -> None:
    assert load_model(text) == (P, Q)


@pytest.mark.parametrize(
    "text", ["", "P", "P: voltage", "P: 40 impedance", "P: current, P: power", "P: 50 power 50 power"]
)
def test_load_model_that_is_none_is_refused_with_what_is_allowed(text: str) -> None:
    with pytest.raises(
        InputError, match=r"--loads: .* given; allowed: P and Q, each impedance, current, power, or perc"
    ):
        load_model(text)


@settings(max_examples=50, deadline=None)
@given(st.integers(0, 100), st.integers(0, 100), st.permutations(["impedance", "current", "power"]))
def test_percentages_of_a_load_model_are_its_fractions(first: int, second: int, kinds: list[str]) -> None:
    percent = dict(zip(kinds, (first, min(second, 100 - first), max(0, 100 - first - second)), strict=True))
    said = " ".join(f"{value} {kind}" for kind, value in percent.items())
    assert pytest.approx({k: v / 100 for k, v in percent.items() if v}) == load_model(f"P: {said}").P


def test_constant_power_of_loads_is_converted_as_asked(tmp_path: Path) -> None:
    """Constant current and admittance of a record stay; the power flow is the same in any case."""
    (tmp_path / "case.raw").write_text(raw_with(("^5,'1 ',1,1,1,125,50,0,0,0,0", "5,'1 ',1,1,1,100,40,10,5,15,-5")))
    usual, asked = (
        import_case(tmp_path / "case.raw", load_model=load_model(text))
        for text in ("P: impedance", "P: 30 current 70 power")
    )
    systems = [System.model_validate(case.content) for case in (usual, asked)]
    assert voltages(systems[1]) == voltages(systems[0])
    loads = [{load.name: (load.P_fractions.current, load.P_fractions.power) for load in s.loads} for s in systems]
    assert loads[0] == {
        "load_5": (0, 0),
        "load_6": (0, 0),
        "load_8": (0, 0),
        "load_5_current": (1, 0),
        "load_5_impedance": (0, 0),
    }
    assert loads[1] == loads[0] | {f"load_{n}": (0.3, 0.7) for n in (5, 6, 8)}
    assert any("becomes P: 30 current 70 power, Q: impedance; --loads" in note for note in asked.notes)


# DC lines


def test_dc_line_is_two_loads(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """That of the IEEE 300-bus case, 100 MW at the inverter. At its stored voltages the network takes 31.7 and 39 Mvar.

    (GridPACK, `data_sets/raw/300bus_v23_no0imp_pslf.raw`, BSD; what is missing at buses 119 and 120.)
    """
    dc = "'DC',1,6.2,-100,460,300,0,0.1\n4,4,20,15,0,6.8,115,0.7476,0.99365\n6,4,18,20,0,6.8,115,0.7476,0.9722\n"
    buses = (
        ("^4,'BUS 4       ',230,1,1,1,1,1.0000", "4,'BUS 4       ',230,1,1,1,1,1.04257"),
        ("^6,'BUS 6       ',230,1,1,1,1,1.0000", "6,'BUS 6       ',230,1,1,1,1,1.0352"),
    )
    system = imported(tmp_path, raw_with(*buses, ("^0 / END OF TWO", f"{dc}0 / END OF TWO")))
    rectifier, inverter = (load for load in system.loads if load.name.startswith("dc"))
    assert (rectifier.bus, inverter.bus, inverter.P) == ("B4", "B6", -100.0)
    assert pytest.approx(6.2 * (100 / 460) ** 2) == rectifier.P + inverter.P
    assert pytest.approx((31.7, 39.0), rel=0.08) == (rectifier.Q, inverter.Q)
    assert rectifier.P_fractions.power == 1.0
    assert "the DC line from bus 4 to bus 6 is two constant loads, without its control" in capsys.readouterr().err


@pytest.mark.parametrize(("control", "power"), [("1,6.2,100", 100.0), ("2,6.2,200", 92.0 + 6.2 * 0.04)])
def test_dc_line_holds_the_power_of_its_rectifier_or_its_current(control: str, power: float, tmp_path: Path) -> None:
    dc = f"'DC',{control},460,300,0,0.1\n4,4,20,15,0,6.8,230,0.7476,1\n6,4,18,20,0,6.8,230,0.7476,1\n"
    system = imported(tmp_path, raw_with(("^0 / END OF TWO", f"{dc}0 / END OF TWO")))
    rectifier, inverter = (load for load in system.loads if load.name.startswith("dc"))
    assert pytest.approx(power) == rectifier.P
    current = -inverter.P / 460
    assert pytest.approx(6.2 * current**2) == rectifier.P + inverter.P


# Islands


ALONE = "11,'A',230,{kind},1,1,1,1,0\n12,'B',230,1,1,1,1,1,0\n0 / END OF BUS"
BETWEEN = ("^0 / END OF BRANCH", f"11,12,'1 ',{LINE},0,0,0,0,0,0,0,1\n0 / END OF BRANCH")
UNIT = ("^0 / END OF GENERATOR", "11,'1 ',5,0,9,-9,1,0,10,0,0.2,0,0,1,1\n0 / END OF GENERATOR")


@pytest.mark.parametrize(
    ("kind", "unit", "said"),
    [(1, False, "an island without a generator in service"), (3, True, "an island beside the largest one")],
)
def test_islands_beside_the_grid_are_left_out_with_a_note(
    kind: int, unit: bool, said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    more = [("^0 / END OF BUS", ALONE.format(kind=kind)), BETWEEN, *([UNIT] if unit else [])]
    load = ("^0 / END OF LOAD", "12,'1 ',1,1,1,5,1,0,0,0,0\n0 / END OF LOAD")
    (tmp_path / "a").mkdir()
    plain = voltages(imported(tmp_path / "a", RAW.read_text()))
    assert voltages(imported(tmp_path, raw_with(*more, load))) == pytest.approx(plain, abs=1e-12)
    assert f"case.raw: of {said}: left out (2 buses: 11, 12)" in capsys.readouterr().err


def test_island_with_generators_and_no_swing_bus_is_refused(tmp_path: Path) -> None:
    (tmp_path / "case.raw").write_text(raw_with(("^0 / END OF BUS", ALONE.format(kind=2)), BETWEEN, UNIT))
    with pytest.raises(InputError, match=r"an island with generators and no bus of type 3 given \(11, 12\); allowed"):
        import_case(tmp_path / "case.raw")


def test_winding_at_an_isolated_bus_is_out(tmp_path: Path) -> None:
    """The two others go on, as without it."""
    record = "2,7,10,'1 ',1,1,1,0,0,2,'T',{},1,1\n0,0.0625,100,0,0.1,100,0,0.09,100,1,0\n1,0,0\n1,0,0\n1,0,0"
    systems = []
    for i, (bus, status) in enumerate((("10,'NEW',33,4", 1), ("10,'NEW',33,1", 3))):
        (folder := tmp_path / str(i)).mkdir()
        place = (r"^2,7,0,'1 ',1,1,1,.*\n0,0.0625,100\n1,0,.*\n1,0$", record.format(status))
        load = ("^0 / END OF BUS", f"{bus}\n0 / END OF BUS")
        systems.append(imported(folder, raw_with(load, place)))
    assert [t.name for t in systems[0].transformers] == [t.name for t in systems[1].transformers]
    assert "T2_7_10_3" not in {t.name for t in systems[0].transformers}


# Voltages


def test_generator_at_a_reactive_limit_has_the_voltage_of_the_solved_case(tmp_path: Path) -> None:
    """One below its limit holds VS, whatever voltage its bus had."""
    limited = ("^2,'1 ',163,0,300,-300", "2,'1 ',163,5,5,-300")
    buses = [(f"^({n},'BUS {n}       ',[0-9.]+,2,1,1,1),1.0250", r"\1,1.0100") for n in (2, 3)]
    solved = voltages(imported(tmp_path, raw_with(limited, *buses)))
    assert abs(solved["B2"]) == pytest.approx(1.01)
    assert abs(solved["B3"]) == pytest.approx(1.025)


# Ranges


def test_unusual_values_are_told_and_the_system_can_be_read_again(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """`HYGOV` with a servo of 205 s; X'q above Xq; no leakage; X above 10 p.u."""
    machine = "1 'GENROU' 1 8.96 0.31 0.05 0.05 23.64 2.6 0.146 0.061 0.0608 0.097 0.04 0 0 0 /\n"
    dyr = re.sub(r"^1 'GENROU'.*\n", machine, DYR.read_text(), flags=re.MULTILINE)
    dyr = re.sub(r"^2 'TGOV1'.*\n", HYGOV.format(Tg="205"), dyr, flags=re.MULTILINE)
    assert dyr.count(" 205 ") == 1
    line = ("^0 / END OF BRANCH", "4,5,'2 ',0.01,15.9,0,0,0,0,0,0,0,0,1\n0 / END OF BRANCH")
    system = imported(tmp_path, raw_with(line), dyr)
    errors = capsys.readouterr().err
    assert "case.dyr: line 9: HYGOV: of G2: Tg = 205.0 is unusual; usual: at most 100 s" in errors
    assert "lines: line_4_5_2: x = 15.9 is unusual; usual: at most 10 p.u./km" in errors
    assert "case.dyr: line 2: GENROU: of G1: unusual: Xl < Xq2 < Xq1 < Xq must hold" in errors
    assert system.ranges == "physical"
    assert yaml.safe_load((tmp_path / "case.yaml").read_text())["ranges"] == "physical"
    assert np.isfinite(np.linalg.eigvals(linearise(build(system, [], []))[0])).all()


def test_ranges_are_usual_where_nothing_is_unusual(tmp_path: Path) -> None:
    imported(tmp_path, RAW.read_text(), DYR.read_text())
    assert "ranges" not in yaml.safe_load((tmp_path / "case.yaml").read_text())


def test_limits_that_equations_need_hold_in_physical_ranges(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """All of them are told at once; what is unusual alone is not among them."""
    dyr = DYR.read_text().replace("2 'TGOV1' 1   0.05 0.49 2 0 2.1 7.0 0.1 /\n", HYGOV.format(Tg="-20.5"))
    dyr = re.sub(r"^3 'GENROU' 1 +[\d.]+ ", "3 'GENROU' 1 999 ", dyr, flags=re.MULTILINE)
    dyr = re.sub(r"^1 'GENROU' 1 +[\d.]+ ", "1 'GENROU' 1 -8.96 ", dyr, flags=re.MULTILINE)
    (tmp_path / "case.dyr").write_text(dyr)
    assert main(["import", str(RAW), str(tmp_path / "case.dyr"), "--out", str(tmp_path / "a.yaml")]) == 2
    errors = capsys.readouterr().err.splitlines()
    assert len(errors) == 2
    assert "case.dyr: line 2: GENROU: of G1: Td01: -8.96 given; allowed: greater than 0, in s" in errors[0]
    assert "case.dyr: line 9: HYGOV: of G2: Tg: -20.5 given; allowed: greater than or equal to 0.002, in s" in errors[1]


@settings(max_examples=60, deadline=None)
@given(st.floats(-1e5, 1e5), st.sampled_from(["x", "r", "b", "tap", "V", "Tg"]))
def test_physical_ranges_admit_what_has_an_equation(value: float, field: str) -> None:
    """And nothing else: no reactance of 0, no ratio, voltage or time constant that is not positive."""
    content = {
        "name": "two",
        "ranges": "physical",
        "buses": [{"name": "A", "nominal_voltage": 1}, {"name": "B", "nominal_voltage": 1}],
        "lines": [{"name": "line", "from": "A", "to": "B", "r": 0.1, "x": 0.1, "b": 0.0}],
        "transformers": [{"name": "T", "from": "A", "to": "B", "rating": 100, "x": 0.1, "tap": 1.0}],
        "machines": [
            {"name": "G", "bus": "A", "rating": 100, "V": 1.0, "slack": True, "H": 3, "model": "classical", "Xd1": 0.3}
        ],
        "governors": [{"machine": "G", "model": "HYGOV", "Tg": 0.2}],
        "pmus": [{"name": "G", "machine": "G"}],
    }
    table = {"tap": "transformers", "V": "machines", "Tg": "governors"}.get(field, "lines")
    content[table][0][field] = value  # type: ignore[index]
    has_equation = {"x": value != 0.0, "r": True, "b": True, "Tg": value >= 0.002}.get(field, value > 0.0)
    if has_equation and abs(value) > 1e-29:
        assert getattr(getattr(System.model_validate(content), table)[0], field) == value
    elif not has_equation:
        with pytest.raises(ValueError, match="1 validation error"):
            System.model_validate(content)


def test_range_of_a_system_says_which_it_is(tmp_path: Path) -> None:
    """A file of one's own is held to the usual ranges unless it says otherwise."""
    system = imported(tmp_path, RAW.read_text())
    content = system.model_dump(by_alias=True, exclude_none=True)
    content["machines"][0]["V"] = 1.7
    for ranges, admitted in (("usual", False), ("physical", True)):
        (tmp_path / f"{ranges}.yaml").write_text(yaml.safe_dump(content | {"ranges": ranges}))
        if admitted:
            assert load_system(str(tmp_path / f"{ranges}.yaml")).machines[0].V == 1.7
        else:
            with pytest.raises(
                InputError, match=r"machines.0.V: 1.7 given; allowed: less than or equal to 1.5, in p.u."
            ):
                load_system(str(tmp_path / f"{ranges}.yaml"))
    assert math.isfinite(solve(system, []).residual)
