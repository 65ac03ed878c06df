"""Stations of a grid as PMUs of a stream: per unit to volts, amperes and kilowatts (back: mapping.py).

A station sends the positive sequence of voltage (phase to ground) and current, and as analogs its active and reactive
power and the rotor's speed deviation, which only an ideal PMU has. Quantities not measured by a station are missing.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from facts_damping.c37118.configuration import UNIT, Analog, Configuration, Phasor, Pmu, Site
from facts_damping.c37118.data import Data
from facts_damping.signals import CHANNELS

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

PHASORS = ("V1", "I1")
ANALOGS = ("P kW", "Q kvar", "SPEED ppm")
PPM = 1e-6  # p.u. of speed
COUNTS = 32767
MAGNITUDE, ANGLE, SPEED, ACTIVE, REACTIVE, FREQUENCY, ROCOF, CURRENT, CURRENT_ANGLE = range(len(CHANNELS))


class Station(NamedTuple):
    """A station and the bases of its measurements."""

    name: str
    kilovolts: float  # nominal voltage of its bus, phase to phase
    base_mva: float  # of the system

    @property
    def volts(self) -> float:
        """1 p.u. of voltage, phase to ground, V."""
        return self.kilovolts * 1e3 / math.sqrt(3.0)

    @property
    def amperes(self) -> float:
        """1 p.u. of current, A."""
        return self.base_mva * 1e6 / (math.sqrt(3.0) * self.kilovolts * 1e3)

    def one(self, quantity: str) -> float:
        """1 p.u. of a quantity (parameters.streams.UNITS): V, A, W or var; of speed 1."""
        bases = {"voltage": self.volts, "current": self.amperes, "speed": 1.0}
        return bases.get(quantity, self.base_mva * 1e6)


def configuration(
    stations: Sequence[Station],
    rate: int,
    nominal_hz: int,
    formats: dict[str, bool],
    site: Site | None = None,
    ranges: tuple[float, float] = (2.0, 100.0),
    first_idcode: int = 1,
) -> Configuration:
    """The stream of stations; formats as in `Pmu`; ranges: the largest voltage and current in integers, p.u."""
    return Configuration(
        tuple(
            Pmu(
                station.name,
                first_idcode + i,
                (
                    Phasor(PHASORS[0], current=False, scale=_scale(ranges[0] * station.volts)),
                    Phasor(PHASORS[1], current=True, scale=_scale(ranges[1] * station.amperes)),
                ),
                tuple(Analog(name, 1, _whole(name, ranges[1] * station.base_mva * 1e3)) for name in ANALOGS),
                nominal_hz=nominal_hz,
                site=site or Site(),
                **formats,  # type: ignore[arg-type]
            )
            for i, station in enumerate(stations)
        ),
        rate,
    )


def _scale(largest: float) -> float:
    """V or A per count, in whole steps of PHUNIT, exact in 32 bits as in configuration 3."""
    return float(np.float32(math.ceil(largest / COUNTS / UNIT) * UNIT))


def _whole(name: str, largest: float) -> float:
    return 1.0 if name == ANALOGS[2] else float(math.ceil(largest / COUNTS))


def to_data(stations: Sequence[Station], values: NDArray[np.float64], status: NDArray[np.int64]) -> Data:
    """Simultaneous measurements of stations, (stations, CHANNELS), in the units of a stream."""
    volts, amperes, power = _bases(stations)
    first = np.column_stack([values[:, MAGNITUDE] * volts, values[:, ANGLE]])
    second = np.column_stack([values[:, CURRENT] * amperes, values[:, CURRENT_ANGLE]])
    analogs = np.column_stack([values[:, ACTIVE] * power, values[:, REACTIVE] * power, values[:, SPEED] / PPM])
    phasors = np.stack([first, second], axis=1).reshape(-1, 2)
    none = np.zeros(0, np.int64)
    return Data(status, phasors, values[:, FREQUENCY], values[:, ROCOF], analogs.ravel(), none)


def _bases(stations: Sequence[Station]) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any]]:
    """V, A and kW of 1 p.u., each (stations,)."""
    return (
        np.array([s.volts for s in stations]),
        np.array([s.amperes for s in stations]),
        np.array([s.base_mva * 1e3 for s in stations]),
    )
