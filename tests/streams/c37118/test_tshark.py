"""Frames as Wireshark's dissector reads them: none malformed, and what was put in, in every format.

It reads configuration 3, too, but of one in parts the frames alone. What is missing it knows of phasors alone.
"""

from __future__ import annotations

import itertools
import re
import shutil
import struct
import subprocess
from xml.etree import ElementTree as ET

import numpy as np
import pytest

from facts_damping_streams.c37118 import configuration, frame, session, stat, system_pmus
from facts_damping_streams.c37118.configuration import (
    UNIT,
    Analog,
    Configuration,
    Digital,
    Phasor,
    PmuConfiguration,
    Site,
)
from facts_damping_streams.c37118.data import MISSING, RADIAN, Data
from facts_damping_streams.c37118.session import Instant
from facts_damping_streams.c37118.system_pmus import Pmu

TSHARK = shutil.which("tshark")
pytestmark = pytest.mark.skipif(TSHARK is None, reason="needs Wireshark's dissector: apt install tshark")

SOC, FRACTION = 1_700_000_000, 250_000
KINDS = ("configuration_1", "configuration_2", "configuration_3")
GRID = [Pmu("G1", 20.0, 100.0), Pmu("TIE", 230.0, 100.0)]
MEASURED = np.array([
    [0.9812, 0.4123, 1.234e-3, 7.031, -2.017, 60.0512, 0.312, 7.4, -0.5012],
    [1.0123, -2.513, np.nan, -3.011, 0.5071, 59.9036, -0.257, np.nan, np.nan],
])  # fmt: skip
GIVEN = list(itertools.product((False, True), repeat=4))
FORMATS = [dict(zip(configuration.FORMATS, flags, strict=True)) for flags in GIVEN]
STREAMS = [
    session.stream(100 + k, system_pmus.configuration(GRID, 60, 60, formats)) for k, formats in enumerate(FORMATS)
]
EACH = range(len(STREAMS))
CLOCKS = 2 * [  # the largest error and the unlocked time, s, a status; what is read of them
    (5e-8, 1.0, 0, ("error < 100 ns", "within 10^-7 s", "less than 10 s", "Good measurement data")),
    (5e-7, 9.0, stat.DATA_ERROR, ("error < 1 µs", "within 10^-6 s", "less than 10 s", "PMU error (do not use")),
    (5e-6, 90.0, stat.TEST_MODE, ("error < 10 µs", "within 10^-5 s", "for 10-100 s", "PMU in test mode or absent")),
    (5e-5, 900.0, 0x2000, ("error < 100 µs", "within 10^-4 s", "for 100-1000 s", "Synchronization lost")),
    (5e-4, 9000.0, 0x1000, ("error < 1 ms", "within 10^-3 s", "for over 1000 s", "By arrival")),
    (5e-3, 90.0, 0x0800, ("error < 10 ms", "within 10^-2 s", "for 10-100 s", "Trigger detected: Trigger detected")),
    (5e-1, 900.0, 0x0400, ("error > 10 ms", "within 1 s", "for 100-1000 s", "Configuration changed: Within 1 minute")),
    (50.0, 9000.0, 0x0200, ("error > 10 ms", "Clock failure", "for over 1000 s", "Data modified by a post-processing")),
]
COMMANDS = {"turn_off": "data transmission off", "turn_on": "data transmission on", "send_header": "send HDR frame"}
COMMANDS |= {f"send_configuration_{i}": f"send CFG-{i} frame" for i in (1, 2, 3)} | {"extended": "extended frame"}
FLAGS = {"status": 14, "sync": 13, "sorting": 12, "trigger": 11, "CFGchange": 10, "data_modified": 9}  # bits of STAT
FLAGS |= {"pmu_tq": 6, "t_unlock": 4, "trigger_reason": 0}
# What PMUs do not have: offsets, digital words, 50 Hz, a place, seconds a frame, another base of time.
BREAKERS = Digital(tuple(f"BREAKER {i}" for i in range(16)), 0xA5A5, 0x7FFF)
PHASOR, ANALOG = Phasor("V", scale=0.5, angle=0.25), Analog("T", 2, 2.0, 10.0)
SITE = Site(bytes(range(16)), 45.5, 9.25, 120.0, "P", 33_333, 16_667)
PMU = PmuConfiguration("X", 9, (PHASOR,), (ANALOG,), (BREAKERS,), nominal_hz=50, changes=7, site=SITE)
OTHER = session.stream(9, Configuration((PMU,), -5, 1 << 23), "A text")
VALUES = Data(*map(np.array, ([0], [[100.0, 0.5]], [50.1], [0.0], [30.0], [0x3C12])))


