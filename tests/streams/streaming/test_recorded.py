"""A recording as a stream, by the command: values to the bits of 32, its own pace, another program beside ours."""

from __future__ import annotations

import json
import socket
import subprocess
import sys
import time
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from facts_damping.case.loading import load_case
from facts_damping.nodes.launching import graph
from facts_damping.recording.reader import load
from facts_damping.simulation import loop
from facts_damping_streams.c37118 import frame, system_pmus
from facts_damping_streams.c37118.session import Instant, Receiver
from facts_damping_streams.streaming import recorded
from facts_damping_streams.streaming.pdc import Pdc, grid_pmus
from facts_damping_testing.loopback.opening import opened
from tests.commands import assert_one_line
from tests.nodes.graphs import LOADED_S, quiet

if TYPE_CHECKING:
    from pathlib import Path

EPOCH, HERE = 1_700_000_000, "127.0.0.1"


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    with opened():
        case = load_case("two_area_small", ["duration=1"])
        return graph.run(case, "lockstep", tmp_path_factory.mktemp("served"), quiet, LOADED_S).recording


def listen(port: int, idcode: int, until: int) -> tuple[list[Any], list[float]]:
    """Configuration and so many instants, and when each came."""
    end = time.monotonic() + LOADED_S
    while True:
        try:
            stream = socket.create_connection((HERE, port), timeout=LOADED_S)
            break
        except ConnectionRefusedError:
            assert time.monotonic() < end
            time.sleep(0.05)
    receiver, contents, times = Receiver(), list[Any](), list[float]()
    with stream:
        stream.sendall(frame.command(idcode, "send_configuration_3", 0) + frame.command(idcode, "turn_on", 0))
        while len(contents) < until + 1 and (received := stream.recv(65536)):
            more = receiver.feed(received)
            contents += more
            times += [time.monotonic()] * len(more)
    assert (receiver.lost_bytes, receiver.refused) == (0, {})
    return contents, times


def serve(recording: Path, *options: str) -> subprocess.Popen[str]:
    command = [sys.executable, "-m", "facts_damping", "pmu-serve", str(recording), "--epoch", str(EPOCH), *options]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def test_client_gets_what_was_recorded(recording: Path, port: int) -> None:
    record = load(recording)
    seen = grid_pmus(load_case("two_area_small", []))
    with serve(recording, "--port", str(port), "--json", "-") as server:
        contents, times = listen(port, 1, len(record.time_ns))
        out, err = server.communicate(timeout=LOADED_S)
    assert (server.returncode, err) == (0, "")
    assert [pmu.name for pmu in contents[0].pmus] == record.pmus
    assert len(contents) == 1 + len(record.time_ns)
    for k, content in enumerate(contents[1:]):
        assert isinstance(content, Instant)
        assert (content.soc, content.fraction) == (EPOCH + k // 60, k % 60 * 1_000_000 // 60)
        wanted = system_pmus.to_data(seen, record.frames[k], record.status[k])
        for name in ("phasors", "frequency", "rocof", "analogs"):
            np.testing.assert_array_equal(getattr(content.data, name), getattr(wanted, name).astype(np.float32))
        np.testing.assert_array_equal(content.data.status, 0)
    assert times[-1] - times[1] > 0.9  # its own pace
    (row,) = json.loads(out)["streams"]
    assert (row["frames"], row["clients"], row["dropped"], row["refused"]) == (60, 1, 0, {})


def test_recording_is_served_with_a_stream_for_each_station(recording: Path, port: int) -> None:
    record = load(recording)
    with serve(recording, "--port", str(port), "--each", "--idcode", "40", "--format", "none") as server:
        contents, _ = listen(port + 4, 44, 30)
        server.terminate()
        server.communicate(timeout=LOADED_S)
    assert [(pmu.name, pmu.idcode) for pmu in contents[0].pmus] == [("TIE", 44)]
    magnitudes = np.array([content.data.phasors[0, 0] for content in contents[1:31]])
    volts = grid_pmus(load_case("two_area_small", []))[4].volts
    assert np.abs(magnitudes / volts - record.frames[:30, 4, system_pmus.MAGNITUDE]).max() < 2.0 / 30000


def test_instants_without_measurements_are_absent_from_the_stream() -> None:
    """PMUs of class M: the first frames are not there; later ones describe the instant six frames ago."""
    case = load_case("two_area_small", ["duration=1", "measurement=m_class", "controllers=[]"])
    record = loop.run(case)
    timed = list(recorded.instants(record, Pdc(case, EPOCH)))
    ticks = round(timed[0][0] * 60)
    assert 0 < ticks < 20
    assert (timed[0][1].soc, timed[0][1].fraction) == (EPOCH, 0)
    assert [instant.fraction for _, instant in timed[:3]] == [0, 16666, 33333]
    assert len(timed) == len(record.time_ns) - ticks


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--format", "polar,doubles"], "format: 'doubles' given; allowed: polar, float_phasors"),
        (["--to", "here"], "to: 'here' given; allowed: HOST:PORT"),
        (["--idcode", "65530"], "idcode: 65530 given with 5 PMUs; allowed: 1 to 65529"),
        (["--behind", "1"], "--behind: 1 given; allowed: a link of the recording, 0 to 0"),
        (["--port", "70000"], "argument --port: 70000 given; allowed: 0 to 60000"),
    ],
)
def test_bad_options_are_one_line(
    recording: Path, options: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert_one_line(2, ["pmu-serve", str(recording), *options], message, capsys)
