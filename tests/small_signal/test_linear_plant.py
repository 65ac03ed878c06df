"""The linearised plant for other tools: its modes and responses, files, and what python-control makes of it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import control
import numpy as np
import pytest

from facts_damping.case.loading import load_system
from facts_damping.cli.main import main
from facts_damping.small_signal import linear_plant
from facts_damping.small_signal.modal_tables import Modal, analyse
from tests.commands import assert_one_line

if TYPE_CHECKING:
    from pathlib import Path


@pytest.fixture(scope="module", params=[("two_area", ["sssc", "statcom"]), ("smib", ["sssc"])])
def modal(request: pytest.FixtureRequest) -> Modal:
    name, devices = request.param
    return analyse(load_system(name), devices)


def test_linear_plant_has_the_response_of_the_model_behind_washouts(modal: Modal) -> None:
    plant = linear_plant.state_space(linear_plant.of(modal))
    assert (plant.input_labels, plant.output_labels) == (modal.devices, list(modal.system.signals))
    for w in (0.5, 3.9, 20.0):
        wanted = modal.model.response(1j * w)
        assert plant(1j * w) == pytest.approx(wanted.reshape(np.shape(plant(1j * w))), rel=1e-6, abs=1e-9)


def test_its_poles_are_the_modes_and_the_washouts(modal: Modal) -> None:
    plant = linear_plant.of(modal)
    poles = np.linalg.eigvals(plant.A)
    for mode in modal.modes:
        assert np.abs(poles - mode.eigenvalue).min() < 1e-6 * max(1.0, abs(mode.eigenvalue))
    assert len(poles) == len(modal.model.A) + np.count_nonzero(modal.model.washout)
    assert plant.A.shape == (len(plant.states),) * 2
    assert len(plant.x_0) == len(plant.states)


def test_file_has_all_of_it(tmp_path: Path) -> None:
    path = tmp_path / "plant.npz"
    assert main(["modes", "two_area", "--linear", str(path)]) == 0
    wanted = linear_plant.of(analyse(load_system("two_area"), ["sssc"]))
    with np.load(path, allow_pickle=False) as file:
        assert set(file.files) == set(wanted._fields)
        for name, value in wanted._asdict().items():
            assert np.array_equal(file[name], np.array(value)), name
        again = control.StateSpace(file["A"], file["B"], file["C"], file["D"])
    assert again.nstates == len(wanted.states)


def test_file_that_cannot_be_written_is_refused_before_any_work(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert_one_line(2, ["modes", "two_area", "--linear", str(tmp_path / "no" / "plant.npz")], "--linear", capsys)
