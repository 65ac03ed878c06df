"""Messages of C37.118.2: there and back in all formats, beside another program, and with bytes that are none."""

from __future__ import annotations

import math
import struct
from binascii import crc_hqx
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from facts_damping_streams.c37118 import configuration, data, frame
from facts_damping_streams.c37118.configuration import Analog, Configuration, Digital, Phasor, PmuConfiguration, Site
from facts_damping_streams.c37118.data import Data
from facts_damping_streams.c37118.frame import Frame, FrameError

KINDS = ("configuration_1", "configuration_2", "configuration_3")
UNITS = (0.001, 0.25, 12.5, 91.6)  # V or A a count


def float32(value: float) -> float:
    return float(np.float32(value))


@st.composite
def pmus(draw: Any) -> PmuConfiguration:
    text = st.text(st.characters(min_codepoint=33, max_codepoint=126), min_size=1, max_size=16)
    formats = {name: draw(st.booleans()) for name in configuration.FORMATS}
    phasors = draw(st.lists(st.tuples(text, st.booleans(), st.sampled_from(UNITS)), max_size=4))
    analogs = draw(st.lists(st.tuples(text, st.integers(0, 2), st.integers(1, 5000)), max_size=3))
    digitals = draw(st.lists(st.lists(text, min_size=16, max_size=16), max_size=2))
    return PmuConfiguration(
        draw(text),
        draw(st.integers(1, 65534)),
        tuple(Phasor(*parts) for parts in phasors),
        tuple(Analog(n, k, float(s)) for n, k, s in analogs),
        tuple(Digital(tuple(names), 0xA5A5, 0xFFFF) for names in digitals),
        **formats,
        nominal_hz=draw(st.sampled_from((50, 60))),
        changes=draw(st.integers(0, 65535)),
    )


streams = st.builds(
    Configuration,
    st.lists(pmus(), min_size=1, max_size=3).map(tuple),
    st.sampled_from((60, 1, -5)),
    st.sampled_from((1_000_000, 1 << 23)),
)


def as_told(c: Configuration, kind: str) -> Configuration:
    """What is left of a configuration in a frame of a kind: 3 has scales as floats of 32 bits, 1 where values are."""
    if kind != "configuration_3":
        return c

    def phasor(pmu: PmuConfiguration, phasor_channel: Phasor) -> Phasor:
        return phasor_channel._replace(scale=1.0 if pmu.float_phasors else float32(phasor_channel.scale), flags=0)

    def analog(pmu: PmuConfiguration, analog_channel: Analog) -> Analog:
        return analog_channel._replace(scale=1.0 if pmu.float_analogs else analog_channel.scale, kind=0)

    return c._replace(
        pmus=tuple(
            p._replace(
                phasors=tuple(phasor(p, phasor_channel) for phasor_channel in p.phasors),
                analogs=tuple(analog(p, analog_channel) for analog_channel in p.analogs),
            )
            for p in c.pmus
        )
    )


@given(streams, st.sampled_from(KINDS))
def test_configurations_there_and_back(c: Configuration, kind: str) -> None:
    bodies = configuration.encode(c, kind)
    frames = [frame.encode(Frame(kind, 7, 1_700_000_000, 42, body)) for body in bodies]
    read = [frame.decode(raw) for raw in frames]
    assert all(
        (read_frame.kind, read_frame.idcode, read_frame.soc, read_frame.fraction) == (kind, 7, 1_700_000_000, 42)
        for read_frame in read
    )
    decoded = configuration.decode([read_frame.body for read_frame in read], kind)
    wanted = as_told(c, kind)
    scales = [[p.scale for pmu in whole.pmus for p in pmu.phasors] for whole in (decoded, wanted)]
    assert scales[0] == pytest.approx(scales[1], rel=1e-12)
    level = [
        whole._replace(
            pmus=tuple(p._replace(phasors=tuple(q._replace(scale=1.0) for q in p.phasors)) for p in whole.pmus)
        )
        for whole in (decoded, wanted)
    ]
    assert level[0] == level[1]


def measured(c: Configuration, seed: int) -> Data:
    """Values that fit into the integers of a configuration."""
    rng = np.random.default_rng(seed)
    phasors = [p for pmu in c.pmus for p in pmu.phasors]
    magnitude = np.array([rng.uniform(0.0, 32000.0) * p.scale for p in phasors])
    nominal = np.array([pmu.nominal_hz for pmu in c.pmus])
    return Data(
        rng.integers(0, 65536, len(c.pmus)),
        np.column_stack([magnitude, rng.uniform(-math.pi, math.pi, len(phasors))]).reshape(-1, 2),
        nominal + rng.uniform(-5.0, 5.0, len(c.pmus)),
        rng.uniform(-30.0, 30.0, len(c.pmus)),
        np.array([rng.uniform(-30000.0, 30000.0) * a.scale for pmu in c.pmus for a in pmu.analogs]),
        rng.integers(0, 65536, sum(len(pmu.digitals) for pmu in c.pmus)),
    )


