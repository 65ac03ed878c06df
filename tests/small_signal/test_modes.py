from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from facts_damping.case.loading import read_system
from facts_damping.parameters.files import shipped as names
from facts_damping.parameters.plant.placement import place
from facts_damping.small_signal import eigenmodes
from facts_damping.small_signal.eigenmodes import Eigenmode, modes
from facts_damping.small_signal.linearisation import linearise
from facts_damping.small_signal.modal_tables import Modal, analyse, modes_text, together
from tests.independent.reference import Model
from tests.plant.running import changed, figures, plant, shipped

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from facts_damping.parameters.plant.system import System
    from facts_damping.plant.build import Built

# Files of ANDES: how many eigenvalues, bound of their distances, 1/s.
ANDES = {
    "kundur_12_6": (24, 1e-5),
    "wscc_9": (21, 1e-5),
    "new_england_39": (75, 1e-4),
    "nets_nyps": (210, 1e-4),  # without its devices
}


def swings(built: Built) -> list[Eigenmode]:
    """The three electromechanical modes by frequency: interarea, then the local ones."""
    all_modes = modes(linearise(built)[0], built.state_names)
    return sorted(
        (m for m in all_modes if 0.3 < m.frequency_hz < 2 and m.damping_ratio < 0.3), key=lambda m: m.frequency_hz
    )


def furthest(values: NDArray[np.complex128], among: NDArray[np.complex128]) -> float:
    """Largest distance from a value to the nearest of the others, each of those taken once."""
    rest, largest = list(among), 0.0
    for value in values:
        i = int(np.argmin(np.abs(np.array(rest) - value)))
        largest = max(largest, abs(rest.pop(i) - value))
    return largest


def moving(matrix: NDArray[np.float64]) -> NDArray[np.complex128]:
    """Eigenvalues but for the pair at zero.

    Angles have no reference and speed no governor, so zero is a double eigenvalue of one eigenvector: round-off
    of size e in the matrix moves it by sqrt(e), up to 3e-3 here, which says nothing about the model.
    """
    values = np.linalg.eigvals(matrix)
    order = np.argsort(np.abs(values))
    assert abs(values[order[1]]) < 5e-3 < 2 * abs(values[order[2]])
    return np.asarray(values[order[2:]])


def with_machines(system: System, model: str) -> System:
    return changed(system, machines=[{**m.model_dump(), "model": model} for m in system.machines])


@pytest.mark.parametrize("name", ANDES)
def test_eigenvalues_are_those_of_andes(name: str) -> None:
    """Of the plant, and of the independent model where it is small."""
    andes = figures(f"{name}_eigenvalues_andes.csv") @ [1, 1j]
    count, bound = ANDES[name]
    assert len(andes) == count
    system = place(read_system(name).model_copy(update={"devices": []}))
    matrices = [linearise(plant(system))[0]]
    if count < 50:
        matrices.append(Model(system).state_matrix()[0])
    for matrix in matrices:
        assert furthest(moving(np.diag(andes)), moving(matrix)) < bound


def test_swings_of_kundur_12_6_are_those_of_other_programs() -> None:
    """Four programs: interarea 0.5426 to 0.5445 Hz at 0.027 to 0.038; local 1.05 to 1.12 Hz at 0.082 to 0.094."""
    interarea, *local = swings(plant("kundur_12_6"))
    assert 0.5426 <= interarea.frequency_hz <= 0.5445
    assert 0.0270 <= interarea.damping_ratio <= 0.038
    assert len(local) == 2
    assert all(1.05 <= m.frequency_hz <= 1.12 and 0.08 <= m.damping_ratio <= 0.094 for m in local)


