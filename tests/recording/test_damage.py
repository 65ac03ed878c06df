"""Recordings that were cut, damaged, or are not ours: what can be read is read, anything else is one line."""

from __future__ import annotations

import dataclasses
import random
import signal
import subprocess
import sys
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from mcap.reader import make_reader
from rosbags.highlevel import AnyReader

from facts_damping.errors import OLD_NAMES, RecordingError
from facts_damping.recording import RecordingWriter, load, recover

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from facts_damping.record import Record

STRING = "std_msgs/msg/String"


def assert_prefix(part: Record, whole: Record) -> None:
    """All of `part` is the beginning of `whole`."""
    last = len(part.time_ns)
    assert part.configuration == whole.configuration
    assert part.frames.tobytes() == whole.frames[:last].tobytes()
    assert part.machines.tobytes() == whole.machines[:last].tobytes()
    for name in ("delivered", "issued", "applied"):
        rows = getattr(whole, name)
        assert getattr(part, name).tobytes() == rows[rows["tick"] < last].tobytes()


def test_cut_anywhere(tmp_path: Path, random_record: Callable[..., Record], write_record: Any) -> None:
    """At and around every border of chunks, and at some random places: what whole chunks hold is read."""
    record = random_record(11)
    write_record(record, tmp_path / "run", chunk=3)
    file = tmp_path / "run" / "run_0.mcap"
    whole, cut = file.read_bytes(), tmp_path / "cut.mcap"
    with file.open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None
    ends = [index.chunk_start_offset + index.chunk_length for index in summary.chunk_indexes]
    assert len(ends) == 10
    lengths = [0, 1, 8, len(whole) - 1, *random.Random(0).sample(range(len(whole)), 30)]
    for length in [*lengths, *(end + more for end in ends for more in (-1, 0, 1))]:
        cut.write_bytes(whole[:length])
        ticks = 3 * sum(end <= length for end in ends)
        if ticks:
            part = load(cut)
            assert_prefix(part, record)
            assert (len(part.time_ns), bool(part.notes)) == (ticks, True)
        else:
            with pytest.raises(RecordingError) as caught:
                load(cut)
            assert "\n" not in str(caught.value)


