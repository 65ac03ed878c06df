"""What becomes of a recording: sealed when new, made sound if it was cut, copied to simulated time for viewers."""

from __future__ import annotations

import json
import struct
from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING

from facts_damping.digest import digest
from facts_damping.errors import RecordingError
from facts_damping.output.writing import write_whole
from facts_damping.recording.bagfile import CUSTOM, DIGEST, FILE_NAME, INFORMATION, dump
from facts_damping.recording.columns import stamp_ns
from facts_damping.recording.reader import load
from facts_damping.recording.scan import metadata, scan
from facts_damping.recording.schemas import parse_schema, type_hash
from facts_damping.recording.writer import RecordingWriter

if TYPE_CHECKING:
    from facts_damping.record import Record
    from facts_damping.recording.bagfile import TopicInfo
    from facts_damping.recording.scan import Content, RawMessage


def seal(folder: Path | str) -> Record:
    """Record of a new recording; stores its digest in `metadata.yaml`, by which readers detect later changes.

    A recording that is not complete has no `metadata.yaml`. Raises RecordingError as `load` does.
    """
    record, file = load(folder), Path(folder) / FILE_NAME
    information = metadata(file)
    if information:
        information[CUSTOM] = {**information.get(CUSTOM, {}), DIGEST: json.dumps(digest(record))}
        write_whole(file, dump({INFORMATION: information}))
    return record


def recover(path: Path | str, out: Path | str) -> list[str]:
    """Copy all that can be read of a recording into a new, sound one; `metadata.yaml` is written last.

    `path`: a folder or an `.mcap` file, cut, damaged or sound, with any topics of CDR messages; `out`: a new folder.
    Returns notes on the damage. Raises RecordingError if nothing can be read or written.
    """
    return _copy(scan(path), out)


def _copy(content: Content, out: Path | str) -> list[str]:
    """Write the content into a new recording; returns its notes."""
    notes = list(content.notes)
    with RecordingWriter(out, content.configuration, content.versions) as writer:
        for topic in content.topics.values():
            known = topic.type_hash or type_hash(topic.message_type, topic.schema)  # other recorders may leave it out
            writer.copy_topic(topic._replace(type_hash=known))
        for message in content.messages:
            writer.write(message.topic, message.data, message.log_ns, message.publish_ns, message.sequence)
        writer.close(content.lost, content.publishers)
    return notes


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
    messages = [message._replace(log_ns=stamp, publish_ns=stamp) for stamp, message in stamped if stamp is not None]
    if not messages:
        raise RecordingError(content.refusal(f"{path} holds no message with a stamp"))
    content.messages = sorted(messages, key=lambda message: message.log_ns)
    return _copy(content, out)


def _has_header(topic: TopicInfo) -> bool:
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