@pytest.mark.parametrize(
    ("model", "figures", "bounds"),
    [
        ("cascade", [(0.630, -0.0139), (1.121, 0.10), (1.157, 0.10)], [(5e-4, 1.5e-4), (1e-3, 5e-3), (1e-3, 5e-3)]),
        ("genrou", [(0.6320, -0.0158), (1.1435, 0.0743), (1.1779, 0.0704)], [(1e-4, 1e-4)] * 3),
    ],
)
def test_swings_of_two_area(model: str, figures: list[tuple[float, float]], bounds: list[tuple[float, float]]) -> None:
    """As the design has them; with standard machines as a separate program found them."""
    found_swings = swings(plant(with_machines(shipped("two_area"), model)))
    for swing, (hertz, ratio), (near, close) in zip(found_swings, figures, bounds, strict=True):
        assert swing.frequency_hz == pytest.approx(hertz, abs=near)
        assert swing.damping_ratio == pytest.approx(ratio, abs=close)


def test_two_area_has_the_machines_and_branches_of_kundur_12_6() -> None:
    """Whose eigenvalues and courses are those of ANDES."""
    ours, book = shipped("two_area"), shipped("kundur_12_6")
    leave = {"model", "P", "V", "slack", "angle", "from_bus", "to_bus", "magnetising_r", "magnetising_x"}
    for rows, others in (
        (ours.machines, book.machines),
        (ours.lines, book.lines),
        (ours.transformers, book.transformers),
    ):
        for row, other in zip(rows, others, strict=True):
            assert row.model_dump(exclude=leave) == other.model_dump(exclude=leave)


def residue(names: Sequence[str], A: NDArray[np.float64], B: NDArray[np.float64]) -> complex:
    """Of the interarea mode, from the setpoint to the difference of speeds of G1 and G3."""
    values, right = np.linalg.eig(A)
    mode = int(np.argmin(np.abs(values - (0.055 + 3.957j))))
    speeds = right[names.index("G1.omega"), mode] - right[names.index("G3.omega"), mode]
    return complex(speeds * (np.linalg.inv(right)[mode] @ B[:, 0]))


def test_residue_from_the_setpoint_to_the_speed_difference() -> None:
    """177 degrees: so LLC is u = +K(s) y; the sign says that a capacitive setpoint raises the transfer."""
    built, other = plant("two_area"), Model(shipped("two_area"), ["sssc"])
    A, B = linearise(built)
    assert B.shape == (len(built.state.x), 1)
    residue_found = residue(built.state_names, A, B)
    assert np.rad2deg(np.angle(residue_found)) == pytest.approx(177, abs=1)
    assert residue_found == pytest.approx(residue(other.names, *other.state_matrix()), rel=1e-5)


MODELS = [("cascade", "static"), ("genrou", "static"), ("cascade", "constant"), ("genrou", "constant")]


@pytest.mark.parametrize("device", [True, False])
@pytest.mark.parametrize(("machine", "exciter"), MODELS)
def test_two_area_has_the_eigenvalues_of_the_independent_model(machine: str, exciter: str, *, device: bool) -> None:
    system = with_machines(shipped("two_area"), machine)
    system = system if exciter == "static" else changed(system, exciters=[])
    installed = ["sssc"] if device else []
    ours = moving(linearise(plant(system, installed=installed))[0])
    theirs = moving(Model(system, installed).state_matrix()[0])
    assert len(ours) == len(theirs)
    assert furthest(theirs, ours) < 5e-6


def test_rate_feedback_as_printed_makes_the_open_loop_less_damped() -> None:
    """Thesis, table A.2: KF 0.001, TF 0.1 give a damping of -0.035; with TF on, xf takes part in the modes."""
    system = shipped("two_area")
    exciters = [{**e.model_dump(), "KF": 0.001, "TF": 0.1} for e in system.exciters]
    printed = swings(plant(changed(system, exciters=exciters)))[0]
    assert printed.damping_ratio == pytest.approx(-0.035, abs=1.5e-3)
    assert printed.frequency_hz == pytest.approx(0.63, abs=0.03)


