"""Writes a recording: a folder in rosbag2's layout with one MCAP file."""

from __future__ import annotations

import json
from contextlib import contextmanager
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any

from mcap.writer import CompressionType, Writer

from facts_damping.errors import RecordingError
from facts_damping.interruption import RECORDED, clean_up_first
from facts_damping.output.writing import write_whole
from facts_damping.recording.bagfile import FILE_NAME, INFORMATION, RELIABLE, TopicInfo, bag_information, dump, qos_text
from facts_damping.recording.chunks import may_pack
from facts_damping.recording.schemas import schema_text, type_hash

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from typing_extensions import Self

CONFIGURATION = "run.yaml"  # attachment with the run's configuration
VERSIONS = "facts_damping.versions"  # metadata record with the versions
LOST = "facts_damping.lost"  # metadata record with the counts of lost messages
PUBLISHERS = "facts_damping.publishers"  # metadata record with the publishers: `TOPIC IDENTITY` to node
MESSAGE = 31  # bytes of a message record beside its data


class RecordingWriter:
    """Writes CDR messages to `<folder>/<folder's name>_0.mcap`, then `<folder>/metadata.yaml`.

    `configuration`: the run's full configuration (YAML text); `versions`: the software that made it. Both are written
    at the start of the file, so that even a killed recording has them. Messages collect in a chunk until it is full (1
    MiB) or `flush` or `close` is called; flushed data survive a kill of this process. As a context manager it closes
    the recording however the block ends. Raises RecordingError if the folder holds a recording or cannot be written.
    """

    def __init__(self, folder: Path | str, configuration: str = "", versions: Mapping[str, str] | None = None) -> None:
        """Open a new recording."""
        clean_up_first(RECORDED)
        self.folder = Path(folder)
        self.file = self.folder / f"{self.folder.resolve().name}_0.mcap"
        self._versions = {name: str(version) for name, version in (versions or {}).items()}
        self._channels: dict[str, tuple[int, TopicInfo]] = {}
        self._schemas: dict[tuple[str, str], int] = {}
        self._counts: dict[str, int] = {}
        self._span: tuple[int, int] | None = None
        self._size = 0  # of all messages, not packed
        self._stream: IO[bytes] | None = _open_new(self.file)
        self._mcap = Writer(self._stream, compression=CompressionType.ZSTD, enable_data_crcs=True)
        with writing(self.file):
            self._mcap.start(profile="ros2")
            self._mcap.add_metadata(VERSIONS, self._versions)
            if configuration:
                self._mcap.add_attachment(0, 0, CONFIGURATION, "application/yaml", configuration.encode())
            self._stream.flush()

    def add_topic(
        self, topic: str, message_type: str, qos: Mapping[str, Any] = RELIABLE, schema: str | None = None
    ) -> None:
        """Add a topic of type "package/msg/Type" before its first message.

        `qos`: its offered profile; `schema`: its definition with dependencies, from the installed packages if None.
        Raises RecordingError (unknown type, topic added before).
        """
        text = schema_text(message_type) if schema is None else schema
        self.copy_topic(TopicInfo(topic, message_type, text, qos_text([qos]), type_hash(message_type, text)))

    def copy_topic(self, topic: TopicInfo) -> None:
        """Add a topic exactly as in another recording."""
        self._check_open()
        if topic.name in self._channels:
            raise RecordingError(f"topic {topic.name} was announced before")
        key = (topic.message_type, topic.schema)
        if key not in self._schemas:
            self._schemas[key] = self._mcap.register_schema(topic.message_type, "ros2msg", topic.schema.encode())
        metadata = {"offered_qos_profiles": topic.qos, "topic_type_hash": topic.type_hash}
        channel = self._mcap.register_channel(topic.name, "cdr", self._schemas[key], metadata)
        self._channels[topic.name] = (channel, topic)
        self._counts[topic.name] = 0

    def write(self, topic: str, cdr: bytes | memoryview, log_ns: int, publish_ns: int, sequence: int = 0) -> None:
        """Write one message.

        `cdr`: serialised message; `log_ns`, `publish_ns`: times of reception and publication, ns since 1970;
        `sequence`: the publisher's counter (gaps are lost messages). Raises RecordingError.
        """
        stream = self._check_open()
        if topic not in self._channels:
            raise RecordingError(f"topic {topic} was not announced; there are {', '.join(self._channels) or 'none'}")
        self._size += MESSAGE + len(cdr)
        kind = CompressionType.ZSTD if may_pack(self._size, stream.tell()) else CompressionType.NONE
        self._mcap._Writer__compression = kind  # type: ignore[attr-defined]  # noqa: SLF001 (it is fixed otherwise)
        try:  # without `writing`, which takes 1 us
            self._mcap.add_message(self._channels[topic][0], log_ns, bytes(cdr), publish_ns, sequence % 2**32)
        except OSError as error:
            raise _unwritable(self.file, error) from error
        self._counts[topic] += 1
        first, last = self._span or (log_ns, log_ns)
        self._span = (min(first, log_ns), max(last, log_ns))

    def flush(self) -> None:
        """Close the current chunk and hand all data to the operating system, without fsync.

        Call it about every half second of wall time, the most that a kill can then lose. Otherwise nothing is written
        to disk before a chunk is full.
        """
        self._check_open()
        with writing(self.file):
            self._mcap.flush()  # type: ignore[no-untyped-call]

    def close(self, lost: Mapping[str, int] | None = None, publishers: Mapping[str, str] | None = None) -> None:
        """End the MCAP file, then write `metadata.yaml`: its presence marks a complete recording.

        `lost`: lost messages counted by the recorder, by `topic publisher` (or topic). `publishers`: nodes by `topic
        identity` of the publisher (GID, hexadecimal). A second call does nothing.
        """
        if self._stream is None:
            return
        missed = {topic: str(int(count)) for topic, count in (lost or {}).items()}
        counts = {topic: self._counts[name] for name, (_, topic) in self._channels.items()}
        custom = {"versions": json.dumps(self._versions), "lost": json.dumps(missed)}
        information = bag_information(self.file.name, counts, self._span or (0, 0), custom)
        stream, self._stream = self._stream, None
        with writing(self.file):
            with stream:
                self._mcap.add_metadata(LOST, missed)
                self._mcap.add_metadata(PUBLISHERS, dict(publishers or {}))
                self._mcap.add_metadata("rosbag2", {"serialized_metadata": dump(information)})
                self._mcap.finish()  # type: ignore[no-untyped-call]
            write_whole(self.folder / FILE_NAME, dump({INFORMATION: information}))

    def __enter__(self) -> Self:
        """Return the writer; the recording is already open."""
        return self

    def __exit__(self, *_: object) -> None:
        """Close the recording, also after an error, so that it stays readable."""
        self.close()

    def _check_open(self) -> IO[bytes]:
        if self._stream is None:
            raise RecordingError(f"{self.folder}: the recording is closed")
        return self._stream


def _open_new(file: Path) -> IO[bytes]:
    """Create the MCAP file of a new recording; raises rather than overwrite an existing one."""
    folder = file.parent
    with writing(file):
        folder.mkdir(parents=True, exist_ok=True)
        if (folder / FILE_NAME).exists() or any(folder.glob("*.mcap")):
            raise RecordingError(f"{folder} holds a recording already; give a new folder")
        return file.open("xb")


@contextmanager
def writing(file: Path) -> Iterator[None]:
    """Errors of writing a file as RecordingError."""
    try:
        yield
    except OSError as error:
        raise _unwritable(file, error) from error


def _unwritable(file: Path, error: OSError) -> RecordingError:
    return RecordingError(f"{file} cannot be written: {error.strerror or error}")