def status(k: int) -> list[int]:
    """STAT of two PMUs."""
    error_s, unlocked_s, states = (np.full(2, value) for value in CLOCKS[k][:3])
    return [int(word) for word in stat.word(states, np.ones(2, bool), error_s, unlocked_s)]


def sent() -> dict[str, bytes]:
    """Frames by what they are; data behind the configuration by which they are read."""
    frames = {name: frame.command(7, name, SOC, FRACTION, b"word" * (name == "extended")) for name in COMMANDS}
    for k, served in enumerate(STREAMS):
        quality = 0x30 | stat.message_quality(np.array([CLOCKS[k][0]]))
        instant = Instant(SOC, FRACTION, quality, system_pmus.to_data(GRID, MEASURED, np.array(status(k))))
        for kind in KINDS:
            (frames[f"{k} {kind}"],) = session.answers(served, f"send_{kind}", SOC, FRACTION)
            frames |= {f"{k} data {kind}": session.data_frame(served, instant)} if kind != KINDS[0] else {}
    for kind in ("header", KINDS[2]):
        (frames[f"other {kind}"],) = session.answers(OTHER, f"send_{kind}", SOC, 1 << 22)
    return frames | {"other data": session.data_frame(OTHER, Instant(SOC, 1 << 21, 0, VALUES))}


def packet(protocol: int, head: bytes, raw: bytes) -> bytes:
    """An IPv4 packet in a capture file."""
    size = 20 + len(head) + len(raw)
    return struct.pack("<8xII", size, size) + struct.pack(">BxH4xBB10x", 0x45, size, 64, protocol) + head + raw


@pytest.fixture(scope="module")
def dissected(tmp_path_factory: pytest.TempPathFactory) -> dict[str, ET.Element]:
    """All frames as they are dissected: over UDP, and those of a stream also over TCP, cut anywhere."""
    frames, file = sent(), tmp_path_factory.mktemp("tshark") / "frames.pcap"
    over_tcp = {f"tcp {name}": raw for name, raw in frames.items() if name.startswith("15 ")}
    stream, parts = b"".join(over_tcp.values()), [struct.pack("<IHH8xII", 0xA1B2C3D4, 2, 4, 65535, 101)]  # raw IP
    parts += [packet(17, struct.pack(">4H", 4713, 4713, 8 + len(raw), 0), raw) for raw in frames.values()]
    for at in range(0, len(stream), 97):
        parts.append(packet(6, struct.pack(">2H2I2H4x", 4712, 4712, at, 1, 0x5018, 65535), stream[at : at + 97]))
    file.write_bytes(b"".join(parts))
    ports = ("-d", "udp.port==4713,synphasor", "-d", "tcp.port==4712,synphasor")
    dissected = subprocess.run([str(TSHARK), "-n", "-r", file, *ports, "-T", "pdml"], check=True, capture_output=True)
    read = ET.fromstring(dissected.stdout)
    assert not read.findall(".//proto[@name='_ws.malformed']")
    return dict(zip([*frames, *over_tcp], read.findall(".//proto[@name='synphasor']"), strict=True))


def fields(element: ET.Element, name: str, attribute: str = "show") -> list[str]:
    return [field.get(attribute, "") for field in element.iter("field") if field.get("name") == name]


def numbers(element: ET.Element, *names: str) -> list[int]:
    return [int(value, 16) for name in names for value in fields(element, f"synphasor.{name}", "value")]


