"""Data frames (clause 6.3, tables 5 to 7): simultaneous measurements of all PMUs of a configuration.

All numbers of a frame form one row of items. An item is 16 bits or a 32-bit float; its value is count times scale plus
offset. For a float the scale is 1 and the offset 0, so its bits are those of the value.
"""

from __future__ import annotations

from itertools import accumulate
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from facts_damping_streams.c37118.frame import MAXIMUM, MINIMUM, FrameError

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from facts_damping.compiling.structs import Bool1, Float1, Int1
    from facts_damping_streams.c37118.configuration import Configuration, PmuConfiguration

MISSING = -32768  # 0x8000: no value; for a float NaN
RADIAN, MILLIHERTZ, CENTIHERTZ = 1e-4, 1e-3, 1e-2  # per count of angle, frequency, rate of change of frequency


class Data(NamedTuple):
    """Measured values, in the order of the configuration's PMUs; NaN: no value."""

    status: NDArray[np.int64]  # STAT, (PMUs,)
    phasors: NDArray[np.float64]  # magnitude, V or A, and angle, rad, (all phasors, 2)
    frequency: NDArray[np.float64]  # Hz, (PMUs,)
    rocof: NDArray[np.float64]  # Hz/s, (PMUs,)
    analogs: Float1  # (all analogs,)
    digitals: Int1  # (all digital words,)


class Layout(NamedTuple):
    """Positions and scales of the items in a configuration's data frames; arrays over items."""

    size: int  # bytes of the body
    at: NDArray[np.int64]  # first byte
    wide: NDArray[np.bool_]  # a 32-bit float
    signed: NDArray[np.bool_]  # of 16 bits
    scale: NDArray[np.float64]
    offset: NDArray[np.float64]
    field: NDArray[np.int64]  # index in FIELDS
    polar: Bool1  # (phasors,)
    turn: NDArray[np.float64]  # rad, subtracted from a phasor's angle, (phasors,)


FIELDS = ("status", "first", "second", "frequency", "rocof", "analogs", "digitals")
STATUS, FIRST, SECOND, FREQUENCY, ROCOF, ANALOG, DIGITAL = range(len(FIELDS))


def _items(pmu: PmuConfiguration) -> Iterator[tuple[int, bool, bool, float, float]]:
    """Field, 32-bit float, signed, scale and offset of each item of a PMU, in their order (table 5)."""
    yield STATUS, False, False, 1.0, 0.0
    for p in pmu.phasors:
        if pmu.float_phasors:
            yield from ((FIRST, True, True, 1.0, 0.0), (SECOND, True, True, 1.0, 0.0))
        else:
            yield FIRST, False, not pmu.polar, p.scale, 0.0
            yield SECOND, False, True, RADIAN if pmu.polar else p.scale, 0.0
    wide = pmu.float_frequency
    yield FREQUENCY, wide, True, 1.0 if wide else MILLIHERTZ, 0.0 if wide else float(pmu.nominal_hz)
    yield ROCOF, wide, True, 1.0 if wide else CENTIHERTZ, 0.0
    for a in pmu.analogs:
        yield ANALOG, pmu.float_analogs, True, *((1.0, 0.0) if pmu.float_analogs else (a.scale, a.offset))
    for _ in pmu.digitals:
        yield DIGITAL, False, False, 1.0, 0.0


def layout(c: Configuration) -> Layout:
    """The layout of a configuration's data frames. Raises `FrameError` if they are too long, or if a scale is zero."""
    if not c.pmus:
        raise FrameError("NUM_PMU: 0 given; allowed: 1 and more (6.4)")
    items = [item for pmu in c.pmus for item in _items(pmu)]
    field, wide, signed, scale, offset = (np.array(column) for column in zip(*items, strict=True))
    ends = list(accumulate(np.where(wide, 4, 2).tolist()))
    size = ends[-1] if ends else 0
    if size + MINIMUM > MAXIMUM:
        raise FrameError(f"FRAMESIZE: {size + MINIMUM} bytes of data; allowed: {MINIMUM} to {MAXIMUM} (6.3)")
    if not (scale.all() and np.isfinite([scale, offset]).all()):
        raise FrameError("PHUNIT, ANUNIT: 0 or no number given for values in integers; allowed: any other (6.4)")
    polar = np.array([pmu.polar for pmu in c.pmus for _ in pmu.phasors], bool)
    turn = np.array([0.0 if pmu.float_phasors else p.angle for pmu in c.pmus for p in pmu.phasors], float)
    if not np.isfinite(turn).all():
        raise FrameError("PHSCALE: an angle that is no number given; allowed: any number of radians (6.4)")
    return Layout(size, np.array([0, *ends[:-1]]), wide, signed, scale, offset, field, polar, turn)


