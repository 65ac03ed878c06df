"""Large networks are solved by sparse elimination: beside dense elimination, and a country's grid by itself."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from scipy.sparse import csc_array

from facts_damping.case.loading import load_case, load_system
from facts_damping.errors import InputError
from facts_damping.parameters.field_errors import check
from facts_damping.parameters.plant.system import System
from facts_damping.plant import build as plant_build
from facts_damping.plant.build import build
from facts_damping.plant.grid import power_flow, sparse
from facts_damping.simulation import loop
from facts_damping.small_signal import descriptor, eigenmodes, linearisation, residues
from facts_damping_grids.matpower_reading import import_case
from tests.andes_cases import CASES

if TYPE_CHECKING:
    from numpy.typing import NDArray


@pytest.mark.parametrize(("name", "devices"), [("new_england_39", []), ("two_area", ["sssc", "statcom"]), ("smib", [])])
def test_sparse_and_dense_elimination_give_the_same_network(
    name: str, devices: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    system = load_system(name)
    dense = build(system, devices, [])
    monkeypatch.setattr(sparse, "DENSE", 0)
    monkeypatch.setattr(power_flow, "DENSE", 0)
    sparse_plant = build(system, devices, [])
    assert np.abs(sparse_plant.flow.voltage - dense.flow.voltage).max() < 1e-9
    ours, theirs = sparse_plant.plant.network, dense.plant.network
    assert np.abs(ours - theirs).max() < 1e-9 * np.abs(theirs).max()
    assert sparse_plant.state.x == pytest.approx(dense.state.x, abs=1e-7)


def test_singular_equations_are_said() -> None:
    with pytest.raises(np.linalg.LinAlgError):
        sparse.solve_network(csc_array((3, 3)), np.ones(3))


@pytest.mark.parametrize("kind", [float, complex])
@pytest.mark.parametrize("columns", [None, 3])
def test_equations_are_solved(kind: type, columns: int | None) -> None:
    """Whatever the pattern, also where the diagonal is zero: rows are exchanged."""
    chance = np.random.default_rng(2)
    for n in (1, 2, 30, 200):
        a: Any = np.where(chance.random((n, n)) < 4.0 / n, chance.standard_normal((n, n)), 0.0).astype(kind)
        a[np.arange(n), chance.permutation(n)] += 3.0 if kind is float else 3.0 + 1.0j
        b = chance.standard_normal(n if columns is None else (n, columns))
        solution = sparse.solve_network(csc_array(a), b)
        np.testing.assert_allclose(solution, np.linalg.solve(a, b), rtol=1e-8, atol=1e-10)


def test_grid_of_2224_buses_is_at_rest() -> None:
    """Great Britain's, from ANDES's wheel: the power flow of the case is balanced, its machines stand still."""
    path = CASES / "GBnetwork" / "GBnetwork.m"
    system = check(System, import_case(path).content, str(path))
    built = build(system, [], [])
    assert (len(system.buses), len(system.machines)) == (2224, 378)
    assert built.flow.residual < power_flow.TOLERANCE
    balance = balances(system, built.flow.voltage) - built.flow.injection
    assert np.abs(balance).max() < 1e-8
    matrix = linearisation.state_matrix(built)[0]
    assert isinstance(matrix, descriptor.Descriptor)
    assert matrix.matrix.nnz < 10 * matrix.matrix.shape[0]  # machines are coupled by lines alone
    with pytest.raises(InputError, match="states given; allowed: at most"):
        descriptor.dense(descriptor.Descriptor(matrix.matrix, descriptor.DENSE_STATES + 1))


def balances(system: System, voltage: NDArray[np.complex128]) -> NDArray[np.complex128]:
    """What goes from each bus into its branches and shunts, p.u., branch by branch."""
    at = {bus.name: i for i, bus in enumerate(system.buses)}
    powers = np.zeros(len(voltage), complex)
    for line in system.lines:
        i, j, y, half = at[line.from_bus], at[line.to_bus], 1.0 / complex(line.r, line.x), 0.5j * line.b
        for a, b in ((i, j), (j, i)):
            powers[a] += voltage[a] * np.conj(y * (voltage[a] - voltage[b]) + half * voltage[a])
    for t in system.transformers:
        i, j, y = at[t.from_bus], at[t.to_bus], t.rating / system.base_power / complex(t.r, t.x)
        ratio = t.tap * np.exp(1j * np.deg2rad(t.phase_shift))
        current = y * (voltage[i] / ratio - voltage[j])  # behind the ideal transformer
        powers[i] += voltage[i] * np.conj(current / np.conj(ratio))
        powers[j] -= voltage[j] * np.conj(current)
    for shunt in system.shunts:
        i = at[shunt.bus]
        powers[i] += abs(voltage[i]) ** 2 * np.conj(complex(shunt.P, shunt.Q)) / system.base_power
    return powers


@pytest.mark.parametrize(
    ("run", "sets"),
    [
        ("two_area_large", ["devices=[sssc,statcom]", "controllers=[]", "duration=2.5"]),
        ("lead_lag_smib", ["duration=2.5"]),
        ("new_england_39_fault", ["duration=1.5", "system.loads.*.P_fractions={power: 1.0}"]),
    ],
)
def test_runs_are_the_same_with_factors_instead_of_a_dense_network(
    run: str, sets: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Devices in series and parallel, infinite buses, faults; loads whose voltage collapses in a fault."""
    case = load_case(run, sets)
    dense = loop.run(case)
    monkeypatch.setattr(plant_build, "LARGE", 0)
    sparse_run = loop.run(case)
    assert dense.in_synchronism.all()
    for name in ("rotor_angle", "speed_deviation", "electrical_power", "terminal_voltage"):
        np.testing.assert_allclose(sparse_run.machines[name], dense.machines[name], rtol=1e-7, atol=1e-8)
    np.testing.assert_allclose(sparse_run.frames, dense.frames, rtol=1e-6, atol=1e-7)