def floats(element: ET.Element, name: str) -> list[float]:
    return [float(value) for value in fields(element, f"synphasor.{name}")]


def lines(element: ET.Element) -> str:
    return "\n".join(field.get("showname", "") or field.get("show", "") for field in element.iter("field"))


def unsaid(element: ET.Element, *texts: str) -> list[str]:
    return [text for text in texts if text not in lines(element)]


def phasors(element: ET.Element) -> list[tuple[str, complex]]:
    """Name and unit, value."""
    rows = re.findall(r'"(\w+) *", +(\S+)([VA]) ∠ *(\S+)°', lines(element))
    return [(name + unit, float(size) * np.exp(1j * np.radians(float(angle)))) for name, size, unit, angle in rows]


def test_wireshark_finds_no_errors_but_those_of_the_status_word(dissected: dict[str, ET.Element]) -> None:
    for element in dissected.values():
        assert fields(element, "synphasor.checksum.status") == ["1"]
        assert set(fields(element, "_ws.expert.message")) <= {"Data Error flag set", "PMU not sync flag set"}
        assert numbers(element, "version", "soc") == [frame.VERSION, SOC]


def test_over_tcp_it_is_the_same(dissected: dict[str, ET.Element]) -> None:
    """But for which configuration it took, and what it makes of fractions of a second before one."""
    for name in (name for name in dissected if name.startswith("15 ")):
        both = [
            re.sub("(Dissected|Fraction of second:).*\n", "", lines(dissected[key])) for key in (name, f"tcp {name}")
        ]
        assert both[0] == both[1]


def test_commands_and_headers(dissected: dict[str, ET.Element]) -> None:
    for name, said in COMMANDS.items():
        assert numbers(dissected[name], "idcode_stream_source", "command") == [7, frame.COMMANDS[name]]
        assert unsaid(dissected[name], f"Command: {said}") == []
    assert fields(dissected["extended"], "synphasor.extended_frame_data", "value") == [b"word".hex()]
    assert fields(dissected["other header"], "synphasor.data", "value") == [b"A text".hex()]


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("k", EACH)
def test_configurations(dissected: dict[str, ET.Element], k: int, kind: str) -> None:
    element, c, long = dissected[f"{k} {kind}"], STREAMS[k].configuration, kind == KINDS[2]
    assert numbers(element, "frtype", "idcode_stream_source", "fracsec_raw") == [frame.KINDS[kind], 100 + k, FRACTION]
    assert numbers(element, "conf.timebase", "conf.numpmu", "rate_of_transmission") == [c.time_base, 2, 60]
    assert numbers(element, "idcode_data_source", "num_phasors", "num_analog_values") == [1, 2, 2, 2, 3, 3]
    formats = ("phasor_notation", "phasor_format", "analog_format", "dfreq_format")
    assert [numbers(element, f"conf.{name}") for name in formats] == [[flag, flag] for flag in GIVEN[k]]
    names = fields(element, "synphasor.conf.chnam" if long else "synphasor.channel_name")
    assert [name.rstrip() for name in names] == [*system_pmus.PHASORS, *system_pmus.ANALOGS] * 2
    assert re.findall(r'Station #\d: "(\w+) *"', lines(element)) == ["G1", "TIE"]
    scales = [p.scale for pmu in c.pmus for p in pmu.phasors], [a.scale for pmu in c.pmus for a in pmu.analogs]
    if not long:
        assert [round(scale / UNIT) for scale in scales[0]] == [
            n & 0xFFFFFF for n in numbers(element, "conversion_factor")
        ]
        assert re.findall(r"\* 10\^-5, unit: (\w+)", lines(element)) == ["Volt", "Ampere"] * 2
        assert re.findall("rms of analog input, value: (.+)", lines(element)) == [f"{scale:.0f}" for scale in scales[1]]
        return
    assert numbers(element, "conf.phasor_type", "conf.phasor_component") == [0, 1, 0, 1, 1, 1, 1, 1]
    assert GIVEN[k][1] or floats(element, "conf.phasor_scale_factor") == pytest.approx(scales[0], rel=1e-5)
    assert GIVEN[k][2] or floats(element, "conf.analog_scale_factor") == scales[1]


