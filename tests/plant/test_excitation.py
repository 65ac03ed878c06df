"""Exciters: what is read back, transient gain reduction, example 12.6 with the equations of Kundur's book."""

from __future__ import annotations

import csv
from typing import TYPE_CHECKING

import numpy as np
import pytest

from facts_damping.parameters.files import shipped as names
from facts_damping.parameters.plant.machines import StaticExciter
from facts_damping.parameters.plant.system import System
from facts_damping.plant.machines.excitation import derivatives, field_voltage, steady_state
from facts_damping.small_signal.linearisation import linearise
from facts_damping_validation.small_signal import PRINTED
from tests.independent import kundur_circuits
from tests.independent.reference_cases import CURRENT, IMPEDANCE
from tests.plant.running import REFERENCES, changed, plant, shipped
from tests.plant.test_options import far
from tests.small_signal.test_modes import furthest

if TYPE_CHECKING:
    from numpy.typing import NDArray


@pytest.mark.parametrize("name", names("systems"))
def test_system_as_recordings_have_it_is_read_back(name: str) -> None:
    """They have every field of it, of each exciter those of its model."""
    assert System.model_validate(shipped(name).model_dump(by_alias=True)) == shipped(name)


@pytest.mark.parametrize("name", kundur_circuits.SYSTEMS)
def test_books_equations_with_exciters_are_those_of_the_file(name: str) -> None:
    with (REFERENCES / "kundur_12_6_excitation_book.csv").open() as file:
        written = [complex(float(r["re"]), float(r["im"])) for r in csv.DictReader(file) if r["system"] == name]
    assert kundur_circuits.swings(shipped(name)) == pytest.approx(written, rel=0, abs=1e-5)


def test_books_equations_with_thyristor_exciters_give_the_books_eigenvalues() -> None:
    """As far as these can be read off the plot that quotes them: to 0.002 and 0.02 1/s."""
    values_found = kundur_circuits.swings(shipped("kundur_12_6_thyristor"))
    assert [v.real for v in values_found] == pytest.approx([v.real for v in PRINTED], rel=0, abs=0.002)
    assert [v.imag for v in values_found] == pytest.approx([v.imag for v in PRINTED], rel=0, abs=0.02)


@pytest.mark.parametrize("name", kundur_circuits.SYSTEMS)
def test_without_saturation_the_plant_with_exciters_has_the_books_equations(name: str) -> None:
    values_found = kundur_circuits.eigenvalues(shipped(name), None)
    fields = [{**load.model_dump(), "P_fractions": CURRENT, "Q_fractions": IMPEDANCE} for load in shipped(name).loads]
    ours = np.asarray(np.linalg.eigvals(linearise(plant(changed(shipped(name), loads=fields)))[0]))
    assert furthest(far(values_found, leave=2), far(ours, leave=2)) < 1e-4


def test_transient_gain_reduction_as_a_transfer_function() -> None:
    """From a stabiliser's output to the field voltage: KA (1 + s TC) / (1 + s TB), closed over KF s / (1 + s TF)."""
    e = StaticExciter(machine="G1", model="static", KA=50.0, TR=0.0, KF=0.02, TF=0.5, TB=2.0, TC=0.3)
    exciter, names, start = steady_state(e, 0, 1.02, 1.8)
    assert names == ["xf", "xb"]
    row = np.array([exciter])[0]
    x, dx, h = np.array(start), np.zeros(2), 1e-6

    def response(x: NDArray[np.float64], u: float) -> NDArray[np.float64]:
        efd = field_voltage(row, x, 1.02, u)
        derivatives(row, x, 1.02, u, efd, dx)
        return np.array([*dx, efd])

    assert response(x, 0.0) == pytest.approx([0.0, 0.0, 1.8], abs=1e-12)
    moves = [*h * np.eye(2)]
    A, C = np.split(np.transpose([(response(x + m, 0.0) - response(x - m, 0.0)) / (2 * h) for m in moves]), [2])
    B, D = np.split((response(x, h) - response(x, -h)) / (2 * h), [2])
    for s in (0.05j, 1j, 7j, 200j):
        forward, back = e.KA * (1 + s * e.TC) / (1 + s * e.TB), e.KF * s / (1 + s * e.TF)
        transfer = C[0] @ np.linalg.solve(s * np.eye(2) - A, B) + D[0]
        assert transfer == pytest.approx(forward / (1 + forward * back), rel=1e-6)
