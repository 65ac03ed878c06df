"""PMUs of a system as those of a stream: per unit to volts, amperes and kilowatts (back: mapping.py).

A PMU sends the positive sequence of voltage (phase to ground) and current, and as analogs its active and reactive
power and the rotor's speed deviation, which only an ideal PMU has. Quantities not measured by a PMU are missing.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from facts_damping.signals import CHANNELS
from facts_damping_streams.c37118.configuration import UNIT, Analog, Configuration, Phasor, PmuConfiguration, Site
from facts_damping_streams.c37118.data import Data

if TYPE_CHECKING:
    from collections.abc import Sequence

    from facts_damping.compiling.structs import Float2, Int1

PHASORS = ("V1", "I1")
ANALOGS = ("P kW", "Q kvar", "SPEED ppm")
PPM = 1e-6  # p.u. of speed
COUNTS = 32767
MAGNITUDE, ANGLE, SPEED, ACTIVE, REACTIVE, FREQUENCY, ROCOF, CURRENT, CURRENT_ANGLE = range(len(CHANNELS))


class Pmu(NamedTuple):
    """A PMU and the bases of its measurements."""

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
        """1 p.u. of a quantity (parameters.UNITS): V, A, W or var; of speed 1."""
        bases = {"voltage": self.volts, "current": self.amperes, "speed": 1.0}
        return bases.get(quantity, self.base_mva * 1e6)


def configuration(
    pmus: Sequence[Pmu],
    rate: int,
    nominal_hz: int,
    formats: dict[str, bool],
    site: Site | None = None,
    ranges: tuple[float, float] = (2.0, 100.0),
    first_idcode: int = 1,
) -> Configuration:
    """The stream of PMUs; formats as in `PmuConfiguration`; ranges: largest voltage and current in integers, p.u."""
    configured = []
    for i, pmu in enumerate(pmus):
        voltage, current = _scale(ranges[0] * pmu.volts), _scale(ranges[1] * pmu.amperes)
        phasors = Phasor(PHASORS[0], scale=voltage), Phasor(PHASORS[1], current=True, scale=current)
        power = float(math.ceil(ranges[1] * pmu.base_mva * 1e3 / COUNTS))
        analogs = tuple(Analog(name, 1, scale) for name, scale in zip(ANALOGS, (power, power, 1.0), strict=True))
        parts = pmu.name, first_idcode + i, phasors, analogs
        configured.append(PmuConfiguration(*parts, nominal_hz=nominal_hz, site=site or Site(), **formats))  # type: ignore[arg-type]
    return Configuration(tuple(configured), rate)


def _scale(largest: float) -> float:
    """V or A per count, in whole steps of PHUNIT, exact in 32 bits as in configuration 3."""
    return float(np.float32(math.ceil(largest / COUNTS / UNIT) * UNIT))


def to_data(pmus: Sequence[Pmu], values: Float2, status: Int1) -> Data:
    """Simultaneous measurements of PMUs, (PMUs, CHANNELS), in the units of a stream."""
    volts, amperes, power = np.array([(pmu.volts, pmu.amperes, pmu.base_mva * 1e3) for pmu in pmus]).reshape(-1, 3).T
    first = np.column_stack([values[:, MAGNITUDE] * volts, values[:, ANGLE]])
    second = np.column_stack([values[:, CURRENT] * amperes, values[:, CURRENT_ANGLE]])
    analogs = np.column_stack([values[:, ACTIVE] * power, values[:, REACTIVE] * power, values[:, SPEED] / PPM])
    phasors = np.stack([first, second], axis=1).reshape(-1, 2)
    none = np.zeros(0, np.int64)
    return Data(status, phasors, values[:, FREQUENCY], values[:, ROCOF], analogs.ravel(), none)
