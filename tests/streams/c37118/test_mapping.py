"""Channels of a stream as a PMU's signals: names, units, directions, powers that are not sent, what is wrong."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from facts_damping.errors import InputError
from facts_damping_streams.c37118 import data, mapping, system_pmus
from facts_damping_streams.c37118.configuration import FORMATS, Analog, Configuration, Phasor, PmuConfiguration
from facts_damping_streams.c37118.system_pmus import Pmu
from facts_damping_streams.parameters import Channels

GRID = [Pmu("A", 230.0, 100.0), Pmu("B", 20.0, 100.0), Pmu("C", 20.0, 100.0)]


def floats(name: str, idcode: int, phasors: tuple[Phasor, ...], analogs: tuple[Analog, ...] = ()) -> PmuConfiguration:
    formats: dict[str, Any] = dict.fromkeys(FORMATS, True)
    return PmuConfiguration(name, idcode, phasors, analogs, **formats)


THEIRS = Configuration(
    (
        floats("SOUTH 1", 7, (Phasor("VA"), Phasor("V+"))),
        floats("NORTH 2", 9, (Phasor("V+"), Phasor("I+", current=True)), (Analog("MW"), Analog("dw"))),
        floats("B", 11, (Phasor("V1"), Phasor("I1", current=True))),
    ),
    60,
)
WANTED = {
    "A": Channels.model_validate(
        {
            "pmu": 9,
            "voltage": "V+",
            "current": {"channel": "I+", "reverse": True},
            "active_power": {"channel": "MW", "unit": "MW"},
            "speed": {"channel": "dw", "unit": "p.u."},
        }
    )
}
SAID = data.Data(
    np.array([0, 0x2000, 0xC000]),
    np.array([[1.0, 0.0], [2.0, 0.0], [132790.56, 0.5], [200.0, 0.1], [11547.0, 0.2], [1000.0, -0.3]]),
    np.array([60.0, 60.1, 59.9]),
    np.array([0.0, 0.2, np.nan]),
    np.array([75.0, 1e-3]),
    np.zeros(0, np.int64),
)


def test_stations_are_where_the_file_or_their_name_says() -> None:
    places = mapping.places(THEIRS, GRID, WANTED)
    assert places.pmus.tolist() == [0, 1]  # C is in no PMU
    values, status, absent = mapping.values_of(places, SAID)
    assert status.tolist() == [0x2000, 0x8000]
    assert not absent.any()
    a, b = values
    assert a[system_pmus.MAGNITUDE] == pytest.approx(1.0, abs=1e-6)
    assert a[system_pmus.CURRENT_ANGLE] == pytest.approx(0.1 - np.pi)
    assert a[system_pmus.CURRENT] == pytest.approx(200.0 / GRID[0].amperes)
    assert a[system_pmus.ACTIVE] == pytest.approx(0.75)
    assert a[system_pmus.SPEED] == 1e-3
    assert (a[system_pmus.FREQUENCY], a[system_pmus.ROCOF]) == (60.1, 0.2)
    assert b[system_pmus.ANGLE] == 0.2
    assert np.isnan(b[[system_pmus.SPEED, system_pmus.ROCOF]]).all()


def test_powers_that_are_not_sent_are_those_of_the_phasors() -> None:
    """P + jQ = 3 V I*, phase to ground."""
    values, _, _ = mapping.values_of(mapping.places(THEIRS, GRID, WANTED), SAID)
    apart = 3.0 * 11547.0 * 1000.0 * np.exp(0.5j) / 100e6
    assert values[1, system_pmus.ACTIVE] == pytest.approx(apart.real)
    assert values[1, system_pmus.REACTIVE] == pytest.approx(apart.imag)
    turned = 3.0 * 132790.56 * 200.0 * np.exp(1j * (0.5 - 0.1 + np.pi)) / 100e6
    assert values[0, system_pmus.REACTIVE] == pytest.approx(turned.imag)


def test_voltage_and_a_current_of_the_same_name_are_two() -> None:
    c = Configuration((floats("A", 7, (Phasor("P1"), Phasor("P1", current=True))),), 60)
    asked = Channels.model_validate({"voltage": "P1", "current": "P1"})
    assert mapping.places(c, GRID[:1], {"A": asked}).channels[0, :2].tolist() == [0, 1]


@pytest.mark.parametrize(
    ("asked", "message"),
    [
        (
            {"pmu": "SOUTH 1", "current": "I1"},
            "PMU A: current: 'I1' given; allowed: what PMU SOUTH 1 sends: none",
        ),
        (
            {"pmu": "NORTH 2", "voltage": "I+"},
            "PMU A: voltage: 'I\\+' given; allowed: what PMU NORTH 2 sends: V\\+",
        ),
        ({"pmu": 9, "speed": "RPM"}, "PMU A: speed: 'RPM' given; allowed: what PMU NORTH 2 sends: MW, dw"),
    ],
)
def test_channel_that_is_not_sent_is_named(asked: dict[str, object], message: str) -> None:
    with pytest.raises(InputError, match=message):
        mapping.places(THEIRS, GRID, {"A": Channels.model_validate(asked)})