@pytest.mark.parametrize("kind", KINDS[1:])
@pytest.mark.parametrize("k", EACH)
def test_data(dissected: dict[str, ET.Element], k: int, kind: str) -> None:
    """Floats to the digits that are printed, integers within a count."""
    element, pmus, text = (
        dissected[f"{k} data {kind}"],
        STREAMS[k].configuration.pmus,
        lines(dissected[f"{k} data {kind}"]),
    )
    polar, float_phasors, float_analogs, float_frequency = GIVEN[k]
    wanted = system_pmus.to_data(GRID, MEASURED, np.array(status(k)))
    assert numbers(element, "idcode_stream_source", "fracsec_raw") == [100 + k, FRACTION]
    assert numbers(element, "timeqal.lsdir", "timeqal.lsocc", "timeqal.lspend") == [0, 1, 1]
    assert unsaid(element, *CLOCKS[k][-1], 'Station: "G1', 'Station: "TIE', "second: 250") == []
    words = [np.array(numbers(element, f"data.{name}")) << bit for name, bit in FLAGS.items()]
    assert np.add.reduce(words).tolist() == status(k)
    names, read = zip(*phasors(element), strict=True)
    assert names == ("V1V", "I1A", "V1V", "I1A")
    size, angle = wanted.phasors.T
    near = 1e-3 + 1e-5 * size  # of what is printed
    near += 0.0 if float_phasors else [p.scale for pmu in pmus for p in pmu.phasors] + RADIAN * polar * size
    assert (np.abs(read - size * np.exp(1j * angle)) <= near).tolist() == [True, True, True, False]
    assert np.isnan(read[3])
    frequency = fields(element, "synphasor.actual_frequency_value") or re.findall(r"actual frequency: (.+)Hz", text)
    near = (1e-4, 1e-6) if float_frequency else (1e-3, 1e-2)
    assert [float(hertz) for hertz in frequency] == pytest.approx(wanted.frequency, abs=near[0])
    assert floats(element, "rate_change_frequency") == pytest.approx(wanted.rocof, abs=near[1])
    analogs = re.findall(r'#\d: "[^"]+", (\S+)(?: \(conversion factor: 0x1(\w+)\))?$', text, re.MULTILINE)
    values = np.array([float(value) * int(factor or "1", 16) for value, factor in analogs])
    scales = np.array([1e-3 if float_analogs else a.scale for pmu in pmus for a in pmu.analogs])
    missing = np.nan if float_analogs else MISSING * scales[-1]  # it does not know
    np.testing.assert_allclose(values / scales, np.nan_to_num(wanted.analogs, nan=missing) / scales, rtol=0.0, atol=1.0)


def test_wireshark_reads_fields_that_pmus_of_runs_do_not_have(dissected: dict[str, ET.Element]) -> None:
    configured = (
        "second: 500", "frequency: 50Hz", "1 frame per 5 second", "change count: 7", "00 01 02 03 04 05 06 07 08 09 0a",
        "Latitude: 45.5", "Longitude: 9.25", "Elevation: 120", "Protection", "length: 33333 mic", "delay: 16667 mic",
        '"BREAKER 15"', "Normal state: 0xa5a5", "Valid bits: 0x7fff", "Analog scale factor: 2", "Analog offset: 10",
    )  # fmt: skip
    measured = ("second: 250", '"T", 30.000', "status word #1: 0x3c12", "actual frequency: 50.100Hz")
    assert unsaid(dissected["other configuration_3"], *configured) == unsaid(dissected["other data"], *measured) == []


def test_phasors_are_turned_by_their_angle(dissected: dict[str, ET.Element]) -> None:
    ((_, value),) = phasors(dissected["other data"])
    assert abs(value - 100.0 * np.exp(0.5j)) < PHASOR.scale


def test_floats_are_scaled_already(dissected: dict[str, ET.Element]) -> None:
    for name in ("phasor", "analog"):
        assert set(floats(dissected["15 configuration_3"], f"conf.{name}_scale_factor")) == {1.0}
