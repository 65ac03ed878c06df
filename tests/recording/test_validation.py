"""Foreign and odd messages in a recording, as `ros2 bag record` keeps them: set aside and told, the rest is read."""

from __future__ import annotations

import dataclasses
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from facts_damping.record import NodeJoined
from facts_damping.recording import RecordingWriter, events, load
from facts_damping.recording.columns import Block
from facts_damping.recording.scan import scan
from facts_damping.signals import CHANNELS, NANOSECONDS, SETPOINT
from tests.nodes.graphs import assert_same
from tests.recording.test_fields import with_estimates

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from facts_damping.record import Record

RATE = 60


@pytest.fixture
def record(random_record: Callable[..., Record]) -> Record:
    return random_record(31)


@pytest.fixture
def into(tmp_path: Path, record: Record, written: Any) -> Callable[[str, bytes], Record]:
    """The recording with one message more, the last or the first of its topic, read."""

    def insert(topic: str, data: bytes, first: bool = False) -> Record:
        written(record, tmp_path / "own")
        content = scan(tmp_path / "own")
        with RecordingWriter(tmp_path / "mixed", content.configuration, content.versions) as writer:
            for topic_info in content.topics.values():
                writer.copy_topic(topic_info)
            for _ in range(first):
                writer.write(topic, data, 1, 1)
            for message in content.messages:
                writer.write(message.topic, message.data, message.log_ns, message.publish_ns, message.sequence)
            for _ in range(not first):
                writer.write(topic, data, 1, 1)
        return load(tmp_path / "mixed")

    return insert


def stamp(tick: int) -> int:
    return tick * NANOSECONDS // RATE


def named(record: Record, field: str) -> Record:
    """The record with other names."""
    others: Any = {field: [f"{name}_of_others" for name in getattr(record, field)]}
    return dataclasses.replace(record, **others)


def rows(device: int = 0) -> Any:
    setpoints = np.zeros(1, SETPOINT)
    setpoints["device"] = device
    return setpoints


@pytest.mark.parametrize("first", [False, True])
@pytest.mark.parametrize(
    ("topic", "make", "said"),
    [
        ("/plant/state", lambda _m, _r: b"\x00\x01\x00\x00\x07", "that are no facts_damping_msgs/msg/PlantState"),
        ("/pmu/frames", lambda _m, _r: bytes(range(200)), "that are no facts_damping_msgs/msg/PmuDataFrame"),
        ("/pmu/frames", lambda m, _: m.cdr(m.frames(stamp(10**9), 10**9, [])), "of ticks outside the run"),
        (
            "/pmu/delivered",
            lambda m, _: m.cdr(m.frames(2**30 * NANOSECONDS, 7, [])),
            "with the stamp of another",
        ),
        ("/setpoints/delivered", lambda m, r: m.cdr(m.setpoints(r, 0, 2**64 - 1, "", [])), "of ticks outside the run"),
        (
            "/setpoints/delivered",
            lambda m, r: m.cdr(m.setpoints(named(r, "device_names"), stamp(3), 3, "", rows())),
            "with the unknown name 'sssc_of_others'",
        ),
        (
            "/controller_2_A/setpoints",
            lambda m, r: m.cdr(m.setpoints(named(r, "controller_names"), stamp(3), 3, "controller_2_A", rows())),
            "with the unknown name 'controller_2_A_of_ot'",
        ),
        (
            "/pmu/delivered",
            lambda m, _: m.cdr(m.frames(stamp(3), 3, [m.frame("x" * 99, 3, 0, 0, np.zeros(len(CHANNELS)), 0)])),
            "with the unknown name 'xxxxxxxxxxxxxxxxxxxx'",
        ),
    ],
)
def test_foreign_message_is_set_aside(
    into: Any, record: Record, messages: Any, topic: str, make: Callable[[Any, Record], bytes], said: str, first: bool
) -> None:
    loaded = into(topic, make(messages, record), first)
    (note,) = loaded.notes
    assert note.startswith(f"{topic}: 1 messages {said}")
    assert note.endswith(" are left out")
    assert_same(dataclasses.replace(loaded, notes=[]), record)


