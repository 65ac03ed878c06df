"""Raw content of a recording, sound or damaged: topics, CDR messages, attachments and metadata.

Files are MCAP, or SQLite as `ros2 bag record` made them before. SQLite files have no checksums: damage that only
changes a number is not detected.
"""

from __future__ import annotations

import json
import re
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple
from zlib import crc32

from mcap.records import Attachment, Channel, Chunk, DataEnd, McapRecord, Message, Metadata, Schema, Statistics
from mcap.stream_reader import StreamReader
from mcap.writer import MCAP0_MAGIC
from rosbags.interfaces import MessageDefinitionFormat
from rosbags.rosbag2 import Reader

from facts_damping.errors import InputError, RecordingError, one_line
from facts_damping.input_files import RECORDING, is_file, read_bytes, read_text
from facts_damping.parameters.yaml_text import UNREADABLE, parse
from facts_damping.recording.bagfile import CUSTOM, DIGEST, FILE_NAME, INFORMATION, SQLITE, SUFFIXES, TopicInfo
from facts_damping.recording.chunks import UnpackLimit, check_counts, unpack
from facts_damping.recording.schemas import schema_text
from facts_damping.recording.writer import CONFIGURATION, LOST, PUBLISHERS, VERSIONS

if TYPE_CHECKING:
    from collections.abc import Iterator

GIVEN = f"a recording's folder, or an .mcap or {SQLITE} file"


class RawMessage(NamedTuple):
    """One message: topic, reception and publication time (ns), publisher's counter, CDR bytes."""

    topic: str
    log_ns: int
    publish_ns: int
    sequence: int
    data: bytes


@dataclass
class Content:
    """All that could be read. `complete`: no file is cut; `notes`: damage found."""

    topics: dict[str, TopicInfo] = field(default_factory=dict)
    messages: list[RawMessage] = field(default_factory=list)
    configuration: str = ""
    versions: dict[str, str] = field(default_factory=dict)
    lost: dict[str, int] = field(default_factory=dict)
    publishers: dict[str, str] = field(default_factory=dict)  # node by `topic identity`
    digest: str = ""  # as stored when the recording was made; empty: not stored
    complete: bool = True
    notes: list[str] = field(default_factory=list)

    def add_topic(self, topic: TopicInfo) -> bool:
        """Add a topic. Returns whether type and schema agree with those known; if not, adds a note."""
        known = self.topics.setdefault(topic.name, topic)
        same = (known.message_type, known.schema) == (topic.message_type, topic.schema)
        if not same:
            types = f"{known.message_type}, {topic.message_type}"
            self.notes.append(f"{topic.name} has two types: {types}; messages of the second are left out")
        return same

    def refusal(self, reason: str) -> str:
        """Error message in one line: the reason, then the damage that may have caused it."""
        return "; ".join([reason, *self.notes])


def scan(path: Path | str) -> Content:
    """Read a recording: a folder in rosbag2's layout, with or without metadata.yaml, or one of its files.

    The files of a folder are read in order. A damaged chunk is skipped; other damage ends the reading of its file.
    Raises RecordingError if the file does not exist or no message is found.
    """
    about = metadata(Path(path) / FILE_NAME)
    content = Content(digest=_stored_digest(about))
    try:
        for file in _bag_files(Path(path), about):
            if file.suffix == SQLITE:
                _scan_database(file, content)
            else:
                _scan_mcap(file, content)
    except InputError as error:
        raise RecordingError(str(error)) from error
    if not content.messages:
        raise RecordingError(content.refusal(f"{path} holds no message"))
    return content


