"""Recordings of strangers: their runs, bags and folders are read, or refused in one line, by every command."""

from __future__ import annotations

import os
import random
import sqlite3
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
import yaml
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import facts_damping as fd
from facts_damping.case.loading import load_case
from facts_damping.cli.main import main
from facts_damping.parameters.yaml_text import dump
from facts_damping.recording import RecordingWriter, load
from facts_damping.recording.scan import scan
from facts_damping.simulation import loop
from facts_damping_views import report
from facts_damping_views.cockpit import server
from tests.commands import assert_one_line
from tests.mutations import changed
from tests.nodes.bags import copy

if TYPE_CHECKING:
    from collections.abc import Callable

    from facts_damping.record import Record

COMMANDS = {
    "report": ["analyze", "{}", "--report", "report.html", "--out", "out"],
    "baseline": ["analyze", "{}", "--baseline", "no_control", "--out", "out"],
    "replay": ["replay", "{}"],
    "another controller": ["replay", "{}", "--set", "controllers.0.parameters.gain=1"],
    "export": ["export", "{}", "--out", "out.csv"],
    "views": ["views", "{}", "--out", "views"],
    "cockpit": ["cockpit", "{}"],
    "streams": ["pmu-serve", "{}", "--port", "0", "--to", "127.0.0.1:9"],
    "trace": ["simulate", "--set", "link={{up: [{{model: trace, file: {}}}]}}", "--set", "duration=0.1"],
}
NO_RUN = ("export", "trace")  # commands that do not need the run


@pytest.fixture(scope="module")
def record() -> Record:
    return loop.run(load_case("two_area_deployment", ["duration=0.1", "measurement=ideal", "supervision=off"]))


