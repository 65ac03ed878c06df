"""Relative gains of two devices: Bristol's formula, sums, and what docs/controllers.md says of them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from facts_damping.case.loading import load_system
from facts_damping.plant.build import build
from facts_damping.small_signal.residues import FREQUENCIES_HZ, Interaction, interactions

BOTH = ["sssc", "statcom"]
PAGE = Path(__file__).parents[2] / "docs" / "controllers.md"


@pytest.fixture(scope="module")
def gains() -> list[Interaction]:
    system = load_system("two_area")
    return interactions(build(system, BOTH, []), system, BOTH)


def test_relative_gains_do_not_depend_on_units_and_add_up_to_one(gains: list[Interaction]) -> None:
    assert {interaction.frequency_hz for interaction in gains} > set(FREQUENCIES_HZ)
    for interaction in gains:
        np.testing.assert_allclose(interaction.relative.sum(axis=0), 1, rtol=1e-6)
        np.testing.assert_allclose(interaction.relative.sum(axis=1), 1, rtol=1e-6)
        g = interaction.gain
        expected = 1 / (1 - g[0, 1] * g[1, 0] / (g[0, 0] * g[1, 1]))  # Bristol's, of two by two
        assert interaction.relative[0, 0] == pytest.approx(expected, rel=1e-6)


def test_page_quotes_them(gains: list[Interaction]) -> None:
    rows = [line.split("|")[1:-1] for line in PAGE.read_text(encoding="utf-8").splitlines() if line.startswith("| `")]
    for a, b in (("speed", "power"), ("power_rate", "voltage")):
        (row,) = [cells[1:] for cells in rows if cells[0].strip() == f"`{a}`, `{b}`"]
        at_the_mode, *others = [interaction for interaction in gains if interaction.signals == (a, b)]
        assert at_the_mode.condition == pytest.approx(float(row[-1]), rel=0.03)
        for cell, interaction in zip(row[:-1], others, strict=True):
            written = complex(cell.strip())
            assert interaction.relative[0, 0].real == pytest.approx(written.real, abs=0.0051)
            assert written.imag == 0 or interaction.relative[0, 0].imag == pytest.approx(written.imag, abs=0.0051)


@pytest.mark.parametrize("devices", [[], ["sssc"]])
def test_single_device_has_no_interactions(devices: list[str]) -> None:
    system = load_system("two_area")
    assert interactions(build(system, devices, []), system, devices) == []
