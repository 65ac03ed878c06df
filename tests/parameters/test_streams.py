"""Files of streams: addresses, channels with their units, and one line for what is wrong."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from facts_damping.errors import InputError
from facts_damping_streams.parameters import Server, read_streams, server

if TYPE_CHECKING:
    from pathlib import Path

WHOLE = """
servers: [tcp://pdc.example.org:4712/7, udp://@239.255.0.37:4713]
wait: 0.1
pmus:
  G1:
    pmu: GENERATOR 1
    voltage: V1LPM
    current: {channel: I1LPM, reverse: true}
    active_power: {channel: MW, unit: MW}
  TIE: {pmu: 23}
"""


def test_whole_file(tmp_path: Path) -> None:
    path = tmp_path / "streams.yaml"
    path.write_text(WHOLE)
    streams_read = read_streams(str(path))
    assert [server(text) for text in streams_read.servers] == [
        Server("tcp", spontaneous=False, host="pdc.example.org", port=4712, idcode=7),
        Server("udp", spontaneous=True, host="239.255.0.37", port=4713, idcode=1),
    ]
    assert (streams_read.wait, streams_read.pmus["TIE"].pmu, streams_read.pmus["G1"].pmu) == (0.1, 23, "GENERATOR 1")
    assert streams_read.pmus["G1"].voltage is not None
    assert streams_read.pmus["G1"].voltage.channel == "V1LPM"


@pytest.mark.parametrize(
    "text", ["tcp://127.0.0.1:4712/7", "udp://10.0.0.1:1/65534", "udp://@0.0.0.0:4713/1", "udp://@239.255.0.37:9/2"]
)
def test_address_is_what_it_was_written_as(text: str) -> None:
    assert str(server(text)) == text
    assert read_streams(text).servers == [text]


@pytest.mark.parametrize(
    ("content", "said"),
    [
        ("servers: []", "servers: [] given"),
        ("servers: [127.0.0.1:4712]", "'127.0.0.1:4712' given; allowed: tcp://HOST:PORT/IDCODE"),
        ("servers: [tcp://here:0]", "'tcp://here:0' given; allowed"),
        ("servers: [tcp://here:70000]", "'tcp://here:70000' given; allowed"),
        ("servers: [tcp://here:4712/65535]", "allowed: an IDCODE of 1 to 65534"),
        ("servers: [tcp://@here:4712/1]", "'tcp://@here:4712/1' given; allowed"),
        ("servers: [udp://@here:4712/1]", "'udp://@here:4712/1' given; allowed"),
        ("servers: [tcp://a:1/1, tcp://a:1/1]", "a server given twice; allowed: each once"),
        ("servers: [tcp://a:1/1]\nwait: -1.0", "wait: -1.0 given; allowed: greater than or equal to 0"),
        ("servers: [tcp://a:1/1]\npmus: {G1: {voltage: {channel: V, unit: MV}}}", "voltage: unit 'MV' given"),
        ("servers: [tcp://a:1/1]\npmus: {G1: {volts: V}}", "volts: unknown"),
    ],
)
def test_invalid_stream_file_is_refused_in_one_line(tmp_path: Path, content: str, said: str) -> None:
    path = tmp_path / "streams.yaml"
    path.write_text(content)
    with pytest.raises(InputError) as raised:
        read_streams(str(path))
    assert said in str(raised.value)
    assert "\n" not in str(raised.value)
    assert "allowed" in str(raised.value)


def test_missing_stream_file_is_refused_with_what_is_allowed() -> None:
    with pytest.raises(InputError, match="streams: nothing given; allowed: a YAML file, or tcp://"):
        read_streams("")
    with pytest.raises(InputError, match=r"nowhere.yaml: no such file; allowed: an existing YAML file"):
        read_streams("nowhere.yaml")