def test_several_setpoints_of_a_tick_are_all_kept(into: Any, record: Record, messages: Any) -> None:
    """What a second publisher said acted, too: `analyze` and `load` show it."""
    more = rows(1)
    more["value"], more["tick"] = 0.1, 4
    loaded = into("/setpoints/delivered", messages.cdr(messages.setpoints(record, stamp(4), 4, "", more)))
    assert loaded.notes == ["/setpoints/delivered: 1 messages repeat a tick: all are kept"]
    at = loaded.applied[loaded.applied["tick"] == 4]
    assert at[-1].tobytes() == more[0].tobytes()
    assert len(loaded.applied) == len(record.applied) + 1
    assert loaded.frames.tobytes() == record.frames.tobytes()


def test_of_several_frames_of_a_tick_the_first_counts(into: Any, record: Record, messages: Any) -> None:
    loaded = into("/pmu/frames", messages.cdr(messages.frames(stamp(4), 4, [])))
    assert loaded.notes == ["/pmu/frames: 1 messages repeat a tick: the first counts"]
    assert loaded.frames.tobytes() == record.frames.tobytes()


@pytest.mark.parametrize("topic", ["/diagnostics", "/robot/diagnostics"])
def test_diagnostics_of_others_do_no_harm(tmp_path: Path, record: Record, written: Any, topic: str) -> None:
    """Several topics of them, foreign texts in them, and types that only sound like it."""
    for folder, kind in (("a", "diagnostic_msgs/msg/DiagnosticArray"), ("b", "std_msgs/msg/String")):
        written(record, tmp_path / folder, more={topic: kind, "/other/diagnostics": kind})
        loaded = load(tmp_path / folder)
        assert loaded.frames.tobytes() == record.frames.tobytes()
        assert loaded.joined == []


def test_joins_are_read_and_odd_ones_are_not() -> None:
    def status(joined: str, armed: str) -> Any:
        values = [SimpleNamespace(key="joined_ns", value=joined), SimpleNamespace(key="armed_ns", value=armed)]
        return Block(np.arange(1), SimpleNamespace(status=[SimpleNamespace(name="/n", values=values)]))

    odd = [status("9" * 400, ""), status("x", ""), status("-5", ""), status("\u0663", "")]
    joins = events.joined(
        [*odd, status("2000000000", ""), status("2000000000", "3000000000"), status("1000000000", "9" * 99)]
    )
    assert joins == [
        NodeJoined("/n", 1.0, None),
        NodeJoined("/n", 2.0, 3.0),
    ]


def test_lists_that_do_not_fit_are_set_aside(tmp_path: Path, random_record: Any, written: Any) -> None:
    record = with_estimates(random_record(33))

    def shorter(topic: str, message: Any) -> Any:
        if topic.endswith("/estimate") and message.tick in (3, 4):
            message.jacobian = message.jacobian[:1]
        return message

    written(record, tmp_path / "run", change=shorter)
    loaded = load(tmp_path / "run")
    said = "2 messages with lists of a wrong length are left out"
    assert f"/identifier_2_X/estimate: {said}" in loaded.notes
    assert loaded.frames.tobytes() == record.frames.tobytes()
    assert len(loaded.estimates) == len(record.estimates) - 8


def test_flood_of_names_is_told_in_a_few_lines(tmp_path: Path, record: Record, messages: Any, written: Any) -> None:
    written(record, tmp_path / "own")
    content = scan(tmp_path / "own")
    with RecordingWriter(tmp_path / "mixed", content.configuration, content.versions) as writer:
        for topic_info in content.topics.values():
            writer.copy_topic(topic_info)
        for i in range(100):  # more than the controller's own
            data = messages.cdr(messages.setpoints(record, stamp(3), 3, f"forger_{i % 50}", rows()))
            writer.write("/controller_2_A/setpoints", data, 1, 1)
        for message in content.messages:
            writer.write(message.topic, message.data, message.log_ns, message.publish_ns, message.sequence)
    loaded = load(tmp_path / "mixed")
    assert_same(dataclasses.replace(loaded, notes=[]), record)
    assert len(loaded.notes) == 6
    assert loaded.notes[-1] == "/controller_2_A/setpoints: 90 messages with other unknown names are left out"
