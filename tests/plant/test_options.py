"""The plant's options against other programs and books: saturation, loads, controls, taps, long lines.

Of eigenvalues near zero: no angle is a reference, and without governor or damping no speed is held, so zero is a
double eigenvalue of one eigenvector. Round-off of size e moves that pair by sqrt(e), and a simple eigenvalue s near
it by e / |s|^2, which says nothing about the model: below CLOSE they are not compared there.
"""

from __future__ import annotations

import csv
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from scipy.linalg import expm

from facts_damping.parameters.plant.grid import Line
from facts_damping.parameters.plant.machines import Machine
from facts_damping.plant.grid.network import line_section
from facts_damping.plant.grid.power_flow import solve
from facts_damping.small_signal.linearisation import linearise
from tests.independent import kundur_circuits
from tests.independent.reference_cases import CURRENT, IMPEDANCE, MACHINES, MIXED_P, MIXED_Q, POWER
from tests.plant.running import REFERENCES, changed, figures, follow, moved, plant, shipped, slopes
from tests.small_signal.test_modes import furthest

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

    from facts_damping.parameters.plant.system import System

CLOSE = 0.01  # 1/s
SATURATION = {"S10": 0.0392, "S12": 0.2227}
STATIC = {"exciters": [{"machine": g, "model": "static", "KA": 200, "TR": 0.01} for g in MACHINES]}
FEEDBACK = {"exciters": [{**exciter, "TR": 0, "KF": 0.001, "TF": 0.1} for exciter in STATIC["exciters"]]}
REDUCED = {"exciters": [{**exciter, "TB": 10.0, "TC": 1.0} for exciter in STATIC["exciters"]]}
REDUCED_FEEDBACK = {"exciters": [{**exciter, "KF": 0.001, "TF": 0.1} for exciter in REDUCED["exciters"]]}
STABILISERS = {"stabilisers": [{"machine": g} for g in MACHINES]}  # the defaults are the book's
TURBINE = {"R": 0.05, "r": 0.5, "Tr": 2.0, "Tf": 0.05, "Tg": 0.2, "rate_max": 10, "Tw": 1.0, "At": 1.2, "Dt": 0.5}
GOVERNORS = {"governors": [{"machine": g, **TURBINE, "q_nl": 0.08} for g in MACHINES]}
TAPS = [
    {"name": "T1", "from": "B1", "to": "B5", "rating": 450, "x": 0.15},
    {"name": "T5", "from": "B1", "to": "B5", "rating": 450, "x": 0.15, "tap": 1.03, "phase_shift": 2},
    {"name": "T2", "from": "B2", "to": "B6", "rating": 900, "x": 0.15, "tap": 0.97},
]


def system() -> System:
    return shipped("kundur_12_6")


def machines(**fields: Any) -> dict[str, Any]:
    """The machines with other data."""
    return {"machines": [{**m.model_dump(), **fields} for m in system().machines]}


def loads(P: dict[str, float], Q: dict[str, float], **fields: Any) -> dict[str, Any]:
    """The loads with fractions of their active and reactive power."""
    return {"loads": [{**load.model_dump(), "P_fractions": P, "Q_fractions": Q, **fields} for load in system().loads]}


def tapped() -> dict[str, Any]:
    """G1 at two transformers that are not alike, a tap at G2, and a capacitor with losses."""
    others_kept = [t.model_dump(by_alias=True) for t in system().transformers if t.name not in {"T1", "T2"}]
    first, *others = (shunt.model_dump() for shunt in system().shunts)
    return {"transformers": TAPS + others_kept, "shunts": [{**first, "P": 10.0}, *others]}


def book() -> dict[str, Any]:
    """What example 12.6 assumes of machines and loads, saturation as GENROU has it."""
    return machines(**SATURATION) | loads(CURRENT, IMPEDANCE)


def exciters(name: str) -> dict[str, Any]:
    """The exciters of a shipped system."""
    return {"exciters": [exciter.model_dump() for exciter in shipped(name).exciters]}


