"""Turbines and governors of the PSS/E library at their limits, and systems with them beside another program."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import pytest

from facts_damping.machine_controls.blocks import SHORTEST
from facts_damping.parameters.field_errors import check
from facts_damping.parameters.plant.system import System
from facts_damping.plant.build import build
from facts_damping.plant.machines import block_controls, blocks
from facts_damping.plant.machines.blocks import SENSED
from facts_damping.small_signal.linearisation import linearise
from facts_damping_grids.psse.conversion import import_case
from tests.plant.test_blocks import POWER, at_rest, control_of, response, sensed

if TYPE_CHECKING:
    from numpy.typing import NDArray

CASES = Path(__file__).parents[2] / "config" / "references" / "psse"
EIGENVALUES = Path(__file__).parents[1] / "data" / "psid_governors.csv"


class Moves(NamedTuple):
    """Signals of a control's blocks, and the slopes of its states."""

    signals: dict[str, float]
    slopes: dict[str, float]


class Diagram:
    """A control, at rest at first, whose inputs and states a test moves."""

    def __init__(self, data: Any) -> None:
        self.control, rest = at_rest(data)
        self.x, self.reference = dict(zip(self.control.states, rest.states.tolist(), strict=True)), rest.reference

    def moves(self, **inputs: float) -> Moves:
        values = np.zeros(len(SENSED) + len(self.control.rows))
        for name, value in {"one": 1.0, **sensed(), "Pref": self.reference, **inputs}.items():
            values[SENSED.index(name)] = value
        x, dx, rows = np.array(list(self.x.values())), np.zeros(len(self.x)), self.control.rows
        blocks.outputs(rows, 0, len(rows), len(SENSED), x, values)
        blocks.derivatives(rows, 0, len(rows), x, values, dx)
        signals = dict(zip(self.control.gives, values[len(SENSED) :].tolist(), strict=True))
        return Moves(signals, dict(zip(self.x, dx.tolist(), strict=True)))

    def settled(self, seconds: float, **inputs: float) -> Moves:
        """After a time at constant inputs."""
        for _ in range(round(seconds / 0.01)):
            for name, slope in self.moves(**inputs).slopes.items():
                self.x[name] += 0.01 * slope
        return self.moves(**inputs)


def test_gas_turbine_gives_the_lower_of_what_governor_valve_and_temperature_allow() -> None:
    assert Diagram(control_of("GAST")).settled(30, Pref=0.9).signals["Pm"] == pytest.approx(0.9)
    assert Diagram(control_of("GAST")).settled(30, Pref=2.0).signals["Pm"] == pytest.approx(1.1, abs=1e-6)  # AT
    assert Diagram(control_of("GAST", VMAX=0.95)).settled(30, Pref=2.0).signals["Pm"] == pytest.approx(0.95)


def test_temperature_of_a_gas_turbine_acts_after_its_lag() -> None:
    """AT + KT (AT - exhaust) at once: 1.1 + 2 (1.1 - 0.8) = 1.7, limited by VMAX."""
    cold = Diagram(control_of("GAST", VMAX=5.0))
    cold.x["fuel"] = 1.7
    assert cold.moves(Pref=9.0).slopes["fuel"] == pytest.approx(0.0, abs=1e-9)
    cold.x["exhaust"] = 1.3
    assert cold.moves(Pref=9.0).slopes["fuel"] == pytest.approx((1.1 - 2 * 0.2 - 1.7) / 0.4)


def test_gas_turbine_above_its_temperature_limit_at_the_start_names_the_limit_and_a_valid_one() -> None:
    _, rest = at_rest(control_of("GAST", AT=0.7))
    (violation,) = rest.violations
    assert violation.field == "AT"
    assert violation.wanted == pytest.approx(POWER)


