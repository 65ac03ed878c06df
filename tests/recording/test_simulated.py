"""A copy by simulated time: the same record, each message logged at its stamp."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pytest

from facts_damping.errors import RecordingError
from facts_damping.record import GridEvent
from facts_damping.recording import RecordingWriter, in_simulated_time, load
from facts_damping.recording.decode import decode, time_ns
from facts_damping.recording.scan import scan
from tests.nodes.graphs import assert_same

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path


def test_copy_has_the_same_record_by_the_stamps(
    tmp_path: Path, random_record: Callable[..., Any], write_record: Callable[..., None]
) -> None:
    write_record(random_record(1), tmp_path / "a")
    assert in_simulated_time(tmp_path / "a", tmp_path / "b") == []
    assert_same(load(tmp_path / "b"), load(tmp_path / "a"))
    copied, before = scan(tmp_path / "b"), scan(tmp_path / "a")
    assert copied.versions == before.versions
    assert sorted(raw_message.data for raw_message in copied.messages) == sorted(
        raw_message.data for raw_message in before.messages
    )
    for message in copied.messages:
        (block,) = decode(copied.topics[message.topic], [message.data], [])
        assert message.log_ns == message.publish_ns == time_ns(block.message.header.stamp)[0]
    times = [message.log_ns for message in copied.messages]
    assert times == sorted(times)
    assert times[-1] > 0


def test_stamp_before_the_start_counts_as_the_start(tmp_path: Path, messages: Any) -> None:
    with RecordingWriter(tmp_path / "a") as writer:
        writer.add_topic("/plant/events", "facts_damping_msgs/msg/GridEvent")
        event = GridEvent(-1, "fault", "a", 0.0, 0.0)
        writer.write("/plant/events", messages.cdr(messages.event(event)), 5, 5)
    in_simulated_time(tmp_path / "a", tmp_path / "b")
    assert [message.log_ns for message in scan(tmp_path / "b").messages] == [0]


@pytest.mark.parametrize(
    ("message_type", "data", "said"),
    [
        ("facts_damping_msgs/msg/MachineState", bytes(100), "/x is left out: facts_damping_msgs/msg/MachineState has"),
        ("facts_damping_msgs/msg/GridEvent", bytes(5), "/x: 1 messages that are cut are left out"),
    ],
)
def test_messages_without_a_stamp_are_left_out(
    tmp_path: Path, messages: Any, message_type: str, data: bytes, said: str
) -> None:
    for folder in ("a", "c"):
        with RecordingWriter(tmp_path / folder) as writer:
            writer.add_topic("/x", message_type)
            writer.write("/x", data, 1, 1)
            if folder == "c":
                event = GridEvent(7, "fault", "a", 0.0, 0.0)
                writer.add_topic("/plant/events", "facts_damping_msgs/msg/GridEvent")
                writer.write("/plant/events", messages.cdr(messages.event(event)), 5, 5)
    with pytest.raises(RecordingError, match=f"holds no message with a stamp; {said}"):
        in_simulated_time(tmp_path / "a", tmp_path / "b")
    assert not (tmp_path / "b").exists()
    (note,) = in_simulated_time(tmp_path / "c", tmp_path / "b")
    assert note.startswith(said)
    assert [message.log_ns for message in scan(tmp_path / "b").messages] == [7]
