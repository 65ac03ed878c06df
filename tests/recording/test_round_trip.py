"""What is written comes back bit for bit, in our reader and in those of others."""

from __future__ import annotations

import dataclasses
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import yaml
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from rosbags.highlevel import AnyReader

from facts_damping.recording import load

if TYPE_CHECKING:
    from collections.abc import Callable

    from facts_damping.record import Record


def assert_identical(first: Record, other: Record, ignore: tuple[str, ...] = ()) -> None:
    for field in dataclasses.fields(first):
        a, b = getattr(first, field.name), getattr(other, field.name)
        if field.name in ignore:
            continue
        if isinstance(a, np.ndarray):
            assert a.dtype == b.dtype, field.name
            assert a.shape == b.shape, field.name
            assert a.tobytes() == b.tobytes(), field.name
        else:
            assert a == b, field.name


@given(seed=st.integers(0, 2**32 - 1), ticks=st.integers(1, 12), chunk=st.integers(1, 20))
@settings(max_examples=15, derandomize=True, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_round_trip(random_record: Any, write_record: Any, seed: int, ticks: int, chunk: int) -> None:
    record = random_record(seed, ticks)
    with tempfile.TemporaryDirectory() as folder:
        write_record(record, Path(folder) / "run", chunk=chunk)
        assert_identical(record, load(Path(folder) / "run"))


def test_single_file_without_metadata(tmp_path: Path, random_record: Callable[..., Record], write_record: Any) -> None:
    record = random_record(1)
    write_record(record, tmp_path / "run")
    file = (tmp_path / "run" / "run_0.mcap").rename(tmp_path / "other.mcap")
    assert_identical(record, load(file))


def test_rosbags_reads_it(tmp_path: Path, random_record: Callable[..., Record], write_record: Any) -> None:
    record = random_record(2)
    write_record(record, tmp_path / "run")
    with AnyReader([tmp_path / "run"]) as reader:
        assert {connection.topic: connection.msgcount for connection in reader.connections}["/pmu/frames"] == 30
        hashes = {connection.digest for connection in reader.connections}
        assert all(digest.startswith("RIHS01_") and len(digest) == 71 for digest in hashes)
        ticks = [
            reader.deserialize(data, connection.msgtype).tick  # type: ignore[attr-defined]
            for connection, _, data in reader.messages()
            if connection.topic == "/plant/state"
        ]
    assert ticks == list(range(30))


def test_mcap_reads_it(tmp_path: Path, random_record: Callable[..., Record], write_record: Any) -> None:
    record = random_record(3)
    write_record(record, tmp_path / "run", lost={"/pmu/frames": 2})
    with (tmp_path / "run" / "run_0.mcap").open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        assert reader.get_header().profile == "ros2"
        summary = reader.get_summary()
        assert summary is not None
        assert summary.statistics is not None
        assert summary.statistics.message_count == 6 * 30 + 1
        assert {index.compression for index in summary.chunk_indexes} == {"zstd"}
        assert all("offered_qos_profiles" in channel.metadata for channel in summary.channels.values())
        assert [attachment.name for attachment in reader.iter_attachments()] == ["run.yaml"]
        names = [metadata.name for metadata in reader.iter_metadata()]
        assert names == ["facts_damping.versions", "facts_damping.lost", "facts_damping.publishers", "rosbag2"]
        sequences = [message.sequence for _, _, message in reader.iter_messages(topics=["/plant/state"])]
    assert sequences == list(range(30))


def test_metadata_file(tmp_path: Path, random_record: Callable[..., Record], write_record: Any) -> None:
    write_record(random_record(4), tmp_path / "run", lost={"/pmu/frames": 2})
    text = (tmp_path / "run" / "metadata.yaml").read_text()
    information = yaml.safe_load(text)["rosbag2_bagfile_information"]
    assert information["version"] == 9
    assert information["relative_file_paths"] == ["run_0.mcap"]
    assert information["message_count"] == 181
    assert information["starting_time"]["nanoseconds_since_epoch"] == 1000
    assert information["duration"]["nanoseconds"] == 29 * 10**9 // 60 + 10
    assert information["compression_mode"] == ""
    assert information["custom_data"] == {
        "versions": '{"facts_damping": "1"}',
        "lost": '{"/pmu/frames": "2"}',
    }
    assert "&" not in text
    assert list((tmp_path / "run").glob("*.part")) == []
    assert load(tmp_path / "run").notes == ["/pmu/frames: the recorder lost 2 messages"]


def test_split_bag_is_read_in_order(tmp_path: Path, random_record: Callable[..., Record], write_record: Any) -> None:
    record = random_record(5)
    (tmp_path / "bag").mkdir()
    for part, ticks in ((2, range(10)), (10, range(10, 30))):
        write_record(record, tmp_path / str(part), skip=lambda _topic, tick, ticks=ticks: tick not in ticks)
        (tmp_path / str(part) / f"{part}_0.mcap").rename(tmp_path / "bag" / f"bag_{part}.mcap")
    loaded = load(tmp_path / "bag")
    assert_identical(record, loaded, ignore=("events",))
    assert loaded.events == record.events * 2  # each part of this split holds the event