def _bag_files(path: Path, about: dict[str, Any]) -> list[Path]:
    """Files of a recording in the order of metadata.yaml, which is `about`, else of the numbers in their names."""
    if not path.is_dir():
        if is_file(path, GIVEN):
            return [path]
        raise RecordingError(f"{path} does not exist; allowed: {GIVEN}")
    bag_files = [file for file in path.iterdir() if file.suffix in SUFFIXES and is_file(file)]
    files = sorted(bag_files, key=lambda file: [int(n) for n in re.findall(r"\d+", file.stem)][-1:])
    if not files:
        packed = ", ".join(sorted(file.name for file in path.glob("*.zstd")))
        why = f"; {packed}: unpack with zstd -d" if packed else ""
        raise RecordingError(f"{path} holds no .mcap file (nor {SQLITE}){why}")
    paths = about.get("relative_file_paths")
    listed = [Path(str(name)).name for name in paths] if isinstance(paths, list) else []
    return sorted(files, key=lambda file: listed.index(file.name) if file.name in listed else len(listed))


def metadata(file: Path) -> dict[str, Any]:
    """Content of metadata.yaml; empty if missing or damaged, since the files hold the same."""
    try:
        return dict(parse(read_text(file))[INFORMATION])
    except (InputError, *UNREADABLE):
        return {}


def _stored_digest(about: dict[str, Any]) -> str:
    """Digest in metadata.yaml; empty if missing or damaged."""
    try:
        return str(json.loads(about[CUSTOM][DIGEST]))
    except (LookupError, TypeError, ValueError):
        return ""


def _scan_mcap(file: Path, content: Content) -> None:
    """Add the content of one MCAP file to `content`.

    Schemas and channels are in the first chunk and again in the summary at the end. The first one read counts, so
    damage to one of the two does no harm. A checksum over all that precedes the summary reveals damage that nothing
    else shows.
    """
    data, notes, known = read_bytes(file, RECORDING), content.notes, len(content.notes)
    if not data.startswith(MCAP0_MAGIC):
        raise RecordingError(f"{file} is not an MCAP file")
    check_counts(data, file.name)
    schemas: dict[int, Schema] = {}
    channels: dict[int, Channel] = {}
    messages: list[Message] = []
    complete, summary = False, _summary_is_sound(data)
    for start, end, record in _sound_records(data, file.name, notes):
        if isinstance(record, Message):
            messages.append(record)
        elif isinstance(record, Schema) and (summary or not complete):
            schemas.setdefault(record.id, record)
        elif isinstance(record, Channel) and (summary or not complete):
            channels.setdefault(record.id, record)
        elif isinstance(record, DataEnd):
            complete = True
            if len(notes) == known and record.data_section_crc not in (0, crc32(data[:start])):
                notes.append(f"{file.name}: the checksum of the file is wrong: part of it is damaged")
        elif isinstance(record, Statistics):
            if summary and len(notes) == known and record.message_count != len(messages):
                notes.append(f"{file.name}: {len(messages)} of {record.message_count} messages were found")
        elif isinstance(record, Attachment) and _crc(data[end - 4 : end]) not in (0, crc32(data[start + 9 : end - 4])):
            notes.append(f"{file.name}: {record.name} is damaged and left out")
        else:
            _add_extra(record, content)
    topics = {i: c.topic for i, c in channels.items() if _add_topic(c, schemas.get(c.schema_id), content)}
    content.messages += [
        RawMessage(topics[raw.channel_id], raw.log_time, raw.publish_time, raw.sequence, bytes(raw.data))
        for raw in messages
        if raw.channel_id in topics
    ]
    content.complete = content.complete and complete


def _crc(data: bytes) -> int:
    return int.from_bytes(data, "little")


def _summary_is_sound(data: bytes) -> bool:
    """Whether the summary's checksum fits; it covers the summary and the footer except the checksum itself."""
    end = len(data) - len(MCAP0_MAGIC) - 4
    start = int.from_bytes(data[end - 16 : end - 8], "little")
    stored = _crc(data[end : end + 4])
    return data.endswith(MCAP0_MAGIC) and (stored == 0 or stored == crc32(data[start:end]))


