"""Recordings as `ros2 bag record` would have made them: the same messages, no run, no versions."""

from __future__ import annotations

from itertools import islice
from typing import TYPE_CHECKING

from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import StoragePlugin, Writer

if TYPE_CHECKING:
    from pathlib import Path

STORAGES = {"mcap": StoragePlugin.MCAP, "sqlite3": StoragePlugin.SQLITE3}


def copy(recording: Path, out: Path, storage: str, late: float = 0.0) -> Path:
    """A bag in `out` of the messages of a recording, at their times of reception; a share of `late` is cut off."""
    with AnyReader([recording]) as reader, Writer(out, version=9, storage_plugin=STORAGES[storage]) as writer:
        made = {
            one.id: writer.add_connection(
                one.topic,
                one.msgtype,
                typestore=reader.typestore,
                offered_qos_profiles=one.ext.offered_qos_profiles,  # type: ignore[union-attr]
            )
            for one in reader.connections
        }
        missing = int(late * reader.message_count)
        for connection, log_ns, data in islice(reader.messages(), missing, None):
            writer.write(made[connection.id], log_ns, data)
    return out
