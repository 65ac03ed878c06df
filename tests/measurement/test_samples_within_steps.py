"""Samples of PMUs within steps of the integrator that are longer than from one sample to the next."""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING

import numpy as np
import pytest

from facts_damping.case.loading import load_case
from facts_damping.simulation.loop import run

if TYPE_CHECKING:
    from facts_damping.record import Record

FAULT = "scenario=[{time: 1.0, kind: fault, bus: B8, duration: 0.0625}, {time: 1.5018, kind: line_out, line: line_3}]"


@cache
def seen(rate: int) -> Record:
    """A run with steps of 1/rate s; P class takes 480 samples/s."""
    system = [
        "system=kundur_12_6_thyristor_pss",
        "devices=[]",
        "controllers=[]",
        "measurement={filter: p_class}",
        FAULT,
    ]
    return run(load_case(None, [*system, "duration=3", f"system.step={1 / rate}"]))


@pytest.mark.parametrize("column", ["voltage_magnitude_pu", "frequency_hz", "current_magnitude_pu"])
def test_samples_within_long_steps_are_those_of_short_ones(column: str) -> None:
    """A step of 8.3 ms has three samples within it; a third of it four times less error or better."""
    names = [name for name in seen(960).arrays if name.startswith("pmu.") and name.endswith(column)]
    errors = {
        rate: max(float(np.nanmax(np.abs(seen(rate).arrays[n] - seen(960).arrays[n]))) for n in names)
        for rate in (120, 240)
    }
    assert names
    assert errors[120] < 2e-3
    assert errors[240] < 0.25 * errors[120]
