"""Blocks that limit, gate and switch: what they do at the start and at their limits, as the standards have it."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from facts_damping.errors import InputError
from facts_damping.machine_controls.blocks import saturation
from facts_damping.parameters.plant.system import System
from facts_damping.plant.build import build
from facts_damping.plant.dynamics import derivatives
from facts_damping.plant.grid.power_flow import solve
from facts_damping.plant.machines import block_controls, block_rest, blocks
from facts_damping.plant.machines.blocks import SENSED
from facts_damping.plant.model import workspace
from facts_damping_library import MODELS
from facts_damping_library.page import diagram
from tests.plant.running import shipped
from tests.plant.test_blocks import FIELD, POWER, VOLTAGE, at_rest, control_of, ieeest, response, sensed


class Moved:
    """A control at its start, whose states and inputs a test sets."""

    def __init__(self, data: Any, **changes: float) -> None:
        self.control, self.rest = at_rest(data, **changes)
        self.x, self.dx = self.rest.states.copy(), np.zeros(len(self.rest.states))
        self.values = np.zeros(len(SENSED) + len(self.control.rows))
        for name, value in {"one": 1.0, **sensed(**changes), "Vref": self.rest.reference}.items():
            self.values[SENSED.index(name)] = value

    def __call__(self, signal: str, **inputs: float) -> float:
        """A signal with new inputs; the derivatives follow."""
        for name, value in inputs.items():
            self.values[SENSED.index(name)] = value
        rows = self.control.rows
        blocks.outputs(rows, 0, len(rows), len(SENSED), self.x, self.values)
        blocks.derivatives(rows, 0, len(rows), self.x, self.values, self.dx)
        return float(self.values[len(SENSED) + self.control.gives.index(signal)])

    def set(self, state: str, value: float) -> None:
        self.x[self.control.states.index(state)] = value

    def slope(self, state: str) -> float:
        return float(self.dx[self.control.states.index(state)])

    def settle(self, **inputs: float) -> None:
        """100 ms in steps of 0.1 ms with these inputs."""
        for _ in range(1000):
            self("Vs", **inputs)
            self.x += 1e-4 * self.dx


def test_pi_regulator_stops_integrating_at_its_limit_and_leaves_it_at_once() -> None:
    """IEEE Std 421.5, annex E: the output is KP u + the integral; at a limit the integral does not go on."""
    data = control_of("ST8C", TR=0.0)
    moved = Moved(data)
    moved.set("VPI", 98.0)
    for error, output, slope in ((0.1, 98.5, 0.4), (0.3, 99.0, 0.0), (-0.3, 96.5, -1.2)):
        assert moved("VPI", Vref=error, Vc=0.0) == pytest.approx(output)
        assert moved.slope("VPI") == pytest.approx(slope)


@pytest.mark.parametrize(("ILR", "taken_off"), [(1.5, 4.54 * 0.3), (2.0, 0.0)])
def test_limiter_of_the_field_current_acts_at_the_start_where_the_current_is_above_it(
    ILR: float, taken_off: float
) -> None:
    _, rest = at_rest(control_of("ESST1A", ILR=ILR))
    assert rest.reference == pytest.approx(VOLTAGE + (FIELD + taken_off) / 50.0)
    assert rest.violations == []


def test_supply_at_its_ceiling_is_no_violation_at_the_start() -> None:
    """VBMAX cuts VB = KP Vt off, so VM is larger; VR carries it: KPM VR, as the integral is not needed."""
    data = control_of("ESST4B", VBMAX=2.0, KIM=0.0, KG=0.0)
    moved = Moved(data)
    assert moved.rest.violations == []
    assert moved("VM") == pytest.approx(FIELD / 2.0)
    assert moved("VR") == pytest.approx(FIELD / 2.0 / data.KPM)


def test_limit_of_the_field_current_cuts_the_output_of_st6b() -> None:
    """VR is at most KLR (KCI ILR - Ifd), but not below VRMIN; a start above it names ILR."""
    moved = Moved(control_of("ST6B", ILR=1.8))
    for current, VR in ((1.85, 17.33 * (1.06 * 1.8 - 1.85)), (3.0, -9.0)):
        assert moved("Efd", Ifd=current) == pytest.approx(VR * VOLTAGE)
    _, rest = at_rest(control_of("ST6B", ILR=1.75))
    (violation,) = rest.violations
    assert violation.field == "ILR"
    assert violation.wanted == pytest.approx((FIELD / VOLTAGE / 17.33 + FIELD) / 1.06)
    assert at_rest(control_of("ST6B", KLR=0.0, ILR=1.75))[1].violations == []


def test_bridge_without_negative_current_leaves_the_field_to_its_crowbar() -> None:
    for RCRFD, field_voltage in ((10.0, 4.0), (0.0, FIELD)):
        moved = Moved(control_of("SCRX", RCRFD=RCRFD))
        assert moved("Efd", Ifd=0.4) == pytest.approx(FIELD)
        assert moved("Efd", Ifd=-0.4) == pytest.approx(field_voltage)


@pytest.mark.parametrize(
    ("model", "VCL", "VCU", "passed"),
    [
        ("IEEEST", 0.9, 1.1, (False, True, False)),
        ("IEEEST", 0.0, 1.1, (True, True, False)),
        ("IEEEST", 0.0, 0.0, (True,) * 3),
        ("ST2CUT", -0.15, 0.1, (False, True, False)),
        ("ST2CUT", -0.25, 0.1, (True, True, False)),
        ("ST2CUT", 0.0, 0.0, (True,) * 3),
    ],
)
def test_stabiliser_gives_nothing_outside_its_range_of_voltage(
    model: str, VCL: float, VCU: float, passed: tuple[bool, ...]
) -> None:
    """That of ST2CUT is about the voltage at the start, VCL < Vt - Vt0 < VCU (PSS/E; ANDES has the same)."""
    moved = Moved(control_of(model, VCL=VCL, VCU=VCU), Vt0=VOLTAGE)
    limited = moved("limited", omega=0.003)
    assert limited != 0.0
    for voltage, whether in zip((0.8, 1.0, 1.2), passed, strict=True):
        assert moved("Vs", Vt=voltage, omega=0.003) == (limited if whether else 0.0)


def test_washout_of_st2cut_without_a_numerator_is_a_lag() -> None:
    """1 / (1 + s T4), as PSS/E has it of IEE2ST, too (OpenIPSL); its output at rest is not zero then."""
    data, s = control_of("ST2CUT", T3=0.0), 2j
    washed = control_of("ST2CUT")
    assert response(data, "omega", s) == pytest.approx(response(washed, "omega", s) / (washed.T3 * s))
    assert at_rest(data)[1].gives == pytest.approx(data.K2 * POWER)
    assert at_rest(washed)[1].gives == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize("exciter", [{"model": "SEXS"}, {"model": "static", "KA": 200, "TR": 0.01}])
def test_system_is_at_rest_where_the_input_of_a_stabiliser_is_not_washed_out(exciter: dict[str, Any]) -> None:
    """IEEEST with T6 = 0 passes the electrical power on; references make up for it."""
    sexs = {"TATB": 0.1, "TB": 10, "K": 100, "TE": 0.05, "EMIN": -4, "EMAX": 5}
    control = {"machine": "G2"} | exciter | (sexs if exciter["model"] == "SEXS" else {})
    stabiliser = control_of("IEEEST", IC=3.0, T5=0.0, T6=0.0, KS=0.1).model_dump() | {"machine": "G2"}
    content = shipped("kundur_12_6").model_dump(by_alias=True, exclude_none=True)
    system = System.model_validate(content | {"exciters": [control], "stabilisers": [stabiliser]})
    plant, state, _, _ = build(system, [], [])
    dx = np.ones_like(state.x)
    derivatives(plant, state.x, np.zeros(0), state.source, 0, dx, workspace(plant, state))
    assert np.abs(dx).max() < 1e-9


def test_power_switches_pss2c_with_hysteresis() -> None:
    """On from PSSON 0.3 up, off from PSSOFF 0.2 down, between them as it was."""
    moved = Moved(control_of("PSS2C"))
    for power, on in ((0.8, 1.0), (0.25, 1.0), (0.15, 0.0), (0.25, 0.0), (0.35, 1.0)):
        moved.settle(Pe=power)
        assert moved("on") == pytest.approx(on, abs=1e-9)
        assert moved("Vs", omega=0.003) == pytest.approx(on * moved("limited"))
    asleep = Moved(control_of("PSS2C"), Pe=0.1)
    assert [asleep("on"), asleep("Vs", omega=0.003)] == pytest.approx([0.0, 0.0])
    always = Moved(control_of("PSS2C", PSSON=-1.0), Pe=0.1)
    assert always("on") == 1.0
    assert "on" not in always.control.states


def test_inputs_of_pss2b_may_be_beyond_their_limits_at_the_start() -> None:
    moved = Moved(control_of("PSS2B", VS2MAX=0.5))
    assert moved.rest.violations == []
    assert moved("in_2") == 0.5
    assert moved("Vs") == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize(("model", "voltage"), [("EXAC1", 3.0), ("ESAC1A", 3.0)])
def test_voltage_of_an_alternator_does_not_fall_below_zero_and_saturates(model: str, voltage: float) -> None:
    """VFE = KE VE + SE(VE) VE + KD Ifd, SE(3) = 0.5."""
    moved = Moved(control_of(model))
    moved.set("VE", voltage)
    assert moved("VFE") == pytest.approx((1.05 + 0.5) * voltage + 0.38 * FIELD)
    moved.set("VE", 0.0)
    moved.set("VR" if model == "EXAC1" else "VA", -5.0)
    assert moved("Efd") == 0.0
    assert moved.slope("VE") == 0.0


@pytest.mark.parametrize(
    ("points", "none"),
    [((2.0, 0.1, 3.0, 0.5), False), ((3.0, 0.5, 2.0, 0.1), False), ((2.0, 0.0, 3.0, 0.5), True), ((0, 0, 0, 0), True)],
)
def test_saturation_goes_through_both_points_in_any_order(points: tuple[float, ...], *, none: bool) -> None:
    """SE of 0 is none at all, as S(1.0) of machines in PSS/E."""
    data = control_of("IEEET1", **dict(zip(("E1", "SE1", "E2", "SE2"), points, strict=True)))
    A, B = saturation(data)
    assert (B == 0.0) == none
    for E, SE in () if none else ((2.0, 0.1), (3.0, 0.5)):
        value = B * (E - A) ** 2 / E
        assert value == pytest.approx(SE)


@pytest.mark.parametrize("model", ["IEEET1", "IEEEX1", "EXDC1", "EXDC2", "ESDC2A", "IEEET2"])
def test_self_excited_exciter_with_KE_of_0_starts_with_a_tenth_of_its_regulator(model: str) -> None:
    """KE = VRMAX / (10 Efd) - SE(Efd), as OpenIPSL's `calculate_dc_exciter_params` has it of PSS/E."""
    data = control_of(model, KE=0.0, E1=1.5, E2=2.5, VRMAX=6.0)
    excited = block_rest.self_excited(block_controls.control(data), data, FIELD)
    rest = block_rest.at_rest(excited, [data], sensed(), {"Efd": FIELD}, ["Vref"])
    assert rest.states[excited.states.index("VR")] == pytest.approx(0.6)
    assert rest.references[0] == pytest.approx(VOLTAGE + 0.6 / data.KA)
    (gain,) = [row["p"][0] for row in excited.rows if row["kind"] == blocks.FIELD]
    A, B = saturation(data)
    assert gain == pytest.approx((0.6 - B * (FIELD - A) ** 2) / FIELD)


