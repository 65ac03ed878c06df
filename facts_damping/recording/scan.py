"""Raw content of a recording, sound or damaged: topics, messages as CDR bytes, what is stored beside."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import yaml
from mcap.records import Attachment, Channel, Chunk, DataEnd, McapRecord, Message, Metadata, Schema
from mcap.stream_reader import StreamReader, breakup_chunk
from mcap.writer import MCAP0_MAGIC

from facts_damping.errors import RecordingError
from facts_damping.recording.bagfile import FILE_NAME, TopicInfo
from facts_damping.recording.writer import CONFIGURATION, LOST, VERSIONS

if TYPE_CHECKING:
    from collections.abc import Iterator


class RawMessage(NamedTuple):
    """One message: topic, times of reception and publication (ns), publisher's counter, CDR bytes."""

    topic: str
    log_ns: int
    publish_ns: int
    sequence: int
    data: bytes


@dataclass
class Content:
    """All that could be read; `complete`: no file lacks its end; `notes` say what is damaged."""

    topics: dict[str, TopicInfo] = field(default_factory=dict)
    messages: list[RawMessage] = field(default_factory=list)
    configuration: str = ""
    versions: dict[str, str] = field(default_factory=dict)
    lost: dict[str, int] = field(default_factory=dict)
    complete: bool = True
    notes: list[str] = field(default_factory=list)


def scan(path: Path | str) -> Content:
    """Read a recording: a folder in rosbag2's layout, with or without metadata.yaml, or one `.mcap` file.

    The files of a folder are read in order. Of a damaged file everything up to the damage is read, and
    what lies behind a damaged chunk. Raises RecordingError if there is no MCAP file or nothing in it.
    """
    content = Content()
    for file in mcap_files(Path(path)):
        try:
            _scan_file(file, content)
        except OSError as error:
            raise RecordingError(f"{file} cannot be read: {error.strerror or error}") from error
    if not content.messages:
        raise RecordingError(f"{path} holds no message" + "".join(f"; {note}" for note in content.notes))
    return content


def mcap_files(path: Path) -> list[Path]:
    """MCAP files of a recording in order: as metadata.yaml lists them, else by the numbers in their names."""
    if path.is_file():
        return [path]
    if not path.is_dir():
        raise RecordingError(f"{path} does not exist; give a recording's folder or an .mcap file")
    files = sorted(path.glob("*.mcap"), key=lambda file: [int(n) for n in re.findall(r"\d+", file.stem)][-1:])
    if not files:
        raise RecordingError(f"{path} holds no .mcap file")
    listed = _listed_files(path / FILE_NAME)
    return sorted(files, key=lambda file: listed.index(file.name) if file.name in listed else len(listed))


def _listed_files(metadata: Path) -> list[str]:
    """File names in metadata.yaml; none if it is missing or damaged, for the MCAP files tell the same."""
    try:
        content = yaml.safe_load(metadata.read_text(encoding="utf-8"))
        return [Path(str(name)).name for name in content["rosbag2_bagfile_information"]["relative_file_paths"]]
    except (OSError, UnicodeDecodeError, yaml.YAMLError, KeyError, TypeError):
        return []


def _scan_file(file: Path, content: Content) -> None:
    """Add what one file holds to `content`.

    Schemas and channels stand in the first chunk and again in the summary at the end: the first that is
    read counts, so that damage to one of the two places does no harm.
    """
    schemas: dict[int, Schema] = {}
    channels: dict[int, Channel] = {}
    messages: list[Message] = []
    complete = False
    for record in _sound_records(file, content.notes):
        if isinstance(record, Message):
            messages.append(record)
        elif isinstance(record, Schema):
            schemas.setdefault(record.id, record)
        elif isinstance(record, Channel):
            channels.setdefault(record.id, record)
        elif isinstance(record, DataEnd):
            complete = True
        else:
            _add_extra(record, content)
    for channel in channels.values():
        _add_topic(channel, schemas.get(channel.schema_id), content)
    _add_messages(messages, channels, content)
    content.complete = content.complete and complete


def _add_messages(messages: list[Message], channels: dict[int, Channel], content: Content) -> None:
    content.messages += [
        RawMessage(channels[one.channel_id].topic, one.log_time, one.publish_time, one.sequence, bytes(one.data))
        for one in messages
        if one.channel_id in channels
    ]


def _add_topic(channel: Channel, schema: Schema | None, content: Content) -> None:
    """Note a topic; only CDR with a `ros2msg` schema can be decoded, anything else counts as unknown."""
    name, text = (schema.name, schema.data.decode(errors="replace")) if schema else ("", "")
    if schema and schema.encoding != "ros2msg":
        name = f"{name} ({schema.encoding})"
    qos, type_hash = (channel.metadata.get(key, "") for key in ("offered_qos_profiles", "topic_type_hash"))
    known = content.topics.setdefault(channel.topic, TopicInfo(channel.topic, name, text, qos, type_hash))
    if known.message_type != name or known.schema != text:
        raise RecordingError(f"topic {channel.topic} has two types: {known.message_type}, {name}")


def _add_extra(record: McapRecord, content: Content) -> None:
    """Take over configuration, versions and counts of lost messages."""
    if isinstance(record, Attachment) and record.name == CONFIGURATION:
        content.configuration = record.data.decode(errors="replace")
    elif isinstance(record, Metadata) and record.name == VERSIONS:
        content.versions.update(record.metadata)
    elif isinstance(record, Metadata) and record.name == LOST:
        for topic, count in record.metadata.items():
            content.lost[topic] = content.lost.get(topic, 0) + (int(count) if count.isdecimal() else 0)


def _sound_records(file: Path, notes: list[str]) -> Iterator[McapRecord]:
    """Records of a file up to its end or the first damage between chunks; damaged chunks are left out.

    mcap, zstandard and lz4 raise a dozen kinds of error on damaged bytes: all of them mean the same here.
    """
    size = file.stat().st_size
    with file.open("rb") as stream:
        if stream.read(len(MCAP0_MAGIC)) != MCAP0_MAGIC:
            raise RecordingError(f"{file} is not an MCAP file")
        reader = StreamReader(stream, skip_magic=True, emit_chunks=True, record_size_limit=size)
        records = iter(reader.records)
        while True:
            position = stream.tell()
            try:
                record = next(records, None)
            except Exception:  # noqa: BLE001 (see above)
                notes.append(f"{file.name}: cut or damaged at byte {position} of {size}")
                return
            if record is None:
                return
            yield from _unpack(record, f"{file.name}: chunk at byte {position} is damaged and left out", notes)


def _unpack(record: McapRecord, damage: str, notes: list[str]) -> list[McapRecord]:
    """Records inside a chunk, checked against its checksum; any other record as it is."""
    if not isinstance(record, Chunk):
        return [record]
    try:
        return breakup_chunk(record, validate_crc=True)
    except Exception:  # noqa: BLE001 (as in _sound_records)
        notes.append(damage)
        return []
