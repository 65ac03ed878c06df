"""Copies of recordings: as `ros2 bag record` writes them, and in chunks of known content."""

from __future__ import annotations

from itertools import chain, islice
from typing import TYPE_CHECKING

import numpy as np
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import StoragePlugin, Writer

from facts_damping.recording import RecordingWriter
from facts_damping.recording.decode import decode
from facts_damping.recording.scan import scan

if TYPE_CHECKING:
    from collections.abc import Iterable
    from pathlib import Path

STORAGES = {"mcap": StoragePlugin.MCAP, "sqlite3": StoragePlugin.SQLITE3}


def copy(recording: Path, out: Path, storage: str, late: int = 0, end: int | None = None) -> Path:
    """A bag in `out` of the messages of a recording, at their times of reception, from number `late` to `end`.

    It has neither run nor versions.
    """
    with AnyReader([recording]) as reader, Writer(out, version=9, storage_plugin=STORAGES[storage]) as writer:
        connections = {
            link.id: writer.add_connection(
                link.topic,
                link.msgtype,
                typestore=reader.typestore,
                offered_qos_profiles=link.ext.offered_qos_profiles,  # type: ignore[union-attr]
            )
            for link in reader.connections
        }
        for connection, log_ns, data in islice(reader.messages(), late, end):
            writer.write(connections[connection.id], log_ns, data)
    return out


def in_chunks(recording: Path, out: Path, sizes: Iterable[int]) -> list[list[tuple[str, int]]]:
    """Copy a recording to `out` in chunks of `sizes` messages. Returns topic and tick of the messages of each chunk.

    Messages are ordered by tick, then by topic; those without a tick come first, in a chunk of their own. (A recorder's
    chunks end by wall time, and the messages of a tick come in any order.)
    """
    content = scan(recording)
    ordered = []
    for place, topic in enumerate(content.topics.values()):
        of_topic = [raw_message for raw_message in content.messages if raw_message.topic == topic.name]
        for block in decode(topic, [raw_message.data for raw_message in of_topic], []):
            ticks = getattr(block.message, "tick", np.full(len(block.rows), -1)).tolist()
            ordered += [(tick, place, row, of_topic[row]) for tick, row in zip(ticks, block.rows.tolist(), strict=True)]
    ordered.sort(key=lambda entry: entry[:3])
    without_tick = sum(tick < 0 for tick, _, _, _ in ordered)
    chunks, received = [], iter(enumerate(ordered))
    with RecordingWriter(out, content.configuration, content.versions) as writer:
        for topic in content.topics.values():
            writer.copy_topic(topic)
        for size in chain([without_tick], sizes):
            chunk = list(islice(received, size))
            for at, (_, _, _, message) in chunk:
                writer.write(message.topic, message.data, at, at, message.sequence)
            writer.flush()
            chunks.append([(message.topic, tick) for _, (tick, _, _, message) in chunk])
            if len(chunk) < size:
                break
    return chunks