@pytest.mark.parametrize(
    "filters",
    [
        {"A1": 0.1, "A2": 0.0, "A3": 0.2, "A4": 0.0, "A5": 0.05, "A6": 0.003},
        {"A1": 0.1, "A2": 0.01, "A3": 0.2, "A4": 0.0, "A5": 0.05, "A6": 0.003},
        {"A1": 0.1, "A2": 0.0, "A3": 0.2, "A4": 0.02, "A5": 0.05, "A6": 0.003},
        {"A1": 0.0, "A2": 0.0, "A3": 0.2, "A4": 0.0, "A5": 0.05, "A6": 0.0},
        {"A1": 1.013, "A2": 0.013, "A3": 0.0, "A4": 0.0, "A5": 1.013, "A6": 0.113},
    ],
)
def test_filters_of_ieeest_may_have_any_order(filters: dict[str, float]) -> None:
    data, s = control_of("IEEEST", **filters), 4j
    assert response(data, "omega", s) == pytest.approx(ieeest(s, data), rel=1e-5)


def test_stabiliser_acts_behind_the_regulator_of_esst1a_with_vos_2() -> None:
    data, s = control_of("ESST1A", VOS=2.0, KF=0.0, TA=0.0, ILR=3.0), 4j
    assert response(data, "Vs", s) == pytest.approx(1.0)


