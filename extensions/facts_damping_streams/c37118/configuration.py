"""Configuration frames 1, 2 and 3 (clause 6.4, tables 8 to 12): channels of PMUs, their names and units."""

from __future__ import annotations

import math
import struct
from typing import Any, NamedTuple

from facts_damping_streams.c37118.frame import MAXIMUM, MINIMUM, FrameError

NAME = 16  # bytes of a name in configuration 1 and 2
BITS = 16  # of a digital word
FORMATS = ("polar", "float_phasors", "float_analogs", "float_frequency")  # bits 0 to 3 of FORMAT
UNIT = 1e-5  # V or A per step of PHUNIT
TIME_BASE = 1_000_000  # resolution of time in our frames, parts of a second
ONLY, FIRST, LAST = 0, 1, 0xFFFF  # CONT_IDX of a single frame of configuration 3, of its first part, of its last part


class Phasor(NamedTuple):
    """A phasor: V, phase to ground, or A, with the scale of its integer format."""

    name: str
    current: bool = False
    scale: float = 1.0  # V or A per count, in steps of 1e-5 in configuration 1 and 2
    angle: float = 0.0  # rad, to be subtracted (configuration 3, table 9)
    flags: int = 0  # modifications of the phasor (configuration 3, bits 31 to 16 of PHSCALE)


class Analog(NamedTuple):
    """An analog value, with the scale of its integer format."""

    name: str
    kind: int = 0  # 0: single point on wave, 1: root mean square, 2: peak
    scale: float = 1.0  # value per count, an integer in configuration 1 and 2
    offset: float = 0.0  # (configuration 3)


class Digital(NamedTuple):
    """A digital word of sixteen bits: their names, normal states, and those in use."""

    names: tuple[str, ...]
    normal: int = 0
    used: int = 0


class Site(NamedTuple):
    """Location and measurement settings of a PMU (configuration 3)."""

    global_id: bytes = bytes(16)
    latitude: float = math.inf  # deg, WGS 84; infinite: unknown
    longitude: float = math.inf
    elevation: float = math.inf  # m
    service_class: str = "M"  # or P
    window_us: int = 0
    group_delay_us: int = 0


class PmuConfiguration(NamedTuple):
    """A PMU in a stream."""

    name: str
    idcode: int
    phasors: tuple[Phasor, ...]
    analogs: tuple[Analog, ...] = ()
    digitals: tuple[Digital, ...] = ()
    polar: bool = False
    float_phasors: bool = False
    float_analogs: bool = False
    float_frequency: bool = False
    nominal_hz: int = 60  # or 50
    changes: int = 0  # CFGCNT
    site: Site = Site()


class Configuration(NamedTuple):
    """A stream: its PMUs, the time base (parts of a second), and its rate."""

    pmus: tuple[PmuConfiguration, ...]
    rate: int  # frames per second; if negative: seconds per frame
    time_base: int = TIME_BASE


class _Reader:
    """Reads bytes field by field and checks the length."""

    def __init__(self, data: bytes) -> None:
        self.data, self.at = data, 0

    def take(self, form: str, field: str) -> tuple[Any, ...]:
        """The next values, in a `struct` format."""
        size = struct.calcsize(f">{form}")
        if size > len(self.data) - self.at:
            raise FrameError(f"{field}: {len(self.data) - self.at} bytes left; allowed: {size} and more (6.4)")
        self.at += size
        return struct.unpack_from(f">{form}", self.data, self.at - size)

    def name(self, field: str, *, long: bool) -> str:
        """STN, CHNAM: sixteen characters, or in configuration 3 one byte of length and UTF-8."""
        (raw,) = self.take(f"{self.take('B', field)[0] if long else NAME}s", field)
        return str(raw.decode(errors="replace") if long else raw.decode("latin-1").rstrip(" \0"))


def _name(text: str, field: str, *, long: bool) -> bytes:
    """Encode STN or CHNAM, the inverse of `_Reader.name`."""
    raw, maximum = text.encode() if long else text.encode("latin-1", errors="replace"), 255 if long else NAME
    if len(raw) > maximum:
        raise FrameError(f"{field}: '{text}' has {len(raw)} bytes; allowed: {maximum} (6.4)")
    return bytes([len(raw)]) + raw if long else raw.ljust(NAME)


def encode(c: Configuration, kind: str) -> list[bytes]:
    """Bodies of the frames of a configuration: one, or for `configuration_3` as many as needed."""
    long = kind == "configuration_3"
    parts = [struct.pack(">IH", c.time_base, len(c.pmus)), *(_pmu(pmu, long=long) for pmu in c.pmus)]
    whole = b"".join([*parts, struct.pack(">h", c.rate)])
    if not long:
        return [whole]
    room = MAXIMUM - MINIMUM - 2
    cut = [whole[i : i + room] for i in range(0, len(whole), room)]
    return [struct.pack(">H", index) + part for index, part in zip(_indices(len(cut)), cut, strict=True)]


def decode(bodies: list[bytes], kind: str) -> Configuration:
    """A configuration from its frames' bodies. Raises `FrameError`, naming the field, if they are invalid."""
    long = kind == "configuration_3"
    reader = _Reader(_joined(bodies) if long else b"".join(bodies))
    time_base, count = reader.take("IH", "TIME_BASE, NUM_PMU")
    if time_base & 0xFFFFFF == 0:
        raise FrameError("TIME_BASE: 0 given; allowed: 1 to 16777215 (6.4)")
    pmus = tuple(_read_pmu(reader, long=long) for _ in range(count))
    (rate,) = reader.take("h", "DATA_RATE")
    if reader.at != len(reader.data):
        raise FrameError(f"DATA_RATE: {len(reader.data) - reader.at} bytes after it; allowed: none (6.4)")
    return Configuration(pmus, rate, time_base & 0xFFFFFF)


