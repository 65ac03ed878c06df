"""The system's PMUs as those of a stream: there and back, floats to the bits of 32, integers within a count."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from facts_damping.signals import CHANNELS
from facts_damping_streams.c37118 import configuration as frames
from facts_damping_streams.c37118 import data, mapping, system_pmus
from facts_damping_streams.c37118.system_pmus import Pmu

GRID = [Pmu("G1", 20.0, 100.0), Pmu("TIE", 230.0, 100.0), Pmu("G13", 22.0, 100.0)]


def measured() -> np.ndarray[tuple[int, int], np.dtype[np.float64]]:
    rng = np.random.default_rng(1)
    rows = [0.98, 0.4, 1e-3, 7.0, -2.0, 60.05, 0.3, 7.4, -0.5]
    values = np.array(rows) * rng.uniform(0.5, 1.0, (len(GRID), len(CHANNELS)))
    values[:, system_pmus.FREQUENCY] = 60.0 + rng.uniform(-0.2, 0.2, len(GRID))
    values[1, system_pmus.SPEED] = np.nan  # no machine
    return values


def test_bases_are_those_of_the_phase() -> None:
    assert GRID[1].volts == pytest.approx(132790.56)
    assert 3.0 * GRID[1].volts * GRID[1].amperes == pytest.approx(100e6)


@pytest.mark.parametrize("kind", ["configuration_2", "configuration_3"])
@pytest.mark.parametrize("flags", list(itertools.product((False, True), repeat=4)))
def test_there_and_back(flags: tuple[bool, ...], kind: str) -> None:
    formats = dict(zip(frames.FORMATS, flags, strict=True))
    c = system_pmus.configuration(GRID, 60, 60, formats)
    decoded = frames.decode(frames.encode(c, kind), kind)
    words, values = np.array([0, 0x2000, 0xC000]), measured()
    sent = data.encode(data.layout(c), system_pmus.to_data(GRID, values, words))
    where = mapping.places(decoded, GRID, {})
    values_back, states, absent = mapping.values_of(where, data.decode(data.layout(decoded), sent))
    np.testing.assert_array_equal(where.pmus, [0, 1, 2])
    np.testing.assert_array_equal(states, [0, 0x2000, 0x8000])
    assert not absent.any()
    assert np.isnan(values_back[1, system_pmus.SPEED])
    step = np.zeros(len(CHANNELS))
    phasor = 1e-6 if formats["float_phasors"] else 1.0 / 30000
    step[[system_pmus.MAGNITUDE, system_pmus.CURRENT]] = 2.0 * phasor, 100.0 * phasor
    step[[system_pmus.ANGLE, system_pmus.CURRENT_ANGLE]] = 1e-6 if formats["float_phasors"] else 2e-2
    power = 1e-6 if formats["float_analogs"] else 100.0 / 30000
    step[[system_pmus.ACTIVE, system_pmus.REACTIVE]] = 10 * power
    step[system_pmus.SPEED] = 1e-6
    step[[system_pmus.FREQUENCY, system_pmus.ROCOF]] = (1e-5, 1e-6) if formats["float_frequency"] else (1e-3, 1e-2)
    assert (np.abs(np.nan_to_num(values_back - values)) <= step).all()


def test_floats_are_those_of_32_bits() -> None:
    """Polar: what is received is the nearest float of what was sent, in volts, amperes, Hz and kilowatts."""
    c = system_pmus.configuration(GRID, 60, 60, dict.fromkeys(frames.FORMATS, True))
    sent = system_pmus.to_data(GRID, measured(), np.zeros(3, np.int64))
    decoded = data.decode(data.layout(c), data.encode(data.layout(c), sent))
    for name in ("phasors", "frequency", "rocof", "analogs"):
        ours, theirs = getattr(sent, name).astype(np.float32), getattr(decoded, name)
        np.testing.assert_array_equal(theirs, ours.astype(float))