def _turned(angle: Float1, turn: Float1) -> Float1:
    """Angles plus `turn`, within -pi to pi; unchanged if `turn` is zero."""
    return np.where(turn == 0.0, angle, np.remainder(angle + turn + np.pi, 2.0 * np.pi) - np.pi)


def encode(frame_layout: Layout, data: Data) -> bytes:
    """The body of a data frame."""
    magnitude, angle = data.phasors[:, 0], _turned(data.phasors[:, 1], frame_layout.turn)
    values = np.zeros(len(frame_layout.at))
    columns = {
        STATUS: data.status,
        FIRST: np.where(frame_layout.polar, magnitude, magnitude * np.cos(angle)),
        SECOND: np.where(frame_layout.polar, angle, magnitude * np.sin(angle)),
        FREQUENCY: data.frequency,
        ROCOF: data.rocof,
        ANALOG: data.analogs,
        DIGITAL: data.digitals,
    }
    for field, column in columns.items():
        values[frame_layout.field == field] = column
    body, narrow = np.zeros(frame_layout.size, np.uint8), ~frame_layout.wide
    with np.errstate(over="ignore"):  # values beyond 32-bit floats become infinite
        floats = values[frame_layout.wide].astype(">f4").view(np.uint8).reshape(-1, 4)
    body[frame_layout.at[frame_layout.wide, None] + np.arange(4)] = floats
    minimum, maximum = (
        np.where(frame_layout.signed[narrow], -32767, 0),
        np.where(frame_layout.signed[narrow], 32767, 65535),
    )
    counts = (values[narrow] - frame_layout.offset[narrow]) / frame_layout.scale[narrow]
    whole = np.where(np.isnan(counts), MISSING, np.clip(np.rint(np.nan_to_num(counts)), minimum, maximum)).astype(
        np.int64
    )
    body[frame_layout.at[narrow, None] + np.arange(2)] = (whole & 0xFFFF).astype(">u2").view(np.uint8).reshape(-1, 2)
    return body.tobytes()


def decode(frame_layout: Layout, body: bytes) -> Data:
    """The values of a data frame; an infinite one is no value. Raises `FrameError` for a wrong length."""
    if len(body) != frame_layout.size:
        raise FrameError(
            f"FRAMESIZE: {len(body) + MINIMUM} bytes; allowed by the configuration: {frame_layout.size + MINIMUM}"
        )
    raw, narrow = np.frombuffer(body, np.uint8), ~frame_layout.wide
    values = np.zeros(len(frame_layout.at))
    with np.errstate(invalid="ignore"):  # signalling NaN
        values[frame_layout.wide] = raw[frame_layout.at[frame_layout.wide, None] + np.arange(4)].view(">f4").ravel()
    values[np.isinf(values)] = np.nan
    counts = raw[frame_layout.at[narrow, None] + np.arange(2)].view(">u2").ravel().astype(np.int64)
    signed = frame_layout.signed[narrow]
    counts = np.where(signed & (counts > 32767), counts - 65536, counts)
    missing = signed & (counts == MISSING)
    values[narrow] = np.where(missing, np.nan, counts * frame_layout.scale[narrow] + frame_layout.offset[narrow])
    first, second = values[frame_layout.field == FIRST], values[frame_layout.field == SECOND]
    first = np.where(np.isnan(second), np.nan, first)  # the magnitude of polar integers has no code for a missing value
    magnitude = np.where(frame_layout.polar, first, np.hypot(first, second))
    angle = _turned(np.where(frame_layout.polar, second, np.arctan2(second, first)), -frame_layout.turn)
    return Data(
        values[frame_layout.field == STATUS].astype(np.int64),
        np.column_stack([magnitude, angle]),
        values[frame_layout.field == FREQUENCY],
        values[frame_layout.field == ROCOF],
        values[frame_layout.field == ANALOG],
        values[frame_layout.field == DIGITAL].astype(np.int64),
    )
