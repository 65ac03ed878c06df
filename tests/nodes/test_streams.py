"""Streams out of a graph and into another one: the same values, and a controller in shadow that does the same."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from queue import SimpleQueue
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any
from unittest.mock import MagicMock

import numpy as np
import pytest

from facts_damping.case.loading import load_case
from facts_damping.cli.main import main
from facts_damping.monitor_table import SHADOW
from facts_damping.nodes.base.asyncio_thread import AsyncioThread
from facts_damping.nodes.launching import graph
from facts_damping.nodes.launching.starting import Parts
from facts_damping.recording.reader import load
from facts_damping.signals import NANOSECONDS, NEVER
from facts_damping.simulation import loop
from facts_damping_streams.c37118 import system_pmus
from facts_damping_streams.nodes.c37118_client import C37118Client
from facts_damping_streams.streaming import recorded, serving
from facts_damping_streams.streaming.pdc import Pdc, grid_pmus
from facts_damping_streams.streaming.serving import Serving
from tests.commands import assert_one_line
from tests.nodes.graphs import LOADED_S, PATIENCE_S, quiet, wait_until

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

    from facts_damping.record import Record

SECONDS = float(os.environ.get("STREAM_S", "3"))  # 60 was run, too
WAIT_S = 5.0  # for what a loaded machine is late with, and for what a link has lost at the end
HERE = "127.0.0.1"
RUN = "two_area_large"
# Of the other program: it takes a frequency in floats for a deviation, and refuses integers where there is no value.
FLOATS = "polar,float_phasors,float_analogs"
THEIRS = """
import collections, collections.abc, json, sys
collections.Sequence = collections.abc.Sequence  # which Python 3.9 still had
from synchrophasor.pdc import Pdc
pdc = Pdc(pdc_id=1, pmu_ip="127.0.0.1", pmu_port=int(sys.argv[1]))
pdc.run()
pdc.get_config()
pdc.start()
while True:
    got = pdc.get()
    if got is not None:
        print(json.dumps(got.get_measurements()))