@given(streams, st.integers(0, 1 << 32))
def test_data_there_and_back_floats_bit_for_bit_integers_within_half_a_count(c: Configuration, seed: int) -> None:
    layout, sent = data.layout(c), measured(c, seed)
    decoded = data.decode(layout, data.encode(layout, sent))
    np.testing.assert_array_equal(decoded.status, sent.status)
    np.testing.assert_array_equal(decoded.digitals, sent.digitals)
    p = a = 0
    for i, pmu in enumerate(c.pmus):
        exact = [np.float32(value) for value in (sent.frequency[i], sent.rocof[i])]
        if pmu.float_frequency:
            assert [decoded.frequency[i], decoded.rocof[i]] == exact
        else:
            assert decoded.frequency[i] == pytest.approx(sent.frequency[i], abs=0.5001e-3)
            assert decoded.rocof[i] == pytest.approx(sent.rocof[i], abs=0.5001e-2)
        for phasor in pmu.phasors:
            if pmu.polar and pmu.float_phasors:
                assert decoded.phasors[p].tolist() == sent.phasors[p].astype(np.float32).tolist()
            z = [m * np.exp(1j * angle) for m, angle in (decoded.phasors[p], sent.phasors[p])]
            step = (
                1e-6 * abs(z[1])
                if pmu.float_phasors
                else 0.71 * phasor.scale + (5.1e-5 * abs(z[1]) if pmu.polar else 0.0)
            )
            assert abs(z[0] - z[1]) <= step
            p += 1
        for analog in pmu.analogs:
            if pmu.float_analogs:
                assert decoded.analogs[a] == np.float32(sent.analogs[a])
            else:
                assert decoded.analogs[a] == pytest.approx(sent.analogs[a], abs=0.5001 * analog.scale)
            a += 1


def stream(**formats: Any) -> Configuration:
    first = PmuConfiguration("Station A", 7734, (Phasor("VA"), Phasor("I1", True)), (Analog("P"),), **formats)
    return Configuration((first, PmuConfiguration("B", 5, (Phasor("V"),), nominal_hz=50)), 30)


@pytest.mark.parametrize("floats", [True, False])
def test_missing_values_are_decoded_as_missing(floats: bool) -> None:
    c = stream(float_phasors=floats, float_frequency=floats, float_analogs=floats, polar=True)
    layout, sent = data.layout(c), measured(c, 1)
    for values in (sent.phasors, sent.frequency, sent.rocof, sent.analogs):
        values[0] = np.nan
    decoded = data.decode(layout, data.encode(layout, sent))
    assert np.isnan(decoded.phasors[0, 1])
    assert np.isnan([decoded.frequency[0], decoded.rocof[0], decoded.analogs[0]]).all()
    assert np.isfinite(decoded.frequency[1])


@pytest.mark.filterwarnings("error")
def test_infinite_values_are_missing() -> None:
    pmu = PmuConfiguration("A", 1, (Phasor("V"),), (Analog("P"),), (), True, True, True, True)
    layout = data.layout(Configuration((pmu,), 60))
    decoded = data.decode(layout, bytes(2) + 5 * struct.pack(">f", math.inf))
    assert np.isnan([*decoded.phasors.ravel(), *decoded.frequency, *decoded.rocof, *decoded.analogs]).all()


@pytest.mark.parametrize(("scale", "angle"), [(math.inf, 0.0), (math.nan, 0.0), (1.0, math.inf)])
def test_layout_refuses_scales_that_are_no_numbers(scale: float, angle: float) -> None:
    pmu = PmuConfiguration("A", 1, (Phasor("V", False, scale, angle),))
    with pytest.raises(FrameError, match="allowed: any"):
        data.layout(Configuration((pmu,), 60))


def test_beyond_the_integers_are_their_ends() -> None:
    c = stream(polar=True)
    layout, sent = data.layout(c), measured(c, 1)
    sent.phasors[0], sent.frequency[0] = (1e9, 0.0), 1e6
    decoded = data.decode(layout, data.encode(layout, sent))
    assert decoded.phasors[0, 0] == 65535.0
    assert decoded.frequency[0] == pytest.approx(60.0 + 32.767)