def _indices(parts: int) -> list[int]:
    """CONT_IDX values for a number of parts."""
    return [ONLY] if parts == 1 else [*range(FIRST, parts), LAST]


def _joined(bodies: list[bytes]) -> bytes:
    indices = [_Reader(body).take("H", "CONT_IDX")[0] for body in bodies]
    wanted = _indices(len(bodies))
    if indices != wanted:
        raise FrameError(f"CONT_IDX: {indices} given; allowed: {wanted} (6.4)")
    return b"".join(body[2:] for body in bodies)


def whole(bodies: list[bytes]) -> bool:
    """Whether these parts of a configuration 3 are complete."""
    return bool(bodies) and len(bodies[-1]) >= 2 and int.from_bytes(bodies[-1][:2], "big") in (ONLY, LAST)


def _pmu(pmu: PmuConfiguration, *, long: bool) -> bytes:
    form = sum(1 << bit for bit, name in enumerate(FORMATS) if getattr(pmu, name))
    names = [
        *(p.name for p in pmu.phasors),
        *(a.name for a in pmu.analogs),
        *(bit for d in pmu.digitals for bit in d.names),
    ]
    parts = [_name(pmu.name, "STN", long=long), struct.pack(">H", pmu.idcode), pmu.site.global_id if long else b""]
    parts.append(struct.pack(">4H", form, len(pmu.phasors), len(pmu.analogs), len(pmu.digitals)))
    parts += [_name(name, "CHNAM", long=long) for name in names]
    if long:
        plain = 1.0, 0.0  # scale and angle or offset of floats, which are already scaled (table 9)
        for p in pmu.phasors:
            scaled = plain if pmu.float_phasors else (p.scale, p.angle)
            parts.append(struct.pack(">Iff", p.flags << 16 | p.current << 11 | 1 << 8, *scaled))
        parts += [struct.pack(">ff", *(plain if pmu.float_analogs else (a.scale, a.offset))) for a in pmu.analogs]
    else:
        units = [p.current << 24 | _count(p.scale / UNIT, 0, "PHUNIT") for p in pmu.phasors]
        units += [a.kind << 24 | _count(a.scale, -(1 << 23), "ANUNIT") for a in pmu.analogs]
        parts.append(struct.pack(f">{len(units)}I", *units))
    parts += [struct.pack(">HH", d.normal, d.used) for d in pmu.digitals]
    if long:
        s, kind = pmu.site, pmu.site.service_class.encode()
        parts.append(struct.pack(">fffcII", s.latitude, s.longitude, s.elevation, kind, s.window_us, s.group_delay_us))
    return b"".join([*parts, struct.pack(">HH", pmu.nominal_hz == 50, pmu.changes)])


def _count(value: float, minimum: int, field: str) -> int:
    whole, maximum = round(value), minimum + (1 << 24) - 1
    if not minimum <= whole <= maximum:
        raise FrameError(f"{field}: {value:g} counts; allowed: {minimum} to {maximum} (6.4)")
    return whole & 0xFFFFFF


def _read_pmu(reader: _Reader, *, long: bool) -> PmuConfiguration:
    name = reader.name("STN", long=long)
    (idcode,) = reader.take("H", "IDCODE")
    (global_id,) = reader.take("16s" if long else "0s", "G_PMU_ID")
    form, phasors, analogs, digitals = reader.take("4H", "FORMAT, PHNMR, ANNMR, DGNMR")
    names = [reader.name("CHNAM", long=long) for _ in range(phasors + analogs + BITS * digitals)]
    of_phasors, of_analogs, of_digitals = (
        names[:phasors],
        names[phasors : phasors + analogs],
        names[phasors + analogs :],
    )
    words = [reader.take("Iff" if long else "I", "PHUNIT") for _ in of_phasors]
    units = [reader.take("ff" if long else "I", "ANUNIT") for _ in of_analogs]
    states = [reader.take("HH", "DIGUNIT") for _ in range(digitals)]
    site = Site()
    if long:
        north, east, high, kind, window, late = reader.take("fffcII", "PMU_LAT to GRP_DLY")
        site = Site(global_id, north, east, high, kind.decode("latin-1"), window, late)
    nominal, changes = reader.take("HH", "FNOM, CFGCNT")
    return PmuConfiguration(
        name,
        idcode,
        tuple((_long_phasor if long else _phasor)(n, *w) for n, w in zip(of_phasors, words, strict=True)),
        tuple(Analog(n, 0, *u) if long else _analog(n, *u) for n, u in zip(of_analogs, units, strict=True)),
        tuple(Digital(tuple(of_digitals[BITS * i : BITS * (i + 1)]), *states[i]) for i in range(digitals)),
        **{field: bool(form >> bit & 1) for bit, field in enumerate(FORMATS)},
        nominal_hz=50 if nominal & 1 else 60,
        changes=changes,
        site=site,
    )


def _phasor(name: str, word: int) -> Phasor:
    return Phasor(name, word >> 24 == 1, (word & 0xFFFFFF) * UNIT)


def _long_phasor(name: str, word: int, scale: float, angle: float) -> Phasor:
    return Phasor(name, bool(word >> 11 & 1), scale, angle, word >> 16)


def _analog(name: str, word: int) -> Analog:
    count = word & 0xFFFFFF
    return Analog(name, word >> 24, float(count - (1 << 24) if count >> 23 else count))