def test_dead_band_of_wsieg1_is_taken_from_the_speed() -> None:
    band = Diagram(control_of("WSIEG1", DB1=0.002, K=10.0, T1=0.0))
    for omega, seen in ((0.0, 0.0), (0.0015, 0.0), (-0.002, 0.0), (0.003, 0.001), (-0.005, -0.003)):
        assert band.moves(omega=omega).signals["speed"] == pytest.approx(10.0 * seen, abs=1e-12)


@pytest.mark.parametrize(
    ("valve", "power"), [(0.0, 0.0), (0.25, 0.35), (0.5, 0.7), (0.7, 0.825), (0.9, 0.95), (1.0, 1.0125)]
)
def test_power_of_a_valve_is_on_the_line_through_its_points_which_goes_on_straight(valve: float, power: float) -> None:
    curve = Diagram(control_of("WSIEG1"))
    curve.x["valve"] = valve
    assert curve.moves().signals["steam"] == pytest.approx(power)


def test_valve_without_points_gives_its_position() -> None:
    points = dict.fromkeys(("GV2", "PGV2", "GV3", "PGV3"), 0.0)
    straight = Diagram(control_of("WSIEG1", **points))
    assert straight.moves().signals["steam"] == pytest.approx(straight.x["valve"])
    assert straight.x["valve"] == pytest.approx(POWER)


@pytest.mark.parametrize("hertz", [0.02, 0.5, 1.0, 1.5])
def test_dead_time_of_a_second_is_exact_at_swing_frequencies(hertz: float) -> None:
    """To 1e-4 of the throttle's part, beside which the speed has one."""
    data, s = control_of("DEGOV", TD=1.0), 2j * np.pi * hertz
    prompt = response(control_of("DEGOV", TD=0.0), "omega", s) - POWER
    assert abs(response(data, "omega", s) - POWER - np.exp(-s) * prompt) < 1e-4 * abs(prompt)


@pytest.mark.parametrize("TD", [0.002, 0.01, 0.024, 0.05, 1.0])
def test_dead_time_has_no_pole_that_is_faster_than_the_shortest_time_constant(TD: float) -> None:
    engine = block_controls.control(control_of("DEGOV", TD=TD))
    names = [name for name in engine.states if name.startswith("torque")]
    (row,) = (row for row in engine.rows if row["kind"] == blocks.DEAD_TIME)
    A = np.zeros((len(names), len(names)))
    row["state"], row["source"][0] = 0, SENSED.index("none")
    for i, x in enumerate(np.eye(len(names))):
        blocks.derivatives(np.array([row]), 0, 1, x, np.zeros(len(SENSED) + 1), A[:, i])
    poles = np.linalg.eigvals(A)
    assert poles.real.max() < 0.0
    assert np.abs(poles).max() <= 1.0 / SHORTEST + 1e-9


def test_diesel_engine_without_droop_takes_the_speed_back_and_is_deaf_to_its_power_reference() -> None:
    engine = Diagram(control_of("DEGOV"))
    assert engine.moves(Pref=5.0).slopes == engine.moves().slopes
    slow = engine.settled(2.0, omega=-0.01)
    assert slow.slopes["throttle"] > 0.0
    assert slow.signals["Pm"] == pytest.approx(slow.signals["torque"] * 0.99)
    assert engine.settled(20.0, omega=-0.01).signals["throttle"] == pytest.approx(2.0, abs=1e-2)  # TMAX
    assert engine.moves(omega=-0.01).slopes["throttle"] == 0.0


def test_gates_move_and_stop_at_their_limits() -> None:
    pid = Diagram(control_of("PIDGOV"))
    assert pid.settled(1.5, omega=-0.05).slopes["gate"] == pytest.approx(0.04)
    assert pid.settled(10.0, omega=-0.05).slopes["gate"] == 0.0
    assert pid.settled(5.0, omega=0.5).slopes["gate"] == pytest.approx(-0.04)
    woodward = Diagram(control_of("WPIDHY", PMAX=0.85))
    assert woodward.settled(2.0, omega=-0.05).slopes["gate"] == pytest.approx(0.03)
    opened = woodward.settled(20.0, omega=-0.05)
    assert opened.slopes["gate"] == 0.0
    assert opened.signals["gate"] == pytest.approx(1.0, abs=1e-3)
    assert opened.signals["Pm"] == pytest.approx(0.85 + 0.3 * 0.05)


