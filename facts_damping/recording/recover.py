"""Makes a sound recording from a cut one."""

from __future__ import annotations

from typing import TYPE_CHECKING

from facts_damping.recording.scan import scan
from facts_damping.recording.schemas import type_hash
from facts_damping.recording.writer import RecordingWriter

if TYPE_CHECKING:
    from pathlib import Path

    from facts_damping.recording.bagfile import TopicInfo
    from facts_damping.recording.content import Content


def recover(path: Path | str, out: Path | str) -> list[str]:
    """Copy all that can be read of a recording into a new, sound one; `metadata.yaml` is written last.

    `path`: a folder or an `.mcap` file, cut, damaged or sound, with any topics of CDR messages; `out`: a new folder.
    Returns notes on the damage. Raises RecordingError if nothing can be read or written.
    """
    return copy(scan(path), out)


def copy(content: Content, out: Path | str) -> list[str]:
    """Write the content into a new recording; returns its notes."""
    notes = list(content.notes)
    with RecordingWriter(out, content.configuration, content.versions) as writer:
        for topic in content.topics.values():
            writer.copy_topic(_hashed(topic))
        for message in content.messages:
            writer.write(message.topic, message.data, message.log_ns, message.publish_ns, message.sequence)
        writer.close(content.lost, content.publishers)
    return notes


def _hashed(topic: TopicInfo) -> TopicInfo:
    """The topic with its type hash, which bags of other recorders may lack."""
    return topic if topic.type_hash else topic._replace(type_hash=type_hash(topic.message_type, topic.schema))
