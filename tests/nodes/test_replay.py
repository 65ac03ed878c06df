"""Recordings of graphs: replayed in process and by nodes, copied as other recorders write them, read by others."""

from __future__ import annotations

import json
import os
import signal
import sqlite3
import time
from collections import Counter
from dataclasses import replace
from itertools import chain, repeat
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from facts_damping_msgs.msg import PmuDataFrame, RunState
from mcap.reader import make_reader
from rclpy.serialization import deserialize_message
from rosbags.highlevel import AnyReader

from facts_damping.case.loading import load_case
from facts_damping.cli.main import main
from facts_damping.digest import digest
from facts_damping.errors import RecordingError, RunError
from facts_damping.nodes.base.qos import PUBLISHER_QOS
from facts_damping.nodes.controller import ControllerNode
from facts_damping.nodes.launching import graph
from facts_damping.nodes.launching.starting import Parts
from facts_damping.recording import RecordingWriter
from facts_damping.recording.reader import KINDS, UNTIMED, load
from facts_damping.recording.scan import scan
from facts_damping.simulation.replaying import replay
from facts_damping_testing.loopback.opening import opened
from tests.nodes.bags import STORAGES, copy, in_chunks
from tests.nodes.graphs import (
    ARRAYS,
    LOADED_S,
    PATIENCE_S,
    SILENCE_S,
    nodes_left,
    payloads,
    quiet,
    somebody,
    wait_until,
)

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    Chunks = list[list[tuple[str, int]]]  # topic and tick of what is in each

SETS = [
    *("duration=2", "scenario=large", "controllers.0.link=plc", "controllers.1.link=fibre"),
    *("controllers.0.name=HBsWC", "controllers.0.scheme=indirect", "controllers.0.parameters={}"),
]
SILENT = "controller_1_HBsWC"
LEAD_LAG = ["duration=1.5", "link=delay_100ms"]
# Topics that have a message each tick.
OF_A_TICK = tuple(suffix for kind, (_, suffix) in KINDS.items() if kind not in UNTIMED)
BY_NODES = ["--nodes", "--timeout", str(LOADED_S)]
CENTRALISED = [
    *("controllers.0.name=ANFTSC", "controllers.0.scheme=indirect", "controllers.0.parameters={}", "duration=1.5"),
]


@pytest.fixture(scope="module")
def graphs(tmp_path_factory: Any) -> dict[str, Path]:
    """Recordings of graphs: several controllers, own links, namespaces; one network for all; a lead-lag."""
    folder = tmp_path_factory.mktemp("graphs")
    runs = {"decentralised": SETS, "centralised": CENTRALISED, "large": LEAD_LAG}
    for name, sets in runs.items():
        case = load_case(f"two_area_{name}", [*sets, "scenario=large"])
        with opened():
            graph.run(case, "lockstep", folder / name, quiet, LOADED_S)
    return {name: folder / name / "recording" for name in runs}


@pytest.fixture(scope="module")
def in_order(graphs: dict[str, Path], tmp_path_factory: Any) -> tuple[Path, Chunks]:
    """The first of these in chunks of known content: the first messages one by one, the others across ticks."""
    folder = tmp_path_factory.mktemp("ordered") / "recording"
    return folder, in_chunks(graphs["decentralised"], folder, chain(repeat(1, 15), repeat(311)))


def called(capsys: Any, *arguments: str) -> tuple[int, str, str]:
    status = main([str(argument) for argument in arguments])
    return status, *capsys.readouterr()


@pytest.mark.parametrize("name", ["decentralised", "centralised"])
def test_in_process_it_is_identical_and_says_so(graphs: dict[str, Path], capsys: Any, name: str) -> None:
    status, out, errors = called(capsys, "replay", str(graphs[name]))
    record = load(graphs[name])
    assert np.count_nonzero(record.issued["value"]) > 30
    assert (status, errors) == (0, "")
    counted = f"{len(record.time_ns)} ticks, {len(record.issued)} setpoints, {len(record.estimates)} estimates"
    assert out == f"{counted}: identical, bit for bit\nexact: digest {digest(record)}\n"


