"""Shares of machines that inverters replace: the flows stay, and what is left is a system like any other."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from facts_damping.case.loading import load_case, read_system
from facts_damping.errors import InputError
from facts_damping.plant.build import build
from facts_damping.plant.dynamics import derivatives
from facts_damping.plant.grid.power_flow import solve
from facts_damping.plant.inverter_sources import begin
from facts_damping.plant.model import copy, workspace

if TYPE_CHECKING:
    from facts_damping.parameters.plant.system import System

FOLLOWING: dict[str, Any] = {"model": "REGCA1", **dict.fromkeys(("Lvplsw", "Accel", "Khv", "Tfltr"), 0), "Tg": 0.02}
FOLLOWING |= {"Rrpwr": 10, "Brkpt": 0.9, "Zerox": 0.4, "Lvpl1": 1.22, "Volim": 1.2, "Lvpnt1": 0.8, "Lvpnt0": 0.4}
FOLLOWING |= {"Iolim": -1.3, "Iqrmax": 99, "Iqrmin": -99}


def shared(*shares: float) -> System:
    """The system with inverters, with a share for each area."""
    return read_system("two_area_ibr", [f"inverter_shares.{i}.share={share}" for i, share in enumerate(shares)])


@pytest.mark.parametrize("shares", [(0.25, 0.25), (0.75, 0.0), (1.0, 0.3), (0.0, 1.0)])
def test_flows_stay_whatever_the_shares(shares: tuple[float, float]) -> None:
    before, system = read_system("two_area"), shared(*shares)
    flow, reference = solve(system), solve(before)
    np.testing.assert_allclose(flow.voltage, reference.voltage, atol=1e-10)
    for machine in before.machines:
        share = shares[machine.area == "area_2"]
        whole = reference.generation[machine.name]
        assert flow.generation.get(f"IBR_{machine.name}", 0.0) == pytest.approx(share * whole, abs=1e-8)
        assert flow.generation.get(machine.name, 0.0) == pytest.approx((1.0 - share) * whole, abs=1e-8)
    assert sum(unit.rating for unit in system.units) == pytest.approx(sum(m.rating for m in before.machines))


def test_without_a_share_the_system_is_that_without_inverters() -> None:
    assert shared(0, 0).model_dump(exclude={"description"}) == read_system("two_area").model_dump(
        exclude={"description"}
    )


def test_whole_machines_leave_with_their_controls_and_pmus_move_to_inverters() -> None:
    system = shared(1.0, 0.5)
    assert [m.name for m in system.machines] == ["G3", "G4"]
    assert {row.machine for row in (*system.exciters, *system.stabilisers, *system.governors)} == {"G3", "G4"}
    assert [pmu.machine for pmu in system.pmus] == ["IBR_G1", "IBR_G2", "G3", "G4", None]
    assert [unit.name for unit in system.units if unit.slack] == ["IBR_G2"]


@pytest.mark.parametrize("shares", [(0.5, 0.5), (1.0, 0.0), (0.0, 1.0)])
def test_plant_starts_at_the_power_flow_of_several_solutions(shares: tuple[float, float]) -> None:
    """With loads of constant current and an area of inverters alone the network has a second solution, at 1.23 p.u."""
    sets = [f"system.inverter_shares.{i}.share={share}" for i, share in enumerate(shares)]
    case = load_case(None, ["system=two_area_ibr", "controllers=[]", "system.loads.*.P_fractions={current: 1}", *sets])
    built = build(case.system, case.run.devices, [])
    work, state = workspace(built.plant, built.state), copy(built.state)
    begin(built.plant, work)
    slope = np.zeros(len(state.x))
    derivatives(built.plant, state.x, state.reference, state.source, 0, slope, work)
    assert np.abs(slope).max() < 1e-8


def test_scenario_s_dispatch_is_that_of_machine_and_inverter_together() -> None:
    share = {"machines": ["G1"], "share": 0.25, "inverter": FOLLOWING}
    case = load_case(None, ["system=smib", "scenario=heavy", "controllers=[]", f"system.inverter_shares=[{share}]"])
    whole = load_case(None, ["system=smib", "scenario=heavy", "controllers=[]"]).system.machines[0].P or 0.0
    powers = [unit.P for unit in case.system.units]
    assert powers == pytest.approx([0.75 * whole, 0.25 * whole])
    assert whole != read_system("smib").machines[0].P


def test_constant_of_one_share_is_not_that_of_another_beside_an_alias() -> None:
    system = read_system("two_area_ibr", ["inverter_shares.0.controls.1.Kp=3"])
    assert [getattr(c, "Kp", None) for c in system.inverter_controls[1::2]] == [3.0, 3.0, 1.0, 1.0]


def test_stored_run_has_its_inverters_and_no_shares() -> None:
    case = load_case(None, ["system=two_area_ibr", "controllers=[]", "system.inverter_shares.0.share=0.3"])
    again = load_case(None).system.model_validate(case.document()["system"])
    assert again.inverter_shares == []
    assert [i.rating for i in again.inverters] == pytest.approx([270.0, 270.0, 450.0, 450.0])


@pytest.mark.parametrize(
    ("sets", "message"),
    [
        (["inverter_shares.0.area=north"], "inverter_shares.0.area: north given; allowed: area_1, area_2"),
        (["inverter_shares.1.area=area_1", "inverter_shares.1.share=0.7"], "1.2 of G1, 1.2 of G2 given; allowed: at"),
        (["inverter_shares.0.machines=[G1]"], "inverter_shares.0: a share needs either `area` or `machines`"),
        (["inverter_shares.0.inverter.Tg=0.001"], "inverter_shares.0.inverter: Tg must be 0 or at least 0.002 s"),
        (["inverter_shares.0.controls.0.Imax=a"], "inverter_shares.0.controls.0.Imax: 'a' given; allowed: a number"),
        (["inverter_shares.0.share=1", "inverter_shares.1.share=1"], "machines: none given; allowed: at least one, an"),
    ],
)
def test_share_that_cannot_be_is_an_error_of_its_field(sets: list[str], message: str) -> None:
    with pytest.raises(InputError) as error:
        read_system("two_area_ibr", sets)
    assert message in str(error.value)


def test_inverter_without_power_stands_at_the_slack_s_bus_alone() -> None:
    row = {"name": "A", "bus": "B1", "area": "area_1", "rating": 10, "V": 1.0, **FOLLOWING}
    with pytest.raises(InputError, match=r"inverters: A.P: none given; allowed: at the bus of the slack"):
        read_system("two_area", [f"inverters=[{row}]"])
    flow = solve(read_system("two_area", [f"inverters=[{ {**row, 'bus': 'B2'} }]"]))
    assert flow.generation["A"].real / flow.generation["G2"].real == pytest.approx(10 / 900)


@pytest.mark.parametrize("kind", ["GFM", "VSM"])
def test_inverters_alone_need_one_that_forms_the_grid(kind: str) -> None:
    row = {"GFM": 3, "VSM": 5}[kind]
    shares = {0: 1, 1: 0, row: 1}
    system = read_system("two_area_ibr", [f"inverter_shares.{i}.share={share}" for i, share in shares.items()])
    names = {i.name: i.forming for i in system.inverters}
    assert (system.machines, names) == (
        [],
        {"IBR_G1": False, "IBR_G2": False, f"{kind}_G3": True, f"{kind}_G4": True},
    )
    assert [unit.name for unit in system.units if unit.slack] == ["IBR_G2"]