"""


@pytest.fixture
def elsewhere(module_domain: int, domain: int) -> dict[str, str]:
    """Environment of nodes in another ROS domain."""
    return {**os.environ, "ROS_DOMAIN_ID": str(module_domain)}


@pytest.fixture
def streams(tmp_path: Path) -> Callable[..., str]:
    """Writes a file of streams with a wait for a loaded machine."""

    def write(*servers: str) -> str:
        path = tmp_path / "streams.yaml"
        path.write_text(json.dumps({"servers": servers, "wait": WAIT_S}))
        return str(path)

    return write


def clients(server: Any) -> int:
    """Number of clients that a server has reported last."""
    return sum(int(count) for count in re.findall(r"0 frames, (\d+) clients", server.texts()[0])[-1:])


def both(sets: list[str], folder: Path, file: str, other: dict[str, str], there: Callable[[], bool]) -> list[Record]:
    """Records of a graph and of one in another domain that receives its streams; it begins once `there` is true."""
    case = load_case(RUN, sets)
    failed = threading.Event()

    def progress(_done: int, _of: int) -> None:
        if failed.is_set():
            raise KeyboardInterrupt

    with ThreadPoolExecutor(1) as beside:
        parts = Parts(streams=file, environment=other)
        shadow = beside.submit(graph.run, case, "realtime", folder / "shadow", progress, LOADED_S, None, parts)
        try:
            deadline = time.monotonic() + PATIENCE_S
            while not there():
                assert time.monotonic() < deadline
                assert not shadow.done()
                time.sleep(0.05)
            outcome = graph.run(case, "realtime", folder / "graph", quiet, LOADED_S)
            assert (outcome.messages_lost, outcome.messages_refused) == (0, {})
            return [load(outcome.recording), load(shadow.result(PATIENCE_S + SECONDS).recording)]
        except BaseException:
            failed.set()
            raise


def test_controller_in_shadow_does_what_the_one_in_the_graph_does(
    start: Any, elsewhere: dict[str, str], streams: Any, tmp_path: Path, port: int
) -> None:
    """Over a link with random delays, by its own seed; and another program's client gets the same values."""
    sets = [f"duration={SECONDS}", "link=pdci", "measurement=p_class", "controllers.0.signals=[frequency]"]
    streamed, for_others = (
        start("c37118_server", run=RUN, set=json.dumps(sets), port=number, format=formats)
        for number, formats in ((port, "''"), (port + 1, FLOATS))
    )
    for server in (streamed, for_others):
        server.wait(lambda server=server: "serving" in server.texts()[0], PATIENCE_S)
    with (tmp_path / "theirs").open("w") as out:
        other = subprocess.Popen([sys.executable, "-u", "-c", THEIRS, str(port + 1)], stdout=out)
        try:
            file = streams(f"tcp://{HERE}:{port}/1")
            there, shadow = both(sets, tmp_path, file, elsewhere, lambda: clients(streamed) == clients(for_others) == 1)
        finally:
            other.kill()
            other.wait()
    n = min(len(there.issued), len(shadow.issued))  # a loaded machine may be behind when the plant ends
    assert n > 0.5 * len(there.ticks)
    ours, theirs = shadow.issued[:n], there.issued[:n]
    np.testing.assert_array_equal(shadow.ticks, there.ticks)
    np.testing.assert_array_equal(shadow.measured_ns, there.measured_ns)
    for name in ("tick", "controller", "device", "measured_ns", "issued_ns"):
        np.testing.assert_array_equal(ours[name], theirs[name])
    limit = np.abs(theirs["value"]).max()
    assert limit > 0.05
    assert np.abs(ours["value"] - theirs["value"]).max() < 1e-4 * limit
    seen = grid_pmus(load_case(RUN, []))
    for k in (1, 100, len(there.ticks) - 1):  # the values of floats of 32 bits
        sent, came = (system_pmus.to_data(seen, record.frames[k], record.status[k]) for record in (there, shadow))
        np.testing.assert_allclose(came.phasors, sent.phasors, rtol=1e-7, atol=1e-7)
        np.testing.assert_allclose(came.analogs, sent.analogs, rtol=1e-7)
        np.testing.assert_allclose(came.frequency, sent.frequency, rtol=1e-7)
    lines = (tmp_path / "theirs").read_text().splitlines()
    frames_read = [json.loads(line) for line in lines if line.startswith("{")]
    print(f"synchrophasor's client got {len(frames_read)} of {len(there.ticks) - 1} frames")
    assert len(frames_read) > 60
    phasors_told = np.stack(
        [
            system_pmus.to_data(seen, *frame_and_status).phasors
            for frame_and_status in zip(there.frames, there.status, strict=True)
        ]
    )
    phasors = np.array(
        [[p for pmu in frame_read["measurements"] for p in pmu["phasors"]] for frame_read in frames_read]
    )
    first = int(np.nanargmin(np.abs(phasors_told - phasors[0]).max(axis=(1, 2))))
    frames = first + np.rint(
        (np.array([frame_read["time"] for frame_read in frames_read]) - frames_read[0]["time"]) * 60
    ).astype(int)
    np.testing.assert_allclose(phasors, phasors_told[frames].astype(np.float32), rtol=1e-6)


def test_udp_streams_of_single_stations_give_the_frames_of_the_link(
    start: Any, elsewhere: dict[str, str], streams: Any, tmp_path: Path, port: int
) -> None:
    """Five streams, put together again by their stamps: each PMU's frames as the link delivered them."""
    low = min(port, 60000)
    sets = ["duration=2.5", "link=pdci"]
    server = start("c37118_server", run=RUN, set=json.dumps(sets), port=low, behind=0, each="true", idcode=20)
    server.wait(lambda: server.texts()[0].count("serving") == 5, PATIENCE_S)
    file = streams(*(f"udp://{HERE}:{low + i}/{20 + i}" for i in range(5)))
    asked = re.compile(r"IDCODE (\d+): 0 frames, 1 clients")
    there, shadow = both(sets, tmp_path, file, elsewhere, lambda: len(set(asked.findall(server.texts()[0]))) == 5)
    first = int(there.delivered["measured_ns"].min())
    count = 0
    for row in there.delivered:
        k = round((row["measured_ns"] - first) * 60 / NANOSECONDS)
        if k < len(shadow.ticks) and shadow.measured_ns[k, row["pmu"]] != NEVER:
            np.testing.assert_allclose(shadow.frames[k, row["pmu"]], row["values"], rtol=1e-6, atol=1e-9)
            count += 1
    assert count > 0.9 * len(there.delivered)