@pytest.mark.parametrize(("name", "place"), [("decentralised", "loopback"), ("centralised", "domain")])
def test_nodes_in_lockstep_give_the_whole_recording_again(
    request: Any, graphs: dict[str, Path], tmp_path: Path, capsys: Any, name: str, place: str
) -> None:
    request.getfixturevalue(place)
    status, out, errors = called(capsys, "replay", str(graphs[name]), *BY_NODES, "--out", str(tmp_path / "out"))
    assert (status, errors) == (0, "")
    assert "identical, bit for bit" in out
    first, second = load(graphs[name]), load(tmp_path / "out" / "recording")
    for array in ARRAYS:
        assert getattr(first, array).tobytes() == getattr(second, array).tobytes(), array
    assert second.notes == []
    assert second.configuration == first.configuration
    states = [payloads(folder) for folder in (graphs[name].parent, tmp_path / "out")]
    run_states = [[deserialize_message(data, RunState) for data in topics.pop("/run/state")] for topics in states]
    assert run_states[0] == run_states[1]  # their bytes have padding that is not set
    for topic in [topic for topic in states[0] if topic.endswith(("/state", "/setpoints", "/estimate", "/delivered"))]:
        assert states[0][topic] == states[1][topic], topic
    assert nodes_left(tmp_path) == []


def test_shadow_is_the_same_by_nodes_and_in_process(
    loopback: Any, graphs: dict[str, Path], tmp_path: Path, capsys: Any
) -> None:
    other = ["--set", "controllers.0.name=ANFTSC", "--json", "-"]
    documents = []
    for more in ([], [*BY_NODES, "--out", str(tmp_path / "nodes")]):
        status, out, errors = called(capsys, "replay", str(graphs["decentralised"]), *other, *more)
        assert status == 0, errors
        documents.append(json.loads(out))
    assert documents[0]["identical"] is False
    assert documents[1].pop("replayed") == str(tmp_path / "nodes" / "recording")
    documents[0].pop("replayed")
    assert documents[0] == documents[1]
    assert (tmp_path / "nodes" / "setpoints.png").read_bytes().startswith(b"\x89PNG")
    by_nodes = load(tmp_path / "nodes" / "recording")
    record = load(graphs["decentralised"])
    case = replay.case_of(record, "it", None, ["controllers.0.name=ANFTSC"])
    issued, estimates, *_ = replay.play(case, replay.fitted(record, case))
    assert by_nodes.issued.tobytes() == issued.tobytes()
    assert by_nodes.estimates.tobytes() == estimates.tobytes()
    assert by_nodes.machines.tobytes() == record.machines.tobytes()