CASES: dict[str, Callable[[], dict[str, Any]]] = {
    "taps": tapped,
    "damping": lambda: machines(D=2.0),
    "saturation": lambda: machines(**SATURATION),
    "current": lambda: loads(CURRENT, IMPEDANCE),
    "power": lambda: loads(POWER, POWER),
    "mixture": lambda: loads(MIXED_P, MIXED_Q),
    "static": lambda: STATIC,
    "static_feedback": lambda: FEEDBACK,
    "stabiliser": lambda: STATIC | STABILISERS,
    "governor": lambda: GOVERNORS,
    "stabiliser_governor": lambda: STATIC | STABILISERS | GOVERNORS,
    "book_manual": book,
    "book_thyristor": lambda: book() | STATIC,
    "book_thyristor_stabiliser": lambda: book() | STATIC | STABILISERS,
    "dc": lambda: exciters("kundur_12_6_dc"),
    "reduction": lambda: REDUCED,
    "reduction_feedback": lambda: REDUCED_FEEDBACK,
    "book_dc": lambda: book() | exciters("kundur_12_6_dc"),
    "book_thyristor_reduction": lambda: book() | REDUCED,
}
HELD = {"damping", "governor", "stabiliser_governor"}  # where something holds the speed


def values(**fields: Any) -> NDArray[np.complex128]:
    """Eigenvalues of kundur_12_6 with other fields."""
    return np.asarray(np.linalg.eigvals(linearise(plant(changed(system(), **fields)))[0]))


def andes(case: str) -> NDArray[np.complex128]:
    """Eigenvalues of ANDES."""
    with (REFERENCES / "kundur_12_6_options_eigenvalues_andes.csv").open() as file:
        return np.array([complex(float(r["re"]), float(r["im"])) for r in csv.DictReader(file) if r["case"] == case])


def far(eigenvalues_found: NDArray[np.complex128], *, leave: int) -> NDArray[np.complex128]:
    """Without those that lie close to zero, which are two or three."""
    away = eigenvalues_found[np.abs(eigenvalues_found) > CLOSE]
    assert len(eigenvalues_found) - len(away) == leave
    return away


def test_reference_eigenvalues_cover_all_cases_of_options() -> None:
    with (REFERENCES / "kundur_12_6_options_eigenvalues_andes.csv").open() as file:
        assert {row["case"] for row in csv.DictReader(file)} == set(CASES)


@pytest.mark.parametrize("case", CASES)
def test_eigenvalues_are_those_of_andes(case: str) -> None:
    """Measured 4e-6 at most, from the finite differences of our linearisation."""
    ours, theirs = values(**CASES[case]()), andes(case)
    assert len(ours) == len(theirs)
    if case not in HELD:
        leave = 3 if case == "current" else 2
        ours, theirs = far(ours, leave=leave), far(theirs, leave=leave)
    assert furthest(theirs, ours) < 1e-5


def test_options_tell_apart() -> None:
    """Without its option, the plant is far from each case's figures."""
    plain = values()
    for case in ("saturation", "current", "power", "mixture", "taps", "damping"):
        assert furthest(andes(case), plain) > 0.05, case