def test_frame_by_hand() -> None:
    """A data frame of one PMU, byte by byte as in table 5: STAT, a phasor, FREQ, DFREQ, one analog, CHK."""
    c = Configuration(
        (PmuConfiguration("X", 60, (Phasor("V", scale=0.5),), (Analog("A", scale=2.0),), polar=False),), 30
    )
    layout = data.layout(c)
    sent = Data(
        np.array([0x2000]),
        np.array([[100.0, math.pi / 2]]),
        np.array([60.1]),
        np.array([-0.5]),
        np.array([8.0]),
        np.zeros(0, int),
    )
    raw = frame.encode(Frame("data", 60, 0x5F5E1000, 0x123456, data.encode(layout, sent), quality=0x0F))
    body = struct.pack(">BBHHII", 0xAA, 0x02, 28, 60, 0x5F5E1000, 0x0F123456)
    body += struct.pack(">Hhhhhh", 0x2000, 0, 200, 100, -50, 4)
    assert raw == body + struct.pack(">H", crc_hqx(body, 0xFFFF))


def test_check_word_is_that_of_annex_b() -> None:
    """Bit by bit: x^16 + x^12 + x^5 + 1, from all ones on."""
    for text in (b"", b"Arnold", bytes(range(256))):
        register = 0xFFFF
        for byte in text:
            register ^= byte << 8
            for _ in range(8):
                register = (register << 1 ^ 0x1021) & 0xFFFF if register & 0x8000 else register << 1
        assert frame.checksum(text) == register


def test_commands_there_and_back() -> None:
    for name in frame.COMMANDS:
        assert frame.command_of(frame.decode(frame.command(3, name, 5))) == name
    with pytest.raises(FrameError, match="CMD: 7 given; allowed: 1, 2, 3, 4, 5, 6, 8"):
        frame.command_of(Frame("command", 3, 5, 0, b"\0\7"))


def test_long_configuration_3_is_sent_in_parts() -> None:
    names = tuple(f"bit {i} " + "x" * 200 for i in range(16))
    wide = PmuConfiguration("W", 1, (), (), tuple(Digital(names) for _ in range(15)), site=Site(latitude=47.5))
    c = Configuration((wide, wide._replace(idcode=2)), 60)
    bodies = configuration.encode(c, "configuration_3")
    assert [int.from_bytes(body[:2], "big") for body in bodies] == [1, 0xFFFF]
    assert configuration.decode(bodies, "configuration_3") == c
    assert [configuration.whole(bodies[:k]) for k in range(3)] == [False, False, True]
    with pytest.raises(FrameError, match=r"CONT_IDX: \[65535, 1\] given; allowed: \[1, 65535\]"):
        configuration.decode(bodies[::-1], "configuration_3")


def test_frames_are_found_in_a_stream_with_rubbish() -> None:
    whole = [frame.command(i, "turn_on", 9) for i in range(1, 6)]
    sent_bytes = bytearray()
    for i, raw in enumerate(whole):
        sent_bytes += bytes([0xAA, 0x41] * i) + raw
    sent_bytes += whole[0][:7]
    frames_found, lost = list[bytes](), 0
    stream = bytearray()
    for byte in bytes(sent_bytes):
        stream.append(byte)
        more, skipped = frame.split(stream)
        frames_found, lost = frames_found + more, lost + skipped
    assert frames_found == whole
    assert lost == 2 * sum(range(5))
    assert bytes(stream) == whole[0][:7]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda b: b[:10], "a frame of 10 bytes; allowed: 16 and more"),
        (lambda b: b"\xab" + b[1:], "SYNC: ab"),
        (lambda b: b[:-1] + bytes([b[-1] ^ 1]), "CHK: 0x"),
        (lambda b: b + b"\0", "FRAMESIZE: "),
    ],
)
def test_malformed_frame_is_refused_with_the_reason(change: Any, message: str) -> None:
    whole = frame.encode(Frame("header", 1, 2, 3, b"hello"))
    with pytest.raises(FrameError, match=message):
        frame.decode(change(whole))


@pytest.mark.parametrize(("fraction", "quality"), [(0, 0xFF), (0xFFFFFF, 0), (0xABCDEF, 0x35)])
def test_fraction_and_quality_share_a_word(fraction: int, quality: int) -> None:
    sent = Frame("header", 1, 2, fraction, b"hello", quality)
    assert frame.decode(frame.encode(sent)) == sent