def test_other_setpoints_without_set_are_a_failure(
    graphs: dict[str, Path], tmp_path: Path, capsys: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    record = load(graphs["centralised"])
    changed = load(graphs["centralised"])
    changed.issued["value"][50] += 1e-9
    monkeypatch.setattr("facts_damping.recording.reader.load", lambda _path: changed)
    status, out, errors = called(capsys, "replay", "it")
    tick = record.issued["tick"][50]
    assert status == 1
    assert f"different from tick {tick} on" in out
    assert errors.startswith(
        f"facts-damping: setpoints differ from those recorded, from tick {tick}: controller_0_ANFTSC"
    )
    assert errors.count("\n") == 1


def test_silent_controller_is_named(
    loopback: Any, graphs: dict[str, Path], tmp_path: Path, started: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    act = ControllerNode.act

    def act_or_stop(self: ControllerNode, tick: int, *positional: Any) -> None:
        if (self.name, tick) == (SILENT, 50):
            os.kill(started[f"substation/{SILENT}"].process.pid, signal.SIGSTOP)
            time.sleep(0.0)  # stops here
        act(self, tick, *positional)

    monkeypatch.setattr(ControllerNode, "act", act_or_stop)
    record = load(graphs["decentralised"])
    case = replay.case_of(record, "it", None, [])
    with pytest.raises(RunError, match=f"^replay_source: substation/{SILENT} is silent: no answer to tick 50 within"):
        graph.run(case, "lockstep", tmp_path / "out", quiet, SILENCE_S, parts=Parts(replayed=graphs["decentralised"]))


@pytest.mark.parametrize("storage", STORAGES)
def test_bags_of_other_recorders_are_replayed(
    graphs: dict[str, Path], tmp_path: Path, capsys: Any, storage: str
) -> None:
    bag = copy(graphs["decentralised"], tmp_path / "bag", storage)
    run = str(graphs["decentralised"].parent / "run.yaml")
    status, _, errors = called(capsys, "replay", str(bag))
    assert status == 2
    assert "holds no run; allowed: --run" in errors
    assert errors.count("\n") == 1
    status, out, _ = called(capsys, "replay", str(bag), "--run", run)
    assert (status, "identical, bit for bit" in out) == (0, True)
    first, second = load(graphs["decentralised"]), load(bag)
    for array in ARRAYS:
        assert getattr(first, array).tobytes() == getattr(second, array).tobytes(), array


def count_before(chunks: Chunks, tick: int) -> int:
    return sum(at < tick for chunk in chunks for _, at in chunk)


def test_recorder_that_came_late_is_said(
    graphs: dict[str, Path], in_order: tuple[Path, Chunks], tmp_path: Path, capsys: Any
) -> None:
    folder, chunks = in_order
    bag = copy(folder, tmp_path / "bag", "mcap", late=count_before(chunks, 90))  # at 1.5 s; the fault is at 1 s
    run = str(graphs["decentralised"].parent / "run.yaml")
    status, _, errors = called(capsys, "replay", str(bag), "--run", run)
    assert status == 1  # the network had learnt before
    assert "the recording begins with tick 90" in errors
    status, _, errors = called(capsys, "replay", str(bag), "--run", run, "--nodes", "--out", str(tmp_path / "out"))
    assert status == 2
    assert "--nodes: a recording from tick 90" in errors


def test_recorder_may_come_between_the_messages_of_a_tick(in_order: tuple[Path, Chunks], tmp_path: Path) -> None:
    folder, chunks = in_order
    began, end = count_before(chunks, 90), count_before(chunks, 96)
    whole = load(copy(folder, tmp_path / "whole", "mcap", end=end))
    for late in range(began, count_before(chunks, 91) + 1):
        cut = load(copy(folder, tmp_path / str(late), "mcap", late, end))
        first = 90 if late == began else 91
        assert (int(cut.ticks[0]), cut.gap_tick) == (first, None)
        for array in ("frames", "machines", "devices"):
            assert getattr(cut, array).tobytes() == getattr(whole, array)[first:].tobytes(), array
        for array in ("delivered", "issued", "estimates"):
            rows = getattr(whole, array)
            assert getattr(cut, array).tobytes() == rows[rows["tick"] >= first].tobytes(), array


def test_recordings_cut_short_are_replayed_as_far_as_they_go(
    in_order: tuple[Path, Chunks], tmp_path: Path, capsys: Any
) -> None:
    """At every border of chunks, and within those of several messages: up to the last tick that all topics have.

    The first ticks, when no link has delivered anything yet, are replayed as well. Where not even the first is whole,
    it is said which topics have no message, and that the recording is cut.
    """
    folder, chunks = in_order
    file = next(folder.glob("*.mcap"))
    data, cut = file.read_bytes(), tmp_path / "cut.mcap"
    with file.open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None
    topics = {topic for chunk in chunks for topic, tick in chunk if tick >= 0}
    needed = {topic for topic in topics if topic.endswith(OF_A_TICK) and topic != "/run/state"}
    assert len(needed) == 12
    left: Counter[str] = Counter()
    seen = []
    for index, chunk in zip(summary.chunk_indexes, chunks, strict=True):
        ticks = min(left[topic] for topic in needed)
        border, within = index.chunk_start_offset, index.chunk_start_offset + index.chunk_length // 2
        for length in (border, within) if len(chunk) > 1 else (border,):
            cut.write_bytes(data[:length])
            status, out, errors = called(capsys, "replay", str(cut))
            assert f"cut.mcap: cut or damaged at byte {border} of {length}" in errors
            if ticks:
                assert (status, out.startswith(f"{ticks} ticks, ")) == (0, True), (out, errors)
                assert ": identical, bit for bit\nexact: digest " in out
                assert f"the end is missing: the record ends with tick {ticks - 1} at " in errors
                continue
            assert (status, errors.count("\n")) == (2, 1)
            if left:
                reason, _, silent = errors.partition(";")[0].partition(": no message of ")
                assert reason.endswith("cut.mcap: no tick is complete in the recording")
                assert set(silent.split(", ")) == {topic for topic in needed if not left[topic]}
            else:
                assert "cut.mcap holds no message" in errors
        left.update(topic for topic, _ in chunk)
        seen.append(ticks)
    assert seen == sorted(seen)
    assert {0, 1} < set(seen)
    assert seen[-1] > 100


def test_message_that_is_missing_ends_the_replay_there_whatever_it_is(
    loopback: Any, tmp_path: Path, capsys: Any
) -> None:
    case = load_case("two_area_supervised", ["duration=2", "controllers.0.name=HBsWC", "controllers.0.scheme=indirect"])
    content = scan(graph.run(case, "lockstep", tmp_path / "whole", quiet, LOADED_S).recording)
    count, ended = Counter(message.topic for message in content.messages), 0
    for topic in (name for name in content.topics if count[name] == case.ticks):
        turn, out = iter(range(case.ticks)), tmp_path / topic.replace("/", "_")
        with RecordingWriter(out, content.configuration, content.versions) as writer:
            for known in content.topics.values():
                writer.copy_topic(known)
            for raw_message in content.messages:
                if raw_message.topic != topic or next(turn) != 60:
                    writer.write(
                        raw_message.topic,
                        raw_message.data,
                        raw_message.log_ns,
                        raw_message.publish_ns,
                        raw_message.sequence,
                    )
        capsys.readouterr()
        assert main(["replay", str(out)]) == 0, topic
        output, errors = capsys.readouterr()
        assert "identical, bit for bit" in output
        ended += "replayed up to tick 59 at 0.983 s: tick 60 is incomplete" in errors
    assert ended >= 10


def test_database_that_is_cut_is_read_up_to_there_or_refused(
    graphs: dict[str, Path], in_order: tuple[Path, Chunks], tmp_path: Path
) -> None:
    bag = copy(in_order[0], tmp_path / "bag", "sqlite3")
    (file,) = bag.glob("*.db3")
    data = file.read_bytes()
    run, whole = str(graphs["decentralised"].parent / "run.yaml"), load(bag)
    for fraction in np.linspace(0.0, 1.0, 24, endpoint=False):
        cut = tmp_path / "cut.db3"
        cut.write_bytes(data[: int(fraction * len(data))])
        status = main(["replay", str(cut), "--run", run])
        assert status in (0, 2)
        if status == 0:
            part = load(cut)
            assert part.notes
            assert part.issued.tobytes() == whole.issued[: len(part.issued)].tobytes()


def test_messages_of_a_database_out_of_order(graphs: dict[str, Path], tmp_path: Path) -> None:
    bag = copy(graphs["decentralised"], tmp_path / "bag", "sqlite3")
    whole, (file,) = load(bag), bag.glob("*.db3")
    with sqlite3.connect(file) as base:
        base.execute("UPDATE messages SET timestamp = 1000000000 - id")
    base.close()
    turned = load(bag)
    for array in ARRAYS:
        assert getattr(turned, array).tobytes() == getattr(whole, array).tobytes(), array


def test_tools_of_others_read_every_message_without_a_warning(graphs: dict[str, Path], capfd: Any, caplog: Any) -> None:
    """Warnings are errors in all tests; besides, nothing is printed or logged."""
    kinds: set[str] = set()
    for folder in graphs.values():
        with AnyReader([folder]) as reader:
            for connection, _, data in reader.messages():
                reader.deserialize(data, connection.msgtype)
                kinds.add(connection.msgtype)
            counts = {connection.topic: connection.msgcount for connection in reader.connections}
            total = reader.message_count
        with next(folder.glob("*.mcap")).open("rb") as stream:
            mcap = make_reader(stream, validate_crcs=True)
            topics = [channel.topic for _, channel, _ in mcap.iter_messages()]
            attachments = [attachment.name for attachment in mcap.iter_attachments()]
            metadata = [metadatum.name for metadatum in mcap.iter_metadata()]
        assert attachments == ["run.yaml"]
        assert metadata == ["facts_damping.versions", "facts_damping.lost", "facts_damping.publishers", "rosbag2"]
        assert len(topics) == total > 500
        assert {topic: topics.count(topic) for topic in counts} == counts
    assert {kind.split("/")[-1] for kind in kinds} == {
        *("PmuDataFrame", "DeviceSetpoints", "PlantState", "GridEvent", "ControllerState", "JacobianEstimate"),
        *("LinkStatistics", "DiagnosticArray", "RunState"),
    }
    assert capfd.readouterr() == ("", "")
    assert caplog.records == []


@pytest.mark.parametrize(
    ("name", "nodes"),
    [("large", ["controller_0_LLC"]), ("centralised", ["controller_0_ANFTSC", "identifier_0_ANFTSI"])],
)
def test_player_at_recorded_times_drives_the_nodes(
    loopback: Any, graphs: dict[str, Path], tmp_path: Path, start: Any, name: str, nodes: list[str]
) -> None:
    """What `ros2 bag play --topics /pmu/delivered` does: bytes as recorded, paced by the times of reception."""
    folder = graphs[name]
    run, topic = str(folder.parent / "run.yaml"), "/pmu/delivered"
    recorder = start("recorder", run=run, output=str(tmp_path / "new"))
    for node in nodes:
        # Each waits for the recorder to hear it: a controller has the recorder in the place of its link.
        options = {"run": run, "mode": "realtime", "start_timeout": PATIENCE_S}
        start(node.split("_")[0], "-r", f"__node:={node}", recorder=node.startswith("identifier"), **options)
    with AnyReader([folder]) as reader:
        chosen = [connection for connection in reader.connections if connection.topic == topic]
        messages = [(log_ns, data) for _, log_ns, data in reader.messages(chosen)]
    before = payloads(folder.parent)
    topics = [topic_name for topic_name in before if topic_name.endswith(("/estimate", f"{nodes[0]}/setpoints"))]
    assert len(topics) == len(nodes)
    _play(topic, messages, 1 + len(nodes), lambda: _wait_for(tmp_path / "new", dict.fromkeys(topics, len(messages))))
    recorder.stop(signal.SIGINT)
    played = payloads(tmp_path, name="new")
    assert [len(played[topic_name]) for topic_name in topics] == [len(messages)] * len(nodes)
    if name == "large":
        assert np.any(load(folder).issued["value"] != 0.0)
        assert played[topics[0]] == before[topics[0]]
    # With an identifier an estimate may come too late for the next tick: then its controller takes it a tick later.


def _play(topic: str, messages: list[tuple[int, bytes]], listeners: int, then: Callable[[], None]) -> None:
    """Publish messages at their times, once all listen; then wait."""
    with somebody("player") as (node, _):
        publisher = node.create_publisher(PmuDataFrame, topic, PUBLISHER_QOS)
        wait_until(lambda: publisher.get_subscription_count() >= listeners)
        began = time.monotonic()
        for log_ns, data in messages:
            time.sleep(max(0.0, began + (log_ns - messages[0][0]) * 1e-9 - time.monotonic()))
            publisher.publish(data)
        then()


def _wait_for(folder: Path, counts: dict[str, int]) -> None:
    """Wait until a growing recording has so many messages of each topic."""

    def complete() -> bool:
        try:
            topics = Counter(message.topic for message in scan(folder).messages)
        except RecordingError:
            return False
        return all(topics[topic] >= count for topic, count in counts.items())

    wait_until(complete, meanwhile=lambda: time.sleep(0.2))


SLOW = '''
import time


class Slow:
    """Every twentieth step takes longer than two frames."""

    def __init__(self, spec):
        self.steps = 0

    def step(self, t_s, y, age_s, fresh):
        self.steps += 1
        if self.steps % 20 == 0:
            time.sleep(0.04)
        return [2.0 * y[0]]
'''


@pytest.mark.parametrize("controller", ["indirect", "late"])
def test_supervised_run_by_the_clock_is_replayed_to_the_bit(controller: str, tmp_path: Path, capsys: Any) -> None:
    """With an identifier; and with a controller that is late, so that deadlines are missed."""
    (tmp_path / "slow.py").write_text(SLOW)
    late = f"controllers=[{{name: slow, policy: {tmp_path / 'slow.py'}:Slow}}]"
    sets = {"indirect": ["controllers.0.name=HBsWC", "controllers.0.scheme=indirect"], "late": [late]}[controller]
    words = [word for setting in [*sets, "duration=4"] for word in ("--set", setting)]
    with opened():
        status = main(["run", "two_area_deployment", "--mode", "realtime", *words, "--out", str(tmp_path / "run")])
    misses = json.loads((tmp_path / "run" / "result.json").read_text())["deadline_misses"]
    assert (status, misses > 5) == (0, controller == "late")
    assert main(["replay", str(tmp_path / "run" / "recording"), "--policy"]) == 0
    assert "identical, bit for bit" in capsys.readouterr().out
    record = load(tmp_path / "run" / "recording")
    rows = record.latest["supervisor", 0, "controller 0"]
    assert np.any(rows[:, 1] < rows[:, 0]) == (controller == "late")
    without = replace(record, latest={})
    case = replay.case_of(without, "it", None, [], policy=True)
    difference = replay.first_supervised(without, replay.play(case, replay.fitted(without, case)))
    assert (difference is None) == (controller == "indirect")  # a late one needs the ticks of its inputs