class Played:
    """A server of a run, in this process, at its own pace from when somebody listens."""

    def __init__(self, port: int, epoch_s: int) -> None:
        case, asked = load_case(RUN, ["duration=8"]), Serving(HERE, port, [], 1, None, each=False)
        self.servers = serving.servers(case, asked, lambda: (epoch_s, 0))
        timed = recorded.instants(loop.run(case), Pdc(case, epoch_s))
        self.beside = AsyncioThread()
        self.beside.wait(serving.begin(self.servers, asked))
        self.beside.begin(recorded.play(self.servers, timed, each=False))

    def end(self) -> None:
        for server in self.servers:
            self.beside.wait(server.end())
        self.beside.close()


@pytest.fixture
def serve(port: int) -> Iterator[Callable[[int], Played]]:
    """Serves a run until the end of the test."""
    begun: list[Played] = []

    def begin(epoch_s: int) -> Played:
        begun.append(Played(port, epoch_s))
        return begun[-1]

    yield begin
    for played in begun[-1:]:
        played.end()


def test_server_that_leaves_and_comes_back(domain: int, serve: Any, tmp_path: Path, port: int) -> None:
    """Ticks go on without frames, then with those of the new server, whose stamps are of another time."""
    first = serve(1_700_000_000)

    def restart() -> None:
        wait_until(lambda: first.servers[0].counts.frames >= 60)
        first.end()
        time.sleep(1.5)
        serve(1_000_000_000)

    with ThreadPoolExecutor(1) as beside:
        restarted = beside.submit(restart)
        words = ["--run", "two_area_supervised", "--set", "duration=7", "--timeout", str(LOADED_S)]
        files = ["--out", str(tmp_path / "out"), "--json", str(tmp_path / "result.json")]
        status = main(["pmu-listen", f"tcp://{HERE}:{port}", *words, *files])
        restarted.result()
    assert status in (0, 3)  # 3: a loaded machine was behind when the run ended
    record, result = load(tmp_path / "out" / "recording"), json.loads((tmp_path / "result.json").read_text())
    there = record.measured_ns[:, 0] != NEVER
    assert there[0]
    gone = np.flatnonzero(~there)
    assert len(gone) > 30
    assert there[gone[0] :].sum() > 30  # it came back
    assert result["pmus"]["G1"] == {"frames": int(there.sum()), "absent": int((~there).sum())}
    assert set(record.supervision["state"].tolist()) == {SHADOW}
    assert np.isnan(record.machines["speed_deviation"]).all()


def test_flood_of_stream_data_does_not_stop_the_ticks() -> None:
    """What has come is taken in parts, so that one that sends faster than it is taken never holds the node."""
    received: SimpleQueue[Any] = SimpleQueue()
    for k in range(1000):
        received.put((0, 0.0, k))
    sources = MagicMock(take=MagicMock(return_value=""))
    sources.following.left_s.return_value = 0.0
    C37118Client.receive(SimpleNamespace(received=received, sources=sources))  # type: ignore[arg-type]
    assert 0 < sources.take.call_count < 1000


@pytest.mark.parametrize(
    ("sets", "file", "expected"),
    [
        (["frame_rate=30"], {}, "DATA_RATE: 60 frames/s given; allowed: 30, the run's frame_rate"),
        ([], {"pmus": {"G1": {"voltage": "VA"}}}, "PMU G1: voltage: 'VA' given; allowed: what PMU G1 sends: V1"),
    ],
)
def test_stream_that_does_not_fit_is_said(
    domain: int,
    serve: Any,
    tmp_path: Path,
    port: int,
    sets: list[str],
    file: dict[str, Any],
    expected: str,
    capsys: Any,
) -> None:
    serve(1_700_000_000)
    path = tmp_path / "streams.yaml"
    path.write_text(json.dumps({"servers": [f"tcp://{HERE}:{port}"], **file}))
    words = [word for text in sets for word in ("--set", text)]
    assert_one_line(
        1, ["pmu-listen", str(path), "--run", RUN, *words, "--out", str(tmp_path / "out")], expected, capsys
    )