def test_input_that_is_not_modelled_is_refused() -> None:
    with pytest.raises(InputError, match="IEEEST of G1: IC: 6 given; allowed: 0, 1, 2, 3, 4, 5"):
        block_controls.control(control_of("IEEEST", IC=6.0))


def test_exciter_with_load_compensation_controls_the_voltage_behind_it() -> None:
    """PSS/E's IEEEVC: |Vt + (RC + j XC) It|; at the start the reference is this and Efd over the gain."""
    content = shipped("kundur_12_6").model_dump(by_alias=True, exclude_none=True)
    exciter = {"machine": "G2", "model": "SEXS", "TATB": 0.1, "TB": 10, "K": 100, "TE": 0.05, "EMIN": -4, "EMAX": 5}
    systems = [
        System.model_validate(content | {"exciters": [exciter | load]}) for load in ({}, {"RC": 0.02, "XC": -0.06})
    ]
    flow = solve(systems[0], [])
    m = next(m for m in systems[0].machines if m.name == "G2")
    V: complex = flow.by_bus[m.bus]
    current = (flow.generation["G2"] / V).conjugate() * systems[0].base_power / m.rating
    plain, compensated = (build(system, [], []) for system in systems)
    references = [built.plant.controls["Vref"][1] for built in (plain, compensated)]
    assert references[1] - references[0] == pytest.approx(abs(V + (0.02 - 0.06j) * current) - abs(V))
    plant, state, dx = compensated.plant, compensated.state, np.ones_like(compensated.state.x)
    derivatives(plant, state.x, np.zeros(0), state.source, 0, dx, workspace(plant, state))
    assert np.abs(dx).max() < 1e-9


def test_filter_of_too_high_an_order_and_infinite_gain_are_refused() -> None:
    """Data of another program may have any number; neither is a block that can be made."""
    with pytest.raises(InputError, match=r"PSS2A of G1: M N = 100 given; allowed: at most 20"):
        block_controls.control(control_of("PSS2A", M=50.0, N=2.0))
    without_droop = control_of("TGOV1").model_copy(update={"R": 0.0})
    with pytest.raises(InputError, match=r"TGOV1 of G1: an infinite gain given"):
        block_controls.control(without_droop)


def test_diagram_tells_constants_apart_that_stand_on_one_line() -> None:
    """ST2CUT's lag of a T3 of 0: its gain and its time follow from the same fields."""
    (lagging,) = [line for line in diagram(MODELS["ST2CUT"]) if line.endswith("lagging")]
    assert "(float(T3 == 0.0 < T4)) / (1 + s (0.0 if T3 else T4))" in lagging
