"""Frames beside those of the package `synchrophasor`, which reads ours, and whose we read.

It knows configuration 1 and 2. Where frequency is a float, it takes the deviation, not the value (6.3), and refuses 60
Hz; angles of integers it scales as magnitudes: both are left out. It names what Python 3.9 still had.
"""

from __future__ import annotations

import collections
import collections.abc
from typing import Any

import numpy as np
import pytest

collections.Sequence = collections.abc.Sequence  # type: ignore[attr-defined]
from synchrophasor.frame import CommandFrame, CommonFrame, ConfigFrame2, DataFrame, HeaderFrame  # noqa: E402

from facts_damping_streams.c37118 import configuration, data, frame  # noqa: E402
from facts_damping_streams.c37118.configuration import Analog, Configuration, Digital, Phasor, PmuConfiguration  # noqa: E402
from facts_damping_streams.c37118.data import Data  # noqa: E402
from facts_damping_streams.c37118.frame import Frame  # noqa: E402

SOC, FRACTION = 1149577200, 463000
BITS = tuple(f"BREAKER {i} STATUS"[:16] for i in range(16))
FORMATS = [
    {"polar": True, "float_phasors": True, "float_analogs": True},
    {"float_phasors": True},
    {"float_analogs": True},
    {},
]


def stream(**formats: Any) -> Configuration:
    phasors = Phasor("VA", scale=9.15527), Phasor("I1", current=True, scale=0.45776)
    pmu = PmuConfiguration(
        "Station A", 7734, phasors, (Analog("P", 1, 2.0),), (Digital(BITS, 0, 0xFFFF),), changes=22, **formats
    )
    return Configuration((pmu,), 30)


MEASURED = Data(
    np.array([0]), np.array([[134000.0, 0.5], [500.0, -1.0]]), np.array([59.98]), np.array([0.12]), np.array([100.0]),
    np.array([0x3C12])
)  # fmt: skip


@pytest.mark.parametrize("formats", FORMATS)
@pytest.mark.parametrize("kind", ["configuration_1", "configuration_2"])
def test_synchrophasor_package_reads_our_frames(formats: dict[str, Any], kind: str) -> None:
    c = stream(**formats)
    sent = frame.encode(Frame(kind, 7734, SOC, FRACTION, configuration.encode(c, kind)[0]))
    decoded = CommonFrame.convert2frame(sent)
    assert decoded.get_station_name().strip() == "Station A"
    assert decoded.get_id_code() == decoded.get_stream_id_code() == 7734
    assert decoded.get_time_base() == c.time_base
    assert [unit[0] for unit in decoded.get_ph_units()] == [915527, 45776]
    assert decoded.get_channel_names()[:3] == [f"{name:16}" for name in ("VA", "I1", "P")]
    assert (decoded.get_data_rate(), decoded.get_cfg_count(), decoded.get_fnom()) == (30, 22, 60)
    if kind == "configuration_1":
        return  # it reads data by a configuration 2 alone
    body = data.encode(data.layout(c), MEASURED)
    their_frame = CommonFrame.convert2frame(frame.encode(Frame("data", 7734, SOC, FRACTION, body)), decoded)
    for ours, theirs in zip(MEASURED.phasors, their_frame.get_phasors(), strict=True):
        near = 1e-6 * ours[0] if formats.get("float_phasors") else 10.0
        assert abs(ours[0] * np.exp(1j * ours[1]) - theirs[0] * np.exp(1j * theirs[1])) < near
    assert their_frame.get_measurements()["measurements"][0]["frequency"] == pytest.approx(59.98)
    assert their_frame.get_analog() == [100.0 if formats.get("float_analogs") else 50]
    assert their_frame.get_digital() == [0x3C12]
    assert their_frame.get_dfreq() == 12


def test_we_read_its() -> None:
    names = ["VA".ljust(16), "I1".ljust(16), "P".ljust(16), *(bit.ljust(16) for bit in BITS)]
    units = [(915527, "v"), (45776, "i")], [(2, "rms")], [(0, 0xFFFF)]
    decoded = ConfigFrame2(
        7734, 1_000_000, 1, "Station A", 7734, (True, True, True, False), 2, 1, 1, names, *units, 60, 22, 30, SOC,
        FRACTION
    )  # fmt: skip
    read = frame.decode(decoded.convert2bytes())
    assert (read.kind, read.version, read.soc, read.fraction) == ("configuration_2", 1, SOC, FRACTION)
    c = configuration.decode([read.body], read.kind)
    wanted = stream(**FORMATS[0])
    assert [p._replace(scale=0.0) for p in c.pmus[0].phasors] == [p._replace(scale=0.0) for p in wanted.pmus[0].phasors]
    assert (c.pmus[0].analogs, c.pmus[0].digitals, c.rate) == (wanted.pmus[0].analogs, wanted.pmus[0].digitals, 30)
    theirs = DataFrame(
        7734, ("ok", True, "timestamp", False, False, False, 0, "<10", 0), [(134000.0, 0.5), (500.0, -1.0)], -20, 12,
        [100.0], [0x3C12], decoded, SOC, FRACTION
    )  # fmt: skip
    received = data.decode(data.layout(c), frame.decode(theirs.convert2bytes()).body)
    np.testing.assert_allclose(received.phasors, MEASURED.phasors, rtol=1e-7)
    assert [received.frequency[0], received.rocof[0], received.analogs[0]] == pytest.approx([59.98, 0.12, 100.0])
    assert received.digitals.tolist() == [0x3C12]


def test_commands_and_headers_are_the_same() -> None:
    names = {"start": "turn_on", "stop": "turn_off", "header": "send_header", "cfg1": "send_configuration_1"}
    names |= {"cfg2": "send_configuration_2", "cfg3": "send_configuration_3"}
    for theirs, ours in names.items():
        assert frame.command_of(frame.decode(CommandFrame(7, theirs).convert2bytes())) == ours
        assert CommonFrame.convert2frame(frame.command(7, ours, SOC)).get_command() == theirs
    assert frame.decode(HeaderFrame(7, "Hello I am a header").convert2bytes()).body == b"Hello I am a header"