def test_start_with_saturation_is_that_of_andes() -> None:
    built = plant(changed(system(), **machines(**SATURATION)))
    trace = follow(built, [0.0])
    with (REFERENCES / "kundur_12_6_saturation_start_andes.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [row["machine"] for row in rows] == list(MACHINES)
    field, angle = (np.array([float(row[key]) for row in rows]) for key in ("Efd", "delta"))
    np.testing.assert_allclose(trace.machines["field_voltage"][0], field, rtol=0, atol=1e-9)
    np.testing.assert_allclose(trace.machines["rotor_angle"][0], angle, rtol=0, atol=1e-9)


def test_voltages_with_taps_are_those_of_andes() -> None:
    flow = solve(changed(system(), **tapped()))
    with (REFERENCES / "kundur_12_6_taps_voltages_andes.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [row["bus"] for row in rows] == flow.names
    theirs = [float(row["V"]) * np.exp(1j * float(row["angle"])) for row in rows]
    np.testing.assert_allclose(flow.voltage, theirs, rtol=0, atol=1e-9)


def test_load_step_with_all_controls_is_that_of_andes() -> None:
    """30 s with static exciters, stabilisers and governors; ANDES's trapezoidal rule has a step of 1 ms.

    Measured: speeds 1.6e-8 of 7e-4 p.u., powers 3.1e-8 of 0.012 p.u.
    """
    rows = figures("kundur_12_6_governor_load_step_andes.csv")
    step = {"time": 1.0, "kind": "load_step", "load": "load_1", "change": 0.05}
    trace = follow(plant(changed(system(), **STATIC, **STABILISERS, **GOVERNORS), step), rows[:, 0])
    speeds, powers = rows[:, 1:5] - 1, rows[:, 5:]
    assert np.ptp(powers) > 0.01
    np.testing.assert_allclose(trace.speeds, speeds, rtol=0, atol=1e-7)
    np.testing.assert_allclose(trace.machines["mechanical_power"] / 9, powers, rtol=0, atol=2e-7)


def test_fault_with_loads_of_constant_current_is_that_of_andes() -> None:
    """A fault at bus 8 of 1e-3 p.u.; ANDES's loads stay what they are however low the voltage, so V_min is put low.

    Measured: speeds 2.1e-7 of 7.7e-3 p.u., angles 3e-4 degrees, whatever our step: ANDES's step is 1 ms. Angles are
    against G3, as an error of the common speed, which nothing holds, grows in all angles alike.
    """
    rows = figures("kundur_12_6_current_fault_andes.csv")
    fault = {"time": 1.0, "kind": "fault", "bus": "B8", "duration": 0.1, "x": 1e-3}
    trace = follow(plant(changed(system(), **loads(CURRENT, IMPEDANCE, V_min=0.05)), fault), rows[:, 0])
    speeds, angles = rows[:, 1:5] - 1, rows[:, 5:]
    np.testing.assert_allclose(trace.speeds, speeds, rtol=0, atol=5e-7)
    ours, theirs = (np.rad2deg(a - a[:, 2:3]) for a in (trace.machines["rotor_angle"], angles))
    np.testing.assert_allclose(ours, theirs, rtol=0, atol=1e-3)
    assert np.ptp(theirs[:, 0]) > 10


def test_eigenvalues_with_loads_of_constant_current_are_those_of_a_third_program() -> None:
    """WOLF-I prints two decimals; its operating point has those of the book's voltages and powers."""
    re, im = figures("kundur_12_6_current_eigenvalues_wolf.csv").T
    eigenvalues_found = values(**loads(CURRENT, IMPEDANCE))
    assert furthest(far(re + 1j * im, leave=3), far(eigenvalues_found, leave=3)) < 0.02


def test_classical_machines_swing_as_in_a_third_program() -> None:
    """WOLF-I, constant active current: 3.41, 7.21 and 7.40 rad/s, undamped."""
    classical = machines(model="classical")
    swings = [v for v in values(**classical, **loads(CURRENT, IMPEDANCE)) if v.imag > 1]
    assert sorted(v.imag for v in swings) == pytest.approx([3.41, 7.21, 7.40], abs=0.01)
    assert [v.real for v in swings] == pytest.approx([0, 0, 0], abs=0.005)


# Kundur's table E12.3, and why GENROU with saturation is not it


def test_books_equations_give_the_books_eigenvalues() -> None:
    """All but the pair at zero: the table has two or three decimals, its operating point four digits.

    The largest difference, 0.012, is that of a swing printed as j6.82 whose printed frequency is 1.087 Hz, j6.83.
    """
    re, im = figures("kundur_12_6_eigenvalues_book.csv").T
    eigenvalues_found = kundur_circuits.eigenvalues(system(), kundur_circuits.BOOK)
    assert furthest(far(re + 1j * im, leave=2), far(eigenvalues_found, leave=2)) < 0.0125


def test_without_saturation_the_plant_has_the_books_equations() -> None:
    eigenvalues_found = kundur_circuits.eigenvalues(system(), None)
    ours = values(**loads(CURRENT, IMPEDANCE))
    assert furthest(far(eigenvalues_found, leave=3), far(ours, leave=3)) < 1e-5


def test_saturation_as_in_genrou_damps_local_modes_more_than_in_the_book() -> None:
    """S10 and S12 give the book's curve at 1.0 and 1.2, but GENROU saturates the transient circuits alone.

    The book lowers both mutual inductances to their incremental values, by 0.55 to 0.58. The interarea mode is
    as in the book; local modes are damped by 0.085 instead of 0.072.
    """
    A, B, threshold = 0.015, 9.6, 0.9
    at = np.array([1.0, 1.2])
    np.testing.assert_allclose(A * np.exp(B * (at - threshold)) / at, [0.0392, 0.2227], rtol=0, atol=5e-5)
    swings = sorted((v for v in values(**book()) if v.imag > 1), key=lambda v: v.imag)
    assert [v.imag / 2 / np.pi for v in swings] == pytest.approx([0.545, 1.087, 1.117], rel=0.015)
    assert [-v.real / abs(v) for v in swings] == pytest.approx([0.0347, 0.0861, 0.0850], abs=5e-4)


# Long lines


def chain(section: NDArray[np.complex128]) -> NDArray[np.complex128]:
    """[[A, B], [C, D]] of a two-port from its admittances: V1 = A V2 + B I2, I1 = C V2 + D I2, I2 out of it."""
    (y11, y12), (y21, y22) = section
    return np.asarray(np.array([[-y22, -1], [y12 * y21 - y11 * y22, -y11]]) / y21)


def exact(z: complex, y: complex, length: float) -> NDArray[np.complex128]:
    """The telegraph equations dV/dx = z I, dI/dx = y V from the receiving end, integrated over a length."""
    return np.asarray(expm(np.array([[0, z], [y, 0]]) * length))


@pytest.mark.parametrize("length", [1.0, 110.0, 1000.0, 5000.0])
def test_distributed_line_solves_the_telegraph_equations(length: float) -> None:
    """The tie of Kundur's system, from 1 km to almost a wavelength (2 pi / 0.00132 km)."""
    r, x, b = 0.0001, 0.001, 0.00175
    line = Line.model_validate({"name": "line", "from": "A", "to": "B", "length": length, "r": r, "x": x, "b": b})
    two_port = chain(line_section(line, "distributed"))
    expected = exact(complex(r, x), 1j * b, length)
    np.testing.assert_allclose(two_port, expected, rtol=0, atol=1e-11 * np.abs(expected).max())
    parts = [chain(line_section(line, "distributed", part)) for part in (0.3, 0.7)]
    np.testing.assert_allclose(parts[0] @ parts[1], expected, rtol=0, atol=1e-11 * np.abs(expected).max())


def test_distributed_line_is_that_of_a_textbook() -> None:
    """Glover, Sarma and Overbye, Power System Analysis and Design, example 5.2: 765 kV, 300 km; ohm and siemens.

    A = 0.9313 at 0.209 degrees, B = 97.0 at 87.2, C = 1.37e-3 at 90.06; the nominal pi circuit has B = 99.3 at 87.14.
    """
    data = {"length": 300, "r": 0.0165, "x": 0.3306, "b": 4.674e-6}
    line = Line.model_validate({"name": "line", "from": "A", "to": "B", **data})
    (A, B), (C, D) = chain(line_section(line, "distributed"))
    assert abs(A - D) < 1e-12
    assert [abs(A), abs(B), abs(C)] == pytest.approx([0.9313, 97.0, 1.37e-3], rel=5e-4, abs=5e-6)
    assert np.rad2deg(np.angle([A, B, C])) == pytest.approx([0.209, 87.2, 90.06], abs=0.05)
    assert np.rad2deg(np.angle(A)) == pytest.approx(0.209, abs=5e-4)
    nominal = chain(line_section(line, "pi"))[0, 1]
    assert (abs(nominal), np.rad2deg(np.angle(nominal))) == pytest.approx((99.3, 87.14), abs=0.05)


def in_pieces(pieces: int) -> NDArray[np.complex128]:
    """Voltages of kundur_12_6 with each line as so many pi sections in series."""
    fields = system().model_dump(by_alias=True)
    lines: list[dict[str, Any]] = []
    for line in fields["lines"]:
        between = [f"{line['name']}_{k}" for k in range(1, pieces)]
        fields["buses"] += [{"name": name, "nominal_voltage": 230} for name in between]
        nodes: Sequence[str] = [line["from"], *between, line["to"]]
        for k in range(pieces):
            part = {"name": f"{line['name']}_part_{k}", "from": nodes[k], "to": nodes[k + 1]}
            lines.append({**line, **part, "length": line["length"] / pieces})
    pmus = fields["pmus"][:4]
    cut = changed(system(), buses=fields["buses"], lines=lines, pmus=pmus, signals={}, measures={})
    return np.asarray(solve(cut).voltage[:11])


def test_lines_in_ever_more_sections_become_distributed_lines() -> None:
    """The error of n sections goes with 1 / n^2."""
    limit = solve(changed(system(), line_model="distributed")).voltage
    errors = [np.abs(in_pieces(n) - limit).max() for n in (1, 4, 8)]
    assert errors[0] > 1e-4
    assert errors[0] / errors[1] == pytest.approx(16, rel=0.02)
    assert errors[1] / errors[2] == pytest.approx(4, rel=0.02)


def test_speed_multiplies_the_emf_of_a_machine_that_asks_for_it() -> None:
    """Torques at a speed above nominal are those at nominal speed with a larger EMF, over the speed."""
    system, speed = shipped("kundur_12_6"), 0.01
    rows = [m.model_dump() for m in system.machines]
    built = plant(changed(system, machines=[{**row, "speed_voltage": row["name"] == "G1"} for row in rows]))
    larger = built.plant.machines.copy()
    larger["speed"] = 0.0
    larger[0]["C"] *= 1.0 + speed
    fast = slopes(built, moved(built, {"G1.omega": speed}))
    other = slopes(built._replace(plant=built.plant._replace(machines=larger)), moved(built, {"G1.omega": speed}))
    speed_state = built.state_names.index("G1.omega")
    damping = system.machines[0].D * speed / (2.0 * system.machines[0].H)
    assert fast[speed_state] + damping == pytest.approx((other[speed_state] + damping) / (1.0 + speed), rel=1e-9)
    apart = np.delete(fast - other, speed_state)
    assert np.abs(apart).max() < 1e-9
    assert np.abs(slopes(built)).max() < 1e-9


def test_speed_and_saturation_exclude_each_other() -> None:
    row = shipped("kundur_12_6").machines[0].model_dump()
    with pytest.raises(ValueError, match="speed_voltage: true given; allowed: false with saturation"):
        Machine.model_validate({**row, "speed_voltage": True, "S10": 0.04, "S12": 0.2})


def test_speed_divides_power_and_damping_of_a_machine_that_asks_for_it() -> None:
    """2 H dw/dt = (Pm - D w) / (1 + w) - Te, all else the same."""
    system, speed = shipped("kundur_12_6"), 0.01
    rows = [m.model_dump() | {"D": 2.0} for m in system.machines]
    plain, divided = (
        plant(changed(system, machines=[{**row, "speed_torque": divides} for row in rows])) for divides in (False, True)
    )
    slower = slopes(plain, moved(plain, {"G1.omega": speed})) - slopes(divided, moved(divided, {"G1.omega": speed}))
    state = plain.state_names.index("G1.omega")
    power = float(plain.plant.mechanical_power[0, 0])
    lost = (power - 2.0 * speed) * (1.0 - 1.0 / (1.0 + speed)) / (2.0 * system.machines[0].H)
    assert slower[state] == pytest.approx(lost, rel=1e-9)
    assert np.abs(np.delete(slower, state)).max() < 1e-9
