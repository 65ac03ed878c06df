"""Files that are small and would fill the memory: one line, at once, whatever is read of them."""

from __future__ import annotations

import subprocess
import sys
from functools import cache
from typing import TYPE_CHECKING, Any

import lz4.frame
import pytest
import zstandard
from mcap.data_stream import RecordBuilder
from mcap.records import Chunk, Header, Message
from mcap.writer import MCAP0_MAGIC, Writer

from facts_damping.recording.schemas import schema_text

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

GIGABYTE = 1 << 30
MAX_MB = 300
MAX_S = 2.0  # of processor time for the reading; that of loading libraries is told apart
TRIES = 3  # the quickest counts: two threads of one core, both busy, take half as long again
STATE, FRAMES = (f"facts_damping_msgs/msg/{name}" for name in ("PlantState", "PmuDataFrame"))
ALIASES = "a0: &a0 [x]\n" + "".join(f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 10)}]\n" for i in range(1, 12))

# Of each folder the bomb is read, by a copy of a process that has all libraries: its own peak of memory and time.
READ = """
import os, signal, sys, time
from facts_damping.cli.main import main
import facts_damping.recording.reader, facts_damping.cli.recordings
from facts_damping.recording.scan import scan
for folder in sys.argv[1:]:
    if os.fork():
        os.wait()
        continue
    signal.alarm(60)
    for stream, name in ((1, "said"), (2, "errors")):
        os.dup2(os.open(f"{folder}/{name}", os.O_WRONLY | os.O_CREAT | os.O_TRUNC), stream)
    began = time.process_time()
    status = main(["export", f"{folder}/bomb.mcap", "--out", f"{folder}/out.csv"])
    took = time.process_time() - began
    most = next(line for line in open("/proc/self/status") if line.startswith("VmHWM"))
    print(status, took, int(most.split()[1]) / 1024, flush=True)
    os._exit(0)
"""


def chunked(file: Path, *chunks: Chunk) -> None:
    """A file of chunks, without a summary."""
    builder = RecordBuilder()
    for mcap_record in (Header("ros2", ""), *chunks):
        mcap_record.write(builder)
    file.write_bytes(MCAP0_MAGIC + builder.end())  # type: ignore[no-untyped-call]


def chunk(compression: str, data: bytes, size: int) -> Chunk:
    return Chunk(compression, data, 0, 0, 0, size)


def message(count: int) -> bytes:
    """So many empty messages, as a chunk has them."""
    builder = RecordBuilder()
    Message(1, 0, b"", 0, 0).write(builder)
    return bytes(builder.end()) * count  # type: ignore[no-untyped-call]


def zeros(size: int) -> Any:
    piece = bytes(1 << 20)
    return (piece for _ in range(size >> 20))


@cache
def zstd(size: int, with_size: bool) -> bytes:
    compressor = zstandard.ZstdCompressor(level=1, write_content_size=with_size)
    stream = compressor.compressobj(size=size) if with_size else compressor.compressobj()
    return b"".join(stream.compress(piece) for piece in zeros(size)) + stream.flush()


@cache
def lz(size: int) -> bytes:
    with lz4.frame.LZ4FrameCompressor() as stream:
        return bytes(stream.begin() + b"".join(stream.compress(piece) for piece in zeros(size)) + stream.flush())


def recorded(file: Path, schema: str, data: bytes, configuration: str = "", qos: str = "") -> None:
    """A recording of one message each of two topics, with a schema for the first."""
    with file.open("wb") as stream:
        writer = Writer(stream)
        writer.start("ros2")
        if configuration:
            writer.add_attachment(0, 0, "run.yaml", "application/yaml", configuration.encode())
        for topic, name, text in (("/plant/state", STATE, schema), ("/pmu/frames", FRAMES, schema_text(FRAMES))):
            channel = writer.register_channel(
                topic, "cdr", writer.register_schema(name, "ros2msg", text.encode()), {"offered_qos_profiles": qos}
            )
            writer.add_message(channel, 0, data, 0)
        writer.finish()  # type: ignore[no-untyped-call]


def nested(levels: int, each: str) -> str:
    """A schema of types that hold each other."""
    parts = [schema_text(STATE).rstrip("\n"), "test/A0 more"]
    for i in range(levels):
        fields = "\n".join(f"A{i + 1}{each} x{k}" for k in range(2))
        parts.append(f"{'=' * 80}\nMSG: test/A{i}\n{fields}")
    parts.append(f"{'=' * 80}\nMSG: test/A{levels}\nuint8 x")
    head, _, rest = parts[0].partition(f"\n{'=' * 80}\n")
    return "\n".join([head, parts[1], f"{'=' * 80}\n{rest}", *parts[2:]]) + "\n"


BOMBS: dict[str, Callable[[Path], None]] = {
    "zstd": lambda file: chunked(file, chunk("zstd", zstd(GIGABYTE, with_size=True), GIGABYTE)),
    "zstd that does not say how large": lambda file: chunked(
        file, chunk("zstd", zstd(GIGABYTE, with_size=False), GIGABYTE)
    ),
    "zstd that lies": lambda file: chunked(file, chunk("zstd", zstd(GIGABYTE, with_size=True), 1000)),
    "zstd that lies and does not say": lambda file: chunked(file, chunk("zstd", zstd(GIGABYTE, with_size=False), 1000)),
    "lz4": lambda file: chunked(file, chunk("lz4", lz(GIGABYTE), GIGABYTE)),
    "lz4 that lies": lambda file: chunked(file, chunk("lz4", lz(GIGABYTE), 1000)),
    "many messages": lambda file: chunked(
        file, chunk("zstd", zstandard.compress(tiny := message(3_000_000)), len(tiny))
    ),
    "many chunks": lambda file: chunked(file, *[chunk("zstd", zstd(8 << 20, with_size=True), 8 << 20)] * 1000),
    "aliases": lambda file: recorded(file, schema_text(STATE), bytes(500), ALIASES),
    "nesting": lambda file: recorded(file, schema_text(STATE), bytes(500), "[" * 100_000),
    "types": lambda file: recorded(file, nested(30, ""), bytes([0, 1, 0, 0]) + bytes(500)),
    "types of many": lambda file: recorded(file, nested(8, "[1000000]"), bytes([0, 1, 0, 0]) + bytes(500)),
    "deep types": lambda file: recorded(file, nested(3000, ""), bytes([0, 1, 0, 0]) + bytes(500)),
}


@pytest.fixture(scope="module")
def folders(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """A folder of each bomb, and what was said as it was read."""
    folders_of_bombs = {name: tmp_path_factory.mktemp("bomb") for name in BOMBS}
    for name, folder in folders_of_bombs.items():
        BOMBS[name](folder / "bomb.mcap")
        assert (folder / "bomb.mcap").stat().st_size < 10 << 20
    read(*folders_of_bombs.values())
    return folders_of_bombs


def read(*folders: Path) -> None:
    subprocess.run([sys.executable, "-c", READ, *map(str, folders)], check=True)


@pytest.mark.parametrize("name", BOMBS)
def test_bomb_is_one_line(folders: dict[str, Path], name: str) -> None:
    folder = folders[name]
    for _ in range(TRIES):
        status, took, megabytes = map(float, (folder / "said").read_text().split())
        if took < MAX_S:
            break
        read(folder)
    assert status == 2
    errors = (folder / "errors").read_text()
    assert errors.count("\n") == 1, errors
    assert megabytes < MAX_MB
    assert took < MAX_S
