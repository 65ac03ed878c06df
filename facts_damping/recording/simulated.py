"""Copies a recording to simulated time, for viewers that plot messages over their log time."""

from __future__ import annotations

import struct
from collections import Counter
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
    """Copy a recording; each message's log and publish time become its header's stamp, and messages are sorted by it.

    In lockstep the log time is when a tick was computed, not its simulated time. A stamp before 0 counts as 0. `path`,
    `out`, notes and errors as in `recover`; messages without a header are left out, with a note.
    """
    content = scan(path)
    for topic in list(content.topics.values()):
        if not _has_header(topic):
            content.notes.append(f"{topic.name} is left out: {topic.message_type} has no header, so no simulated time")
            del content.topics[topic.name]
    stamped = [(_stamp(message), message) for message in content.messages if message.topic in content.topics]
    cut = Counter(message.topic for stamp, message in stamped if stamp is None)
    content.notes += [f"{topic}: {count} messages that are cut are left out" for topic, count in cut.items()]
    messages = [one._replace(log_ns=stamp, publish_ns=stamp) for stamp, one in stamped if stamp is not None]
    if not messages:
        raise RecordingError(content.refusal(f"{path} holds no message with a stamp"))
    content.messages = sorted(messages, key=lambda message: message.log_ns)
    return copy(content, out)


def _has_header(topic: TopicInfo) -> bool:
    """Whether a topic's messages begin with a header."""
    try:
        _, fields = parse_schema(topic.message_type, topic.schema)[topic.message_type]
    except (KeyError, RecordingError):
        return False
    return bool(fields) and fields[0][1][1] == "std_msgs/msg/Header"


def _stamp(message: RawMessage) -> int | None:
    """Time in a message's header, ns; None if the message is cut."""
    try:
        return stamp_ns(message.data)
    except (IndexError, struct.error):
        return None


def stamp_ns(cdr: bytes) -> int:
    """Time in the header at the start of a message, ns; 0 if before 0.

    The stamp is the first eight bytes after the encapsulation, whose second byte gives the byte order.
    """
    sec, nanosec = struct.unpack_from("<iI" if cdr[1] & 1 else ">iI", cdr, 4)
    return max(0, int(sec) * NANOSECONDS + int(nanosec))