@pytest.mark.parametrize("chunk", [0, 1, 2])
def test_damaged_chunk_is_left_out(
    tmp_path: Path, random_record: Callable[..., Record], write_record: Any, chunk: int
) -> None:
    record = random_record(13)
    write_record(record, tmp_path / "run", chunk=10)
    file = tmp_path / "run" / "run_0.mcap"
    with file.open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None
    damaged = summary.chunk_indexes[chunk]
    whole = bytearray(file.read_bytes())
    whole[damaged.chunk_start_offset + damaged.chunk_length // 2] ^= 0xFF
    file.write_bytes(whole)
    part = load(file)
    assert part.time_ns.tolist() == np.delete(record.time_ns, range(10 * chunk, 10 * chunk + 10)).tolist()
    assert any("is damaged and left out" in note for note in part.notes)
    if chunk == 1:
        assert "/pmu/frames: 10 of 30 ticks are missing (10, 11, 12, 13, 14, ...)" in part.notes


def test_recover(tmp_path: Path, random_record: Callable[..., Record], write_record: Any) -> None:
    record = random_record(14)
    write_record(record, tmp_path / "run", chunk=3)
    file = tmp_path / "run" / "run_0.mcap"
    file.write_bytes(file.read_bytes()[: file.stat().st_size * 2 // 3])
    (tmp_path / "run" / "metadata.yaml").unlink()
    notes = recover(tmp_path / "run", tmp_path / "sound")
    assert len(notes) == 1
    assert "cut or damaged at byte" in notes[0]
    before, after = load(tmp_path / "run"), load(tmp_path / "sound")
    assert after.notes == []
    assert after.frames.tobytes() == before.frames.tobytes()
    with AnyReader([tmp_path / "sound"]) as reader:
        assert reader.message_count > 0
    with pytest.raises(RecordingError, match="holds a recording already"):
        recover(tmp_path / "run", tmp_path / "sound")


def test_killed_process_keeps_what_was_flushed(tmp_path: Path) -> None:
    code = f"""
import os, signal
from facts_damping.recording import RecordingWriter
writer = RecordingWriter({str(tmp_path / "run")!r}, "seed: 3")
writer.add_topic("/chatter", {STRING!r})
for count in range(100):
    writer.write("/chatter", bytes([0, 1, 0, 0, 2, 0, 0, 0, 97, 0]), count, count, count)
    if count == 79:
        writer.flush()
os.kill(os.getpid(), signal.SIGKILL)
"""
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == -signal.SIGKILL
    assert not (tmp_path / "run" / "metadata.yaml").exists()
    recover(tmp_path / "run", tmp_path / "sound")
    with AnyReader([tmp_path / "sound"]) as reader:
        assert [stamp for _, stamp, _ in reader.messages()] == list(range(80))


def test_lost_ticks_are_noted(tmp_path: Path, random_record: Callable[..., Record], write_record: Any) -> None:
    record = random_record(15)
    write_record(record, tmp_path / "run", skip=lambda topic, tick: topic == "/pmu/delivered" and tick in {4, 7})
    part = load(tmp_path / "run")
    assert part.notes == ["/pmu/delivered: 2 of 30 ticks are missing (4, 7)"]
    assert not np.isin([4, 7], part.delivered["tick"]).any()
    assert part.issued.tobytes() == record.issued.tobytes()


def test_lost_messages_count_those_at_the_end(
    tmp_path: Path, random_record: Callable[..., Record], write_record: Any
) -> None:
    """Of which the recorder knows nothing, as no later message of the topic came."""
    missing = {"/plant/state": {3, 27, 28, 29}, "/pmu/delivered": {4}}
    counted = {"/plant/state /plant_sim": 1, "/pmu/delivered /wan_link": 1}
    skip = lambda topic, tick: tick in missing.get(topic, ())  # noqa: E731
    write_record(random_record(15), tmp_path / "run", skip=skip, lost=counted)
    assert load(tmp_path / "run").messages_lost == 5


def test_tick_that_ends_an_unstable_run_stays(
    tmp_path: Path, random_record: Callable[..., Record], write_record: Any
) -> None:
    record = random_record(16)
    record.in_synchronism[-1] = False
    write_record(record, tmp_path / "run", skip=lambda topic, tick: tick == 29 and "setpoints" in topic)
    part = load(tmp_path / "run")
    assert part.notes == []
    assert part.in_synchronism.tolist() == [True] * 29 + [False]


def test_topics_that_are_found_one_after_the_other(
    tmp_path: Path, random_record: Callable[..., Record], write_record: Any
) -> None:
    """A recorder that comes late may hear of some earlier than of others: the record begins when it heard all."""
    record = random_record(19)
    begins = {"/plant/state": 5, "/pmu/frames": 6, "/controller_2_A/setpoints": 8, "/pmu/delivered": 7}
    write_record(record, tmp_path / "run", skip=lambda topic, tick: tick < begins.get(topic, 5))
    part = load(tmp_path / "run")
    assert part.time_ns.tobytes() == record.time_ns[8:].tobytes()
    assert part.gap_tick is None


@pytest.mark.parametrize("topic", ["/pmu/frames", "/pmu/delivered", "/plant/state"])
def test_topic_without_messages(
    tmp_path: Path, random_record: Callable[..., Record], write_record: Any, topic: str
) -> None:
    write_record(random_record(17), tmp_path / "run", skip=lambda name, _: name == topic)
    if topic == "/pmu/delivered":
        assert load(tmp_path / "run").notes[0].startswith("/pmu/delivered: 29 of 30 ticks are missing")
        return
    with pytest.raises(RecordingError, match=f"no tick is complete in the recording: no message of {topic}$"):
        load(tmp_path / "run")


def test_topics_that_have_no_tick_in_common(
    tmp_path: Path, random_record: Callable[..., Record], write_record: Any
) -> None:
    ticks = {"/plant/state": range(10, 30), "/pmu/frames": range(8)}
    write_record(random_record(20), tmp_path / "run", skip=lambda topic, tick: tick not in ticks.get(topic, range(30)))
    said = "no tick is complete in the recording: /pmu/frames ends with tick 7, /plant/state begins with tick 10$"
    with pytest.raises(RecordingError, match=said):
        load(tmp_path / "run")


def test_cut_recording_that_is_refused_says_so(
    tmp_path: Path, random_record: Callable[..., Record], write_record: Any
) -> None:
    late = ("/pmu/delivered", "/controller_10_B/setpoints")
    write_record(random_record(20), tmp_path / "run", skip=lambda topic, tick: topic in late and tick < 5)
    file = tmp_path / "run" / "run_0.mcap"
    with file.open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None
    end = summary.chunk_indexes[1].chunk_start_offset
    file.write_bytes(file.read_bytes()[: end + 10])
    with pytest.raises(RecordingError) as caught:
        load(file)
    reason, damage = str(caught.value).split("; ")
    assert reason == f"{file}: no tick is complete in the recording: no message of {', '.join(late)}"
    assert damage == f"run_0.mcap: cut or damaged at byte {end} of {end + 10}"


def test_run_without_controllers_needs_no_setpoints(
    tmp_path: Path, random_record: Callable[..., Record], write_record: Any
) -> None:
    record = dataclasses.replace(random_record(18), configuration={"controllers": []})
    write_record(record, tmp_path / "run", skip=lambda topic, _: "setpoints" in topic)
    part = load(tmp_path / "run")
    assert part.frames.tobytes() == record.frames.tobytes()
    assert len(part.issued) == len(part.applied) == 0


def test_foreign_recording(tmp_path: Path) -> None:
    with RecordingWriter(tmp_path / "run") as writer:
        writer.add_topic("/pmu/frames", STRING)
        writer.write("/pmu/frames", bytes([0, 1, 0, 0, 2, 0, 0, 0, 97, 0]), 1, 1)
    with pytest.raises(RecordingError, match=r"no topic \.\.\./pmu/frames of type facts_damping_msgs/"):
        load(tmp_path / "run")


def test_recording_with_messages_of_old_names_says_so(tmp_path: Path) -> None:
    with RecordingWriter(tmp_path / "run") as writer:
        old = next(name for name, new in OLD_NAMES.items() if new == "DeviceSetpoints")
        writer.add_topic("/setpoints/delivered", f"facts_damping_msgs/msg/{old}", schema="uint64 tick\n")
        writer.write("/setpoints/delivered", bytes([0, 1, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0]), 1, 1)
    with pytest.raises(RecordingError, match=f"; made before {old} was renamed to DeviceSetpoints"):
        load(tmp_path / "run")


def test_foreign_schema(tmp_path: Path) -> None:
    with RecordingWriter(tmp_path / "run") as writer:
        for topic, name in (("/pmu/frames", "PmuDataFrame"), ("/plant/state", "PlantState")):
            writer.add_topic(topic, f"facts_damping_msgs/msg/{name}", schema="uint64 tick\n")
            writer.write(topic, bytes([0, 1, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0]), 1, 1)
    with pytest.raises(RecordingError, match=r"PmuDataFrame\.frames: no such field given; allowed: "):
        load(tmp_path / "run")


@pytest.mark.parametrize(
    ("content", "reason"),
    [(None, "does not exist"), (b"", "is not an MCAP file"), (b"x" * 99, "is not an MCAP file")],
)
def test_missing_or_foreign_recording_is_refused(tmp_path: Path, content: bytes | None, reason: str) -> None:
    file = tmp_path / "x.mcap"
    if content is not None:
        file.write_bytes(content)
    with pytest.raises(RecordingError, match=reason):
        load(file)
    (tmp_path / "empty").mkdir()
    with pytest.raises(RecordingError, match=r"holds no \.mcap file"):
        load(tmp_path / "empty")
