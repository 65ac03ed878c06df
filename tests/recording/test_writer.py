"""The writer's refusals, and schema texts."""

from __future__ import annotations

from pathlib import Path

import pytest

from facts_damping.errors import RecordingError
from facts_damping.recording import RecordingWriter, schema_text
from facts_damping.recording.scan import scan
from facts_damping.recording.schemas import SEPARATOR, definition_file, type_hash

STRING = "std_msgs/msg/String"
MSG_DEFS = Path(__file__).parents[2] / "msg_defs" / "msg"


def test_schema_is_verbatim_with_dependencies() -> None:
    text = schema_text("facts_damping_msgs/msg/DeviceSetpoints")
    sections = text.split(SEPARATOR + "\n")
    assert sections[0] == (MSG_DEFS / "DeviceSetpoints.msg").read_text()
    assert [section.splitlines()[0] for section in sections[1:]] == [
        "MSG: std_msgs/Header",
        "MSG: builtin_interfaces/Time",
        "MSG: facts_damping_msgs/DeviceSetpoint",
    ]


@pytest.mark.parametrize("file", sorted(MSG_DEFS.glob("*.msg")), ids=lambda file: file.stem)
def test_every_message_has_schema_and_hash(file: Path) -> None:
    name = f"facts_damping_msgs/msg/{file.stem}"
    assert type_hash(name, schema_text(name)).startswith("RIHS01_")


def test_hash_of_a_standard_type() -> None:
    # From std_msgs/msg/String.json of ROS 2 Kilted (ros-kilted-std-msgs).
    known = "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18"
    assert type_hash(STRING, schema_text(STRING)) == known


def test_ament_prefix_path_comes_first(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = tmp_path / "share" / "std_msgs" / "msg" / "String.msg"
    file.parent.mkdir(parents=True)
    file.write_text("string data\n")
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(tmp_path))
    assert definition_file(STRING) == file


@pytest.mark.parametrize("name", ["String", "std_msgs/String", "std_msgs/srv/String", "std_msgs/msg/Nothing"])
def test_unknown_type(name: str) -> None:
    with pytest.raises(RecordingError, match=f"message type '{name}'"):
        schema_text(name)


def test_never_overwrites(tmp_path: Path) -> None:
    RecordingWriter(tmp_path / "run").close()
    with pytest.raises(RecordingError, match="holds a recording already"):
        RecordingWriter(tmp_path / "run")


def test_refusals(tmp_path: Path) -> None:
    writer = RecordingWriter(tmp_path / "run")
    writer.add_topic("/chatter", STRING)
    with pytest.raises(RecordingError, match="topic /chatter was announced before"):
        writer.add_topic("/chatter", STRING)
    with pytest.raises(RecordingError, match="topic /other was not announced; there are /chatter"):
        writer.write("/other", b"", 0, 0)
    writer.close()
    writer.close()
    with pytest.raises(RecordingError, match="the recording is closed"):
        writer.write("/chatter", b"", 0, 0)


def test_place_that_cannot_be_written(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(RecordingError, match="cannot be written"):
        RecordingWriter(tmp_path / "file" / "run")


def test_recording_of_equal_large_messages_is_read_whole(tmp_path: Path) -> None:
    """Such as those of many steady PMUs: they pack so well that a reader would take them for a bomb."""
    frames, count = bytes(500_000), 60
    with RecordingWriter(tmp_path / "run") as writer:
        writer.add_topic("/pmu/frames", "facts_damping_msgs/msg/PmuDataFrame")
        for k in range(count):
            writer.write("/pmu/frames", frames, k, k, k)
    content = scan(tmp_path / "run")
    assert (len(content.messages), content.notes) == (count, [])
    assert writer.file.stat().st_size < count * len(frames) / 10


def test_error_inside_the_block_still_closes(tmp_path: Path) -> None:
    def interrupted() -> None:
        with RecordingWriter(tmp_path / "run") as writer:
            writer.add_topic("/chatter", STRING)
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert (tmp_path / "run" / "metadata.yaml").exists()