@pytest.mark.parametrize("name", names("systems"))
def test_participation_factors_sum_to_one(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Over all states; those listed are the large ones, in falling order."""
    built = plant(name)
    A = linearise(built)[0]
    listed = modes(A, built.state_names)
    monkeypatch.setattr(eigenmodes, "NEGLIGIBLE", 0.0)
    for short, full in zip(listed, modes(A, built.state_names), strict=True):
        assert sum(full.participation.values()) == pytest.approx(1, abs=1e-12)
        assert len(full.participation) == len(built.state_names)
        assert list(short.participation.values()) == sorted(short.participation.values(), reverse=True)
        assert min(short.participation.values()) >= min(0.02, max(short.participation.values()) / 4.0)
        assert short.participation.items() <= full.participation.items()


def test_participation_factors_of_a_known_matrix() -> None:
    """A = [[0, 1], [-2, -3]]: roots -1 and -2; left times right entries of each are 2, -1 and -1, 2."""
    slow, fast = modes(np.array([[0.0, 1.0], [-2.0, -3.0]]), ["a", "b"])
    assert (slow.eigenvalue, fast.eigenvalue) == pytest.approx((-1, -2))
    assert (slow.damping_ratio, slow.frequency_hz) == (1, 0)
    assert slow.participation == pytest.approx({"a": 2 / 3, "b": 1 / 3})
    assert fast.participation == pytest.approx({"a": 1 / 3, "b": 2 / 3})


def test_modes_of_a_known_oscillator() -> None:
    """-0.3 +- 4j: one mode of the pair, 4 / (2 pi) Hz, damping ratio 0.3 / |lambda|."""
    (mode,) = modes(np.array([[-0.3, 4.0], [-4.0, -0.3]]), ["a", "b"])
    assert mode.eigenvalue == pytest.approx(-0.3 + 4j)
    assert mode.frequency_hz == pytest.approx(4 / (2 * np.pi))
    assert mode.damping_ratio == pytest.approx(0.3 / abs(-0.3 + 4j))


def test_swings_take_place_in_rotors_of_their_own_area() -> None:
    for mode, area in zip(swings(plant("two_area"))[1:], (("G1", "G2"), ("G3", "G4")), strict=True):
        fraction = {g: mode.participation.get(f"{g}.omega", 0.0) for g in ("G1", "G2", "G3", "G4")}
        assert sum(fraction[g] for g in area) > 0.3 > 5 * sum(fraction[g] for g in fraction if g not in area)


@pytest.fixture(scope="module")
def parallel() -> Modal:
    """two_area with twelve equal machines in the place of each."""
    return analyse(place(in_parallel(read_system("two_area"), 12)), [])


def in_parallel(system: System, count: int) -> System:
    """A system in which some equal machines, with their controls, stand in the place of each machine."""
    parts: dict[str, list[Any]] = {"machines": [], "exciters": [], "stabilisers": [], "governors": []}
    for machine in system.machines:
        shares = {"rating": machine.rating / count, "P": None if machine.P is None else machine.P / count}
        for i in range(count):
            name = machine.name if i == 0 else f"{machine.name}_{i}"
            first = {} if i == 0 or not machine.slack else {"slack": False, "P": 700.0 / count}
            parts["machines"].append(machine.model_copy(update={"name": name, **shares, **first}))
            for field in ("exciters", "stabilisers", "governors"):
                rows = [row for row in getattr(system, field) if row.machine == machine.name]
                parts[field] += [row.model_copy(update={"machine": name}) for row in rows]
    return system.model_copy(update=parts)


def test_many_machines_at_a_bus_are_named_together(parallel: Modal) -> None:
    lines = list(modes_text(parallel))
    (interarea,) = [line for line in lines if " interarea " in line]
    assert interarea.split("interarea")[1].strip().startswith("G")
    assert " x12" in interarea
    at = next(i for i, line in enumerate(lines) if "interarea: machines" in line)
    assert sum(line.count(" x12 ") for line in lines[at + 1 : at + 3]) >= 3  # the slack machine has its own load
    assert together(["G6100_1", "G6100_2", "G6100_3"]) == "G6100 x3"
    assert together(["north", "south"]) == "north x2"
    assert together(["G1_1"]) == "G1_1"


def test_common_mode_at_rest_has_no_damping_ratio() -> None:
    lines = list(modes_text(analyse(place(read_system("two_area")), [])))
    common = [line.split() for line in lines if " common " in line and line.split()[2] == "0.0000"]
    assert common
    assert all(row[3] == "-" for row in common if abs(float(row[0])) < 1e-4)
