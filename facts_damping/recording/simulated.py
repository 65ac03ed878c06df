"""A copy of a recording by simulated time, for viewers: they draw over the time at which a message was logged."""

from __future__ import annotations

import struct
from typing import TYPE_CHECKING

from facts_damping.errors import RecordingError
from facts_damping.recording.recover import copy
from facts_damping.recording.scan import scan
from facts_damping.recording.schemas import parse_schema
from facts_damping.signals import NANOSECONDS

if TYPE_CHECKING:
    from pathlib import Path

    from facts_damping.recording.bagfile import TopicInfo
    from facts_damping.recording.content import RawMessage


def in_simulated_time(path: Path | str, out: Path | str) -> list[str]:
    """Copy a recording; log and publish time of each message become its header's stamp, in this order.

    In lockstep the clock says when a tick was computed, not when it is. A stamp before 0 counts as 0. `path`, `out`,
    notes and errors as in `recover`; RecordingError too for messages without a header.
    """
    content = scan(path)
    for topic in content.topics.values():
        _check_header(topic)
    messages = [
        message._replace(log_ns=stamp, publish_ns=stamp) for message in content.messages for stamp in [_stamp(message)]
    ]
    content.messages = sorted(messages, key=lambda message: message.log_ns)
    return copy(content, out)


def _check_header(topic: TopicInfo) -> None:
    """Refuse a topic whose messages do not begin with a header."""
    _, fields = parse_schema(topic.message_type, topic.schema)[topic.message_type]
    if not fields or fields[0][1][1] != "std_msgs/msg/Header":
        raise RecordingError(f"{topic.name}: {topic.message_type} has no header, so no simulated time")


def _stamp(message: RawMessage) -> int:
    """Time in the header of a message, ns."""
    try:
        return stamp_ns(message.data)
    except (IndexError, struct.error) as error:
        raise RecordingError(f"{message.topic}: a message is cut") from error


def stamp_ns(cdr: bytes) -> int:
    """Time in the header that a message begins with, ns; 0 if it is before 0.

    It is the first eight bytes after the encapsulation, whose second byte tells their order.
    """
    sec, nanosec = struct.unpack_from("<iI" if cdr[1] & 1 else ">iI", cdr, 4)
    return max(0, int(sec) * NANOSECONDS + int(nanosec))
