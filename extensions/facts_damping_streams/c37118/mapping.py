"""Mapping of a stream's channels to PMUs; values in per unit, and the status of each PMU."""

from __future__ import annotations

from itertools import accumulate
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from facts_damping.errors import InputError
from facts_damping.signals import CHANNELS
from facts_damping_streams.c37118 import stat, system_pmus
from facts_damping_streams.parameters import UNITS, Channel, Channels

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray

    from facts_damping.compiling.structs import Bool1, Float2, Int1, Int2
    from facts_damping_streams.c37118.configuration import Configuration, PmuConfiguration
    from facts_damping_streams.c37118.data import Data
    from facts_damping_streams.c37118.system_pmus import Pmu

NAMES = dict(zip(UNITS, (*system_pmus.PHASORS, *system_pmus.ANALOGS), strict=True))  # channel names of our servers
VOLTAGE, CURRENT, ACTIVE, REACTIVE, SPEED = range(len(UNITS))


class Places(NamedTuple):
    """The PMUs of a grid in a stream, and their channels; arrays over these."""

    pmus: NDArray[np.int64]  # indices in the grid
    blocks: NDArray[np.int64]  # indices of their PMUs in the stream
    channels: Int2  # (PMUs, UNITS): indices of the stream's phasors or analogs; -1: not sent
    scale: Float2  # (PMUs, UNITS): p.u. per unit of the stream; negative: opposite sign


def places(c: Configuration, grid: Sequence[Pmu], wanted: Mapping[str, Channels]) -> Places:
    """The places of a grid's PMUs in a stream; `wanted` has the names of some of them there.

    Raises `InputError` if a PMU has no channel of a requested name.
    """
    phasors = [0, *accumulate(len(p.phasors) for p in c.pmus)]
    analogs = [0, *accumulate(len(p.analogs) for p in c.pmus)]
    rows = []
    for s, pmu in enumerate(grid):
        asked = wanted.get(pmu.name, Channels())
        named = pmu.name if asked.pmu is None else asked.pmu
        p = next((i for i, sent in enumerate(c.pmus) if named in (sent.name, sent.idcode)), None)
        if p is None:
            continue
        where, scale = zip(*(_channel(pmu, quantity, asked, c.pmus[p]) for quantity in UNITS), strict=True)
        first = [phasors[p] if i in (VOLTAGE, CURRENT) else analogs[p] for i in range(len(UNITS))]
        rows.append((s, p, [-1 if at < 0 else at + begin for at, begin in zip(where, first, strict=True)], scale))
    columns = list(zip(*rows, strict=True)) or [[], [], [], []]
    shape = (len(rows), len(UNITS))
    return Places(
        np.array(columns[0], np.int64),
        np.array(columns[1], np.int64),
        np.array(columns[2], np.int64).reshape(shape),
        np.array(columns[3], float).reshape(shape),
    )


def _channel(pmu: Pmu, quantity: str, asked: Channels, configured: PmuConfiguration) -> tuple[int, float]:
    """Index of a quantity's channel in a PMU, -1: not sent; and p.u. per unit of the channel."""
    asked_channel: Channel | None = getattr(asked, quantity)
    channel = asked_channel or Channel(channel=NAMES[quantity])
    phasor = quantity in ("voltage", "current")
    there = (
        [p.name for p in configured.phasors if p.current == (quantity == "current")]
        if phasor
        else [a.name for a in configured.analogs]
    )
    if channel.channel not in there:
        if asked_channel is None:
            return -1, 1.0
        known = f"PMU {pmu.name}: {quantity}: '{channel.channel}' given"
        raise InputError(f"{known}; allowed: what PMU {configured.name} sends: {', '.join(there) or 'none'}")
    names = [p.name if p.current == (quantity == "current") else "" for p in configured.phasors] if phasor else there
    unit = UNITS[quantity][channel.unit or next(iter(UNITS[quantity]))]
    return names.index(channel.channel), (-unit if channel.reverse else unit) / pmu.one(quantity)


def values_of(pmu_places: Places, data: Data) -> tuple[Float2, Int1, Bool1]:
    """Values of the PMUs in a frame (PMUs, CHANNELS), status bits, and whether a PMU is absent.

    Powers that are not sent are computed from the phasors: P + jQ = V I*.
    """
    phasors, analogs = np.vstack([data.phasors, [np.nan, np.nan]]), np.append(data.analogs, np.nan)
    volts, amperes = phasors[pmu_places.channels[:, VOLTAGE]], phasors[pmu_places.channels[:, CURRENT]]
    values = np.full((len(pmu_places.pmus), len(CHANNELS)), np.nan)
    for magnitude, angle, sent, of in (
        (system_pmus.MAGNITUDE, system_pmus.ANGLE, volts, VOLTAGE),
        (system_pmus.CURRENT, system_pmus.CURRENT_ANGLE, amperes, CURRENT),
    ):
        values[:, magnitude] = sent[:, 0] * np.abs(pmu_places.scale[:, of])
        opposite = np.where(sent[:, 1] > 0.0, sent[:, 1] - np.pi, sent[:, 1] + np.pi)
        values[:, angle] = np.where(pmu_places.scale[:, of] < 0.0, opposite, sent[:, 1])
    power = values[:, system_pmus.MAGNITUDE] * values[:, system_pmus.CURRENT]
    between = values[:, system_pmus.ANGLE] - values[:, system_pmus.CURRENT_ANGLE]
    for column, of, unsent in (
        (system_pmus.ACTIVE, ACTIVE, power * np.cos(between)),
        (system_pmus.REACTIVE, REACTIVE, power * np.sin(between)),
        (system_pmus.SPEED, SPEED, np.nan),
    ):
        there = pmu_places.channels[:, of]
        values[:, column] = np.where(there < 0, unsent, analogs[there] * pmu_places.scale[:, of])
    values[:, system_pmus.FREQUENCY] = data.frequency[pmu_places.blocks]
    values[:, system_pmus.ROCOF] = data.rocof[pmu_places.blocks]
    words = data.status[pmu_places.blocks]
    return values, stat.status(words), stat.absent(words, values)