@pytest.fixture(scope="module")
def sound(record: Record, written: Callable[..., None], tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("sound") / "sound"
    written(record, folder)
    return folder


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The current folder, in which a cockpit ends at once."""

    class Served:
        address = "nowhere"

        def __init__(self, *_: Any) -> None: ...

        async def serve(self) -> None: ...

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(server, "Server", Served)
    return tmp_path


@pytest.fixture
def stored(sound: Path) -> Callable[[Any, Path], str]:
    """Writes the recording with another content as its run; returns the folder."""
    content = scan(sound)

    def store(run: Any, folder: Path) -> str:
        with RecordingWriter(folder, run if isinstance(run, str) else dump(run), content.versions) as writer:
            for topic in content.topics.values():
                writer.copy_topic(topic)
            for message in content.messages:
                writer.write(message.topic, message.data, message.log_ns, message.publish_ns, message.sequence)
        return str(folder)

    return store


def said(command: str, path: str, capsys: pytest.CaptureFixture[str]) -> tuple[int, str]:
    """Exit status and errors of a command on a recording."""
    status = main([part.format(path) for part in COMMANDS[command]])
    return status, capsys.readouterr().err


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_reads_a_sound_recording(
    sound: Path, place: Path, command: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """Otherwise all changes would be refused for the same reason."""
    assert said(command, str(sound), capsys) == (0, "")


def link(**stage: Any) -> dict[str, Any]:
    return {"link": {"description": "", "down": [], "up": [stage]}}


CHANGES: dict[str, tuple[dict[str, Any], str]] = {
    "system": ({"system": "two_area"}, "run.yaml: system: 'two_area' given; allowed: its content"),
    "link": ({"link": "ideal"}, "run.yaml: link: 'ideal' given; allowed: its content"),
    "scenario": ({"scenario": "small"}, "run.yaml: scenario: 'small' given; allowed: a list"),
    "measurement": ({"measurement": {"filter": 5}}, "run.yaml: measurement.filter: 5 given; allowed: "),
    "stage": (link(model="constant", dely=1), "run.yaml: link.up.0.dely: 1 given"),
    "own link": ({"controllers": [{"name": "LLC", "link": {"up": 1}}]}, "run.yaml: controllers.0.link.up: 1 given"),
    "event": ({"scenario": [[]]}, "run.yaml: scenario.0: "),
    "asked": ({"asked": {"system": 5}}, "run.yaml: asked.system: 5 given"),
}


@pytest.mark.parametrize("change", CHANGES)
def test_commands_refuse_an_invalid_stored_run_in_one_line(
    record: Record, stored: Any, place: Path, change: str, capsys: pytest.CaptureFixture[str]
) -> None:
    fields, reason = CHANGES[change]
    path = stored(record.configuration | fields, place / "own")
    for command in COMMANDS if change == "system" else ("report", "cockpit"):
        status, errors = said(command, path, capsys)
        assert status == (0 if command in NO_RUN else 2), command
        if command != "trace":
            assert f"{path}: " in errors
            assert reason in errors
            assert errors.count("\n") == 1, command


def test_run_without_a_system_or_with_a_stage_without_its_name(
    record: Record, stored: Any, place: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The system is needed; what a stage lacks is its default."""
    without = {name: value for name, value in record.configuration.items() if name != "system"}
    status, errors = said("report", stored(without, place / "without"), capsys)
    assert (status, "run.yaml: system: missing; allowed: the content of a system" in errors) == (2, True)
    short = stored(record.configuration | link(delay=0.01), place / "short")
    assert said("report", short, capsys) == (0, "")
    assert load(short).configuration["link"]["up"][0]["stage"] is not None


@pytest.mark.timeout(60)
def test_list_of_a_million_is_refused_before_it_is_made(
    record: Record, stored: Any, place: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = dump({name: value for name, value in record.configuration.items() if name != "devices"})
    path = stored(f"{text}devices: [{'0,' * 10**6}]\n", place / "own")
    assert_one_line(
        2, ["views", path], "own: the run's configuration cannot be read and is left out: more than ", capsys
    )


@settings(max_examples=20, suppress_health_check=list(HealthCheck))
@given(seed=st.integers(0, 2**32), command=st.sampled_from(list(COMMANDS)))
def test_changed_run_is_read_or_refused_in_one_line(
    record: Record, stored: Any, place: Path, capsys: pytest.CaptureFixture[str], seed: int, command: str
) -> None:
    folder = place / f"{command}_{seed}"
    if folder.exists():
        return
    path = stored(changed(record.configuration, random.Random(seed)), folder)
    status, errors = said(command, path, capsys)
    assert status in (0, 2) or (status == 1 and "replay" in COMMANDS[command])  # other setpoints than recorded
    assert status == 0 or len(errors.splitlines()) == 1, errors
    assert errors.replace("\n", "").isprintable() or not errors


def foreign(folder: Path) -> str:
    """A recording of topics that are none of ours."""
    with RecordingWriter(folder) as writer:
        writer.add_topic("/chatter", "std_msgs/msg/String")
        writer.write("/chatter", bytes([0, 1, 0, 0, 2, 0, 0, 0, 97, 0]), 1, 1)
    return str(folder)


def database(sound: Path, folder: Path) -> str:
    return str(next(copy(sound, folder, "sqlite3").glob("*.db3")))


def damaged_database(sound: Path, folder: Path) -> str:
    """One whose table of messages has lost a column."""
    path = database(sound, folder)
    with sqlite3.connect(path) as base:
        base.execute("ALTER TABLE messages DROP COLUMN data")
    base.close()
    return path


def empty(folder: Path) -> str:
    folder.mkdir()
    return str(folder)


def pipe(file: Path) -> str:
    os.mkfifo(file)
    return str(file)


def pipe_within(folder: Path) -> str:
    pipe(Path(empty(folder)) / "a.mcap")
    return str(folder)


REFUSED: dict[str, tuple[Callable[[Path, Path], str], str]] = {
    "other topics": (lambda _, at: foreign(at / "x"), "no topic .../pmu/frames of type facts_damping_msgs/"),
    "damaged database": (lambda sound, at: damaged_database(sound, at / "x"), "x.db3: cut or damaged ("),
    "empty folder": (lambda _, at: empty(at / "x"), "x holds no .mcap file (nor .db3)"),
    "pipe": (lambda _, at: pipe(at / "x.mcap"), "x.mcap: a pipe given; allowed: a recording's folder, or an .mcap or"),
    "pipe in a folder": (
        lambda _, at: pipe_within(at / "x"),
        "a.mcap: a pipe given",
    ),
    "nothing": (lambda _, at: str(at / "x.db3"), "x.db3 does not exist; allowed: a recording's folder, or an .mcap"),
}


@pytest.mark.timeout(60)
@pytest.mark.parametrize("kind", REFUSED)
def test_commands_refuse_files_that_are_no_recording_of_a_run(
    sound: Path, place: Path, kind: str, capsys: pytest.CaptureFixture[str]
) -> None:
    make, reason = REFUSED[kind]
    path = make(sound, place)
    for command in COMMANDS.values():
        assert_one_line(2, [part.format(path) for part in command], reason, capsys)


@pytest.mark.parametrize("command", COMMANDS)
def test_database_is_read_or_refused_for_want_of_its_run(
    sound: Path, place: Path, command: str, capsys: pytest.CaptureFixture[str]
) -> None:
    status, errors = said(command, database(sound, place / "bag"), capsys)
    assert status == (0 if command in NO_RUN else 2)
    assert errors.count("\n") == int(command != "trace")
    assert command == "trace" or "the run's configuration is missing" in errors


@pytest.mark.timeout(60)
def test_files_named_by_the_metadata_of_a_bag_are_not_opened(sound: Path, place: Path, record: Record) -> None:
    """Its file names sort the folder's files; it may be a link or a pipe itself."""
    os.mkfifo(place / "pipe.mcap")
    file = Path(copy(sound, place / "bag", "mcap")) / "metadata.yaml"
    about = yaml.safe_load(file.read_text())
    names = ["/etc/passwd", "../pipe.mcap", str(place / "pipe.mcap"), str(sound)]
    about["rosbag2_bagfile_information"]["relative_file_paths"] = names
    file.write_text(yaml.safe_dump(about))
    assert len(load(file.parent).time_ns) == len(record.time_ns)
    for target in (None, "/dev/zero", "/etc/passwd"):
        file.unlink()
        os.mkfifo(file) if target is None else file.symlink_to(target)
        assert len(load(file.parent).time_ns) == len(record.time_ns)


@pytest.mark.parametrize("late", [False, True])
def test_recording_whose_messages_all_come_twice_replays_exactly(
    sound: Path, place: Path, late: bool, capsys: pytest.CaptureFixture[str]
) -> None:
    content = scan(sound)
    with RecordingWriter(place / "twice", content.configuration, content.versions) as writer:
        for topic in content.topics.values():
            writer.copy_topic(topic)
        again = content.messages * 2 if late else [message for message in content.messages for _ in range(2)]
        for message in again:
            writer.write(message.topic, message.data, message.log_ns, message.publish_ns, message.sequence)
    assert main(["replay", "twice"]) == 0
    out, errors = capsys.readouterr()
    assert f"exact: digest {fd.load_recording(sound).digest}" in out
    assert "refused setpoints" not in out
    notes = errors.splitlines()
    assert "twice: /pmu/frames: 6 messages repeat a tick: the first counts" in notes
    assert "twice: /setpoints/delivered: 6 messages are copies of others: the first counts" in notes
    assert all(note.endswith("the first counts") for note in notes)


def test_folder_that_is_removed_while_a_report_is_made_ends_the_command_in_a_line(
    sound: Path, place: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    write = report.write_runs
    (place / "page").mkdir()

    def removing(*positional: Any) -> None:
        (place / "page").rmdir()
        write(*positional)

    monkeypatch.setattr(report, "write_runs", removing)
    command = ["analyze", str(sound), "--report", "page/it.html", "--out", "out"]
    assert_one_line(2, command, "page/it.html: No such file or directory; allowed: a file in a folder", capsys)
    assert list(place.iterdir()) == []


def other_estimate(_topic: str, message: Any) -> Any:
    if hasattr(message, "jacobian") and message.tick == 4:
        message.jacobian = message.jacobian + 1.0
    return message


@pytest.mark.parametrize(
    ("sets", "said"),
    [
        (["link=ideal"], "but supervision is not, from tick 0 on"),  # of which the recording has nothing
        (["supervision=off", "controllers.0.name=HBsWC"], "but the estimates are not, from tick 4 on"),
    ],
)
def test_replay_names_what_differs_beside_equal_setpoints(
    place: Path, written: Callable[..., None], sets: list[str], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    case = load_case("two_area_deployment", ["duration=0.1", "measurement=ideal", "arm_at=null", *sets])
    written(loop.run(case), place / "own", change=other_estimate)
    assert main(["replay", "own"]) == 1
    assert capsys.readouterr().err.endswith(f"facts-damping: setpoints are as recorded, {said}\n")