def test_water_column_answers_to_an_opening_gate_with_less_power_first() -> None:
    gate = Diagram(control_of("WPIDHY"))
    gate.x["gate"] += 0.05
    assert gate.moves().signals["Pm"] < POWER
    assert gate.settled(20.0, Pref=gate.reference).signals["Pm"] > POWER


@pytest.mark.parametrize("model", ["IEEEG1", "WSIEG1"])
def test_second_shaft_of_a_steam_turbine_gives_power_with_a_machine_alone(model: str) -> None:
    """The machine without another at JBUS has the power of K1, K3, K5, K7, as in PSS/E (OpenIPSL: PMECH_HP)."""
    shares, points = {"K1": 0.2, "K2": 0.1, "K3": 0.4, "K5": 0.2, "K7": 0.1}, {}
    if model == "WSIEG1":
        points = dict.fromkeys(("GV2", "PGV2", "GV3", "PGV3"), 0.0)
    for JBUS, share in ((0.0, 0.9), (7.0, 1.0)):
        turbine = Diagram(control_of(model, JBUS=JBUS, PMAX=2.0, **shares, **points))
        assert turbine.x["valve"] == pytest.approx(POWER / share)


def test_servo_without_a_time_constant_is_one_of_the_shortest() -> None:
    servo = Diagram(control_of("IEEEG1", T3=0.0))
    assert servo.moves(Pref=servo.reference + 1e-6).slopes["valve"] == pytest.approx(1e-6 / SHORTEST)


# Beside PowerSimulationsDynamics.jl


def eigenvalues_of(name: str) -> NDArray[np.complex128]:
    rows = [line.split(",") for line in EIGENVALUES.read_text(encoding="utf-8").splitlines()]
    return np.array([complex(float(row[1]), float(row[2])) for row in rows if row[0] == name])


@pytest.mark.parametrize(
    ("dyr", "name"),
    [
        ("TGOV1/ThreeBus_TGOV1.dyr", "test22_eigvals"),
        ("HYGOV/ThreeBus_HYGOV.dyr", "test31_eigvals"),
        ("PIDGOV/ThreeBus_PIDGOV_PowerFlag.dyr", "test58_eigvals_PowerFlag"),
        ("PIDGOV/ThreeBus_PIDGOV_GateFlag.dyr", "test58_eigvals_GateFlag"),
        ("WPIDHY/ThreeBus_WPIDHY.dyr", "test60_eigvals"),
        ("DEGOV1/ThreeBus_DEGOV1_nodelay_flag0.dyr", "test63_eigvals_Flag0"),
        ("DEGOV1/ThreeBus_DEGOV1_nodelay_flag1.dyr", "test63_eigvals_Flag1"),
        ("GAST/ThreeBus_GAST.dyr", "test21_eigvals"),
    ],
)
def test_eigenvalues_of_imported_cases_are_those_of_another_program(dyr: str, name: str) -> None:
    """GAST starts at its temperature limit, which holds there: the reference is above it."""
    path = CASES / dyr
    built = build(check(System, import_case(path.parent / "ThreeBusMulti.raw", path).content, dyr), [], [])
    if "GAST" in dyr:
        built.plant.controls["power_offset"] += 0.1
    ours, theirs = list(np.linalg.eigvals(linearise(built)[0])), eigenvalues_of(name)
    assert len(ours) == len(theirs)
    for value in theirs:
        nearest = min(ours, key=lambda other: abs(other - value))
        assert abs(nearest - value) < 1e-6
        ours.remove(nearest)
