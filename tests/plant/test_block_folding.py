"""A control with fewer rows gives what the whole one gives: outputs and derivatives, whatever it sees."""

from __future__ import annotations

import numpy as np
import pytest

from facts_damping.plant.inverters.inverter import KNOWN, SETPOINTS
from facts_damping.plant.machines import blocks
from facts_damping.plant.machines.block_folding import folded
from tests.plant.inverter_rows import NAMES, Rows, control, converter

PLANTS = {
    "solar": (("REGCA1", {"Lvplsw": 1}), ("REECB1", {"QFLAG": 1, "VFLAG": 1}), ("REPCA1", {"Fflag": 1})),
    "wind": (
        ("REGCA1", {}),
        ("REECA1", {"PFLAG": 1, "PFFLAG": 1}),
        ("WTDTA1", {}),
        ("WTARA1", {}),
        ("WTPTA1", {}),
        ("WTTQA1", {}),
    ),
    "battery": (("REGCA1", {}), ("REECD1", {"QFLAG": 1}), ("REPCA1", {"RefFlag": 1})),
    "distributed": (("DERA1", {}),),
}


@pytest.mark.parametrize("plant", PLANTS)
def test_control_with_fewer_rows_gives_the_same(plant: str) -> None:
    """At 200 random states and inputs of each plant, up to limits and beyond them, to rounding."""
    (first, changes), *others = PLANTS[plant]
    whole = Rows(converter(first, **changes), *(control(model, **fields) for model, fields in others))
    constant = [n for n, name in enumerate(KNOWN) if name not in SETPOINTS]
    asked = [len(NAMES) + whole.control.gives.index(name) for name in ("Ip", "Iq_ahead")]
    fewer, numbers = folded(whole.control, whole.rest.signals, constant, asked)
    assert len(fewer.rows) <= 0.85 * len(whole.control.rows)
    assert fewer.states == whole.control.states
    at, random = len(NAMES), np.random.default_rng(74)
    signals = np.zeros(at + len(fewer.rows))
    slopes = np.zeros_like(whole.dx)
    for _ in range(200):
        whole.values[len(constant) : at] = whole.rest.signals[len(constant) : at] + random.normal(
            0.0, 0.3, at - len(constant)
        )
        whole.x[:] = whole.rest.states + random.normal(0.0, 0.3, len(whole.x))
        whole.move()
        signals[:at] = whole.values[:at]
        blocks.outputs(fewer.rows, 0, len(fewer.rows), at, whole.x, signals)
        blocks.derivatives(fewer.rows, 0, len(fewer.rows), whole.x, signals, slopes)
        np.testing.assert_allclose(signals[numbers], whole.values[asked], rtol=1e-12, atol=1e-12)
        np.testing.assert_allclose(slopes, whole.dx, rtol=1e-10, atol=1e-9)
