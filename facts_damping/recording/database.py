"""Reads SQLite bags, the storage of `ros2 bag record` before MCAP.

They have no checksums: damage that only changes a number is not detected.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from rosbags.interfaces import MessageDefinitionFormat
from rosbags.rosbag2 import Reader

from facts_damping.errors import RecordingError, one_line
from facts_damping.input_files import RECORDING, read_bytes
from facts_damping.recording.bagfile import TopicInfo
from facts_damping.recording.content import RawMessage
from facts_damping.recording.schemas import schema_text

if TYPE_CHECKING:
    from pathlib import Path
    from typing import Any

    from facts_damping.recording.content import Content

SQLITE = ".db3"


def read_database(file: Path, content: Content) -> None:
    """Add the content of one file to `content`; of a damaged file, all that precedes the damage.

    Message definitions are taken from the file; older files have none, then the installed ones are used.
    """
    if not read_bytes(file, RECORDING)[:16].startswith(b"SQLite format 3"):
        raise RecordingError(f"{file} is not an SQLite file")
    try:
        with Reader(file) as reader:
            own = [connection for connection in reader.connections if _add_topic(connection, content)]
            for connection, log_ns, data in reader.messages(own) if own else ():
                content.messages.append(RawMessage(connection.topic, log_ns, log_ns, 0, bytes(data)))
    except RecordingError:
        raise
    except Exception as error:  # noqa: BLE001 (SQLite and rosbags raise many kinds on damaged files)
        content.complete = False
        content.notes.append(f"{file.name}: cut or damaged ({one_line(error) or type(error).__name__})")


def _add_topic(connection: Any, content: Content) -> bool:
    name = connection.msgtype
    if connection.msgdef.format == MessageDefinitionFormat.MSG:
        text = connection.msgdef.data
    else:
        try:
            text = schema_text(name)
        except RecordingError:
            text = ""
    return content.add_topic(TopicInfo(connection.topic, name, text, "", connection.digest))