def test_sparse_linear_plant_has_the_same_modes_and_residues(monkeypatch: pytest.MonkeyPatch) -> None:
    """Series and parallel devices, machines with X''q != X''d; the modes nearest the shifts, not all."""
    system, devices = load_system("nets_nyps"), ["sssc", "statcom"]
    pmus = [pmu.name for pmu in system.pmus]
    built = build(system, devices, [])
    dense = linearisation.linear_model(built, system.signals, pmus)
    known = {mode.eigenvalue: mode for mode in eigenmodes.modes(dense.A, built.state_names, system, dense, devices)}
    at_mode = residues.residues(built, system, devices, 60)
    monkeypatch.setattr(plant_build, "LARGE", 0)
    monkeypatch.setattr(descriptor, "ALL_MODES", 0)
    monkeypatch.setattr(descriptor, "SHIFTS_HZ", np.array([0.4, 1.2]))
    built = build(system, devices, [])
    model = linearisation.linear_model(built, system.signals, pmus)
    assert np.abs(model.response(3j) - dense.response(3j)).max() < 1e-6 * np.abs(dense.response(3j)).max()
    sparse_modes = eigenmodes.modes(model.matrix, built.state_names, system, model, devices)
    swings = [mode for mode in sparse_modes if mode.swings]
    assert len(swings) == 8  # of 15
    for mode in swings:
        like = known[min(known, key=lambda value: abs(value - mode.eigenvalue))]
        assert mode.eigenvalue == pytest.approx(like.eigenvalue, abs=1e-5)
        for ours, theirs in zip(mode.residues, like.residues, strict=True):
            assert ours.magnitude == pytest.approx(theirs.magnitude, rel=1e-3, abs=1e-6)
    near = residues.residues(built, system, devices, 60)
    assert at_mode is not None
    assert near is not None
    assert near.eigenvalue == pytest.approx(at_mode.eigenvalue, abs=1e-6)
    np.testing.assert_allclose(near.residue, at_mode.residue, rtol=1e-4, atol=1e-7)
