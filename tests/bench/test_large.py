"""The large case of the comparison: the files inside ANDES's wheel, our runs of them."""

from __future__ import annotations

import pytest

from facts_damping.bench import large, large_ours
from facts_damping.bench.figures import difference
from facts_damping.bench.grid import FAULT_END, RATE, grid, swings
from facts_damping.bench.programs import LARGE
from tests.andes_cases import CASES


@pytest.fixture(autouse=True)
def _files(monkeypatch: pytest.MonkeyPatch) -> None:
    folder = CASES / "npcc"
    monkeypatch.setattr(large_ours, "files", lambda: (folder / "npcc.raw", folder / "npcc_full.dyr"))


def test_steps_meet_instants() -> None:
    for row in LARGE.values():
        assert all(1.0 / RATE / step == pytest.approx(round(1.0 / RATE / step)) for step in row.steps)
    assert "48 machines" in large.CASE


def test_our_errors_are_small_though_limits_act() -> None:
    """Regulators meet their limits after the fault: errors do not fall with the fourth power there."""
    made, case = large_ours.prepare(grid(), None), grid()  # type: ignore[arg-type]
    found = {step: swings(large_ours.run(made, case, step)) for step in (0.01, 0.005, 0.000625)}
    assert found[0.01].shape == (48, round((20.0 - FAULT_END) * RATE))
    errors = [difference(found[step], found[0.000625]) for step in (0.01, 0.005)]
    assert errors[0] < 4e-3
    assert errors[1] < 2e-3