def _add_topic(channel: Channel, schema: Schema | None, content: Content) -> bool:
    """Add a topic. Only CDR with a `ros2msg` schema can be decoded; any other type counts as unknown.

    Returns whether the topic has the same type as before.
    """
    name, text = (schema.name, schema.data.decode(errors="replace")) if schema else ("", "")
    if schema and schema.encoding != "ros2msg":
        name = f"{name} ({schema.encoding})"
    qos, type_hash = (channel.metadata.get(key, "") for key in ("offered_qos_profiles", "topic_type_hash"))
    return content.add_topic(TopicInfo(channel.topic, name, text, qos, type_hash))


def _add_extra(record: McapRecord, content: Content) -> None:
    """Add configuration, versions, publishers and counts of lost messages."""
    if isinstance(record, Attachment) and record.name == CONFIGURATION:
        content.configuration = record.data.decode(errors="replace")
    elif isinstance(record, Metadata) and record.name == VERSIONS:
        content.versions.update(record.metadata)
    elif isinstance(record, Metadata) and record.name == PUBLISHERS:
        content.publishers.update(record.metadata)
    elif isinstance(record, Metadata) and record.name == LOST:
        for topic, count in record.metadata.items():
            content.lost[topic] = content.lost.get(topic, 0) + (int(count) if count.isdecimal() else 0)


def _sound_records(data: bytes, name: str, notes: list[str]) -> Iterator[tuple[int, int, McapRecord]]:
    """Records of a file with their first and end byte, up to the file's end or the first damage between chunks.

    Damaged chunks are left out. mcap, zstandard and lz4 raise many kinds of error on damaged bytes; all are treated
    alike.
    """
    stream = BytesIO(data)
    stream.seek(len(MCAP0_MAGIC))
    reader = StreamReader(stream, skip_magic=True, emit_chunks=True, record_size_limit=len(data))
    records, room = iter(reader.records), UnpackLimit()
    while True:
        position = stream.tell()
        try:
            record = next(records, None)
        except Exception:  # noqa: BLE001 (see above)
            notes.append(f"{name}: cut or damaged at byte {position} of {len(data)}")
            return
        if record is None:
            return
        for unpacked in _unpack(record, stream.tell(), room, f"{name}: chunk at byte {position}", notes):
            yield position, stream.tell(), unpacked


def _unpack(record: McapRecord, end: int, room: UnpackLimit, where: str, notes: list[str]) -> list[McapRecord]:
    """Records of a chunk after its checksum is verified; any other record unchanged."""
    if not isinstance(record, Chunk):
        return [record]
    if not room.has(record, end):
        notes.append(f"{where} would unpack to {record.uncompressed_size} bytes and is left out")
        return []
    try:
        return unpack(record)
    except Exception:  # noqa: BLE001 (as in _sound_records)
        notes.append(f"{where} is damaged and left out")
        return []


def _scan_database(file: Path, content: Content) -> None:
    """Add the content of one SQLite file to `content`; of a damaged file, all that precedes the damage.

    Message definitions are taken from the file; older files have none, then the installed ones are used.
    """
    if not read_bytes(file, RECORDING)[:16].startswith(b"SQLite format 3"):
        raise RecordingError(f"{file} is not an SQLite file")
    try:
        with Reader(file) as reader:
            topics = [connection for connection in reader.connections if _add_connection(connection, content)]
            for connection, log_ns, data in reader.messages(topics) if topics else ():
                content.messages.append(RawMessage(connection.topic, log_ns, log_ns, 0, bytes(data)))
    except RecordingError:
        raise
    except Exception as error:  # noqa: BLE001 (SQLite and rosbags raise many kinds on damaged files)
        content.complete = False
        content.notes.append(f"{file.name}: cut or damaged ({one_line(error) or type(error).__name__})")


def _add_connection(connection: Any, content: Content) -> bool:
    name = connection.msgtype
    if connection.msgdef.format == MessageDefinitionFormat.MSG:
        text = connection.msgdef.data
    else:
        try:
            text = schema_text(name)
        except RecordingError:
            text = ""
    return content.add_topic(TopicInfo(connection.topic, name, text, "", connection.digest))
