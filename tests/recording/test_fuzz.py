"""Damage of any kind, as the commands see it: read as far as it is sound, with a line, or refused in one line."""

from __future__ import annotations

import math
import os
import random
import struct
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
import yaml
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st
from mcap.records import Attachment
from mcap.stream_reader import StreamReader

from facts_damping.case.loading import load_case
from facts_damping.cli.main import main
from facts_damping.errors import FactsDampingError
from facts_damping.recording import RecordingWriter, load, schema_text
from facts_damping.simulation import loop
from facts_damping.simulation.replaying import replay
from tests.mutations import damaged, mutated

if TYPE_CHECKING:
    from collections.abc import Callable

    from facts_damping.record import Record

SETS = ["duration=1", "link=plc", "controllers.0.name=ANFTSC", "scenario=large"]
PACKAGE = "facts_damping_msgs/msg/"
RECORDINGS = int(os.environ.get("RECORDINGS", "40"))  # damaged ones
FUZZ = settings(max_examples=25, derandomize=True, deadline=None, suppress_health_check=list(HealthCheck))
FAR = ("/pmu/frames", "/plant/state")
TABLES = ("delivered", "issued", "applied", "estimates")


@pytest.fixture(scope="module")
def record() -> Record:
    return loop.run(load_case(None, SETS))


@pytest.fixture(scope="module")
def whole(record: Record, tmp_path_factory: Any, written: Any) -> bytes:
    """The file of a whole recording, in many chunks."""
    folder = tmp_path_factory.mktemp("whole") / "run"
    written(record, folder, chunk=4)
    return bytes((folder / "run_0.mcap").read_bytes())


def read(data: bytes, name: str = "run.mcap") -> Record | str:
    """A record, which is then replayed too; or the one line that refuses it."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / name
        file.write_bytes(data)
        try:
            part = load(file)
            _ = part.arrays
            case = replay.case_of(part, "it", None, [])
            fit = replay.fitted(part, case)
            assert replay.first_difference(fit, replay.play(case, fit)[0]) is None
        except FactsDampingError as error:
            assert "\n" not in str(error)  # noqa: PT017 (the other way is to read it)
            return str(error)
        return part


def assert_sound(outcome: Record | str, whole: Record) -> None:
    """What is read is what was written: no number is another one, and what lacks is said."""
    if isinstance(outcome, str):
        return
    assert outcome.configuration in (whole.configuration, {})
    places = np.searchsorted(whole.time_ns, outcome.time_ns)
    assert outcome.time_ns.tobytes() == whole.time_ns[places].tobytes()
    for name in ("frames", "machines", "devices"):
        assert getattr(outcome, name).tobytes() == getattr(whole, name)[places].tobytes()
    for name in TABLES:
        rows, known = getattr(outcome, name), getattr(whole, name)
        assert {row.tobytes() for row in rows} <= {row.tobytes() for row in known}
    complete = len(outcome.time_ns) == len(whole.time_ns) and outcome.configuration and outcome.gap_tick is None
    if not complete or any(len(getattr(outcome, name)) < len(getattr(whole, name)) for name in TABLES):
        assert outcome.notes


def test_whole_file_is_sound(whole: bytes, record: Record) -> None:
    outcome = read(whole)
    assert not isinstance(outcome, str), outcome
    assert_sound(outcome, record)
    assert outcome.notes == []
    assert outcome.gap_tick is None
    assert len(outcome.time_ns) == 60


@given(fraction=st.floats(0.0, 1.0))
@example(0.0)
@example(0.5)
@FUZZ
def test_cut_anywhere(whole: bytes, record: Record, fraction: float) -> None:
    outcome = read(whole[: int(fraction * (len(whole) - 1))])
    assert_sound(outcome, record)
    assert isinstance(outcome, str) or outcome.notes


@given(flips=st.lists(st.tuples(st.floats(0.0, 1.0, exclude_max=True), st.integers(0, 7)), min_size=1, max_size=4))
@FUZZ
def test_flipped_bits(whole: bytes, record: Record, flips: list[tuple[float, int]]) -> None:
    data = bytearray(whole)
    for place, bit in flips:
        data[int(place * len(data))] ^= 1 << bit
    assert_sound(read(bytes(data)), record)


@given(
    place=st.floats(0.0, 1.0), length=st.integers(1, 3000), what=st.sampled_from(["lost", "zeros", "twice", "noise"])
)
@FUZZ
def test_blocks_lost_or_overwritten(whole: bytes, record: Record, place: float, length: int, what: str) -> None:
    start = int(place * len(whole))
    block = whole[start : start + length]
    put = {"lost": b"", "zeros": bytes(len(block)), "twice": block + block, "noise": bytes(b ^ 0x5A for b in block)}
    assert_sound(read(whole[:start] + put[what] + whole[start + length :]), record)


@given(data=st.binary(max_size=400))
@FUZZ
def test_noise_is_refused(data: bytes) -> None:
    for name, magic in (("x.mcap", b""), ("x.mcap", b"\x89MCAP0\r\n"), ("x.db3", b""), ("x.db3", b"SQLite format 3\0")):
        assert isinstance(read(magic + data, name), str)


def test_changed_bit_of_the_stored_run_is_noticed(whole: bytes) -> None:
    """A digit of a gain in run.yaml is not covered by a chunk: its own checksum tells."""
    with tempfile.TemporaryFile() as stream:
        stream.write(whole)
        stream.seek(0)
        (text,) = [r.data for r in StreamReader(stream, emit_chunks=True).records if isinstance(r, Attachment)]
    start = whole.index(text)
    for place in range(start, start + len(text), len(text) // 15):
        data = bytearray(whole)
        data[place] ^= 1
        outcome = read(bytes(data[: len(data) * 3 // 4]))  # cut, so that there is no checksum of the whole
        assert "holds no run" in str(outcome)
        cut = _load(bytes(data[: len(data) * 3 // 4]))
        assert any("run.yaml is damaged and left out" in note for note in cut.notes)
        assert cut.configuration == {}


def _load(data: bytes) -> Record:
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "run.mcap"
        file.write_bytes(data)
        return load(file)


def test_chunk_whose_kind_is_flipped_is_missed(whole: bytes, record: Record) -> None:
    """It is passed over as an unknown record; the checksum of the whole, or the count of messages, tells."""
    chunk = whole.rindex(b"zstd")  # of the last chunk
    while whole[chunk - 41] != 0x06:
        chunk = whole.rindex(b"zstd", 0, chunk)
    data = bytearray(whole)
    data[chunk - 41] = 0x56
    loaded = _load(bytes(data))
    assert len(loaded.time_ns) < 60
    assert any("checksum of the file" in note for note in loaded.notes)


def foreign(folder: Path, configuration: str, schemas: dict[str, tuple[str, str]], data: bytes, times: int = 3) -> Path:
    with RecordingWriter(folder, configuration) as writer:
        for topic, (name, schema) in schemas.items():
            writer.add_topic(topic, PACKAGE + name, schema=schema)
            for i in range(times):
                writer.write(topic, data, i, i, i)
    return folder


LEAVES = [
    "float64",
    "float32",
    "string",
    "bool",
    "uint64",
    "int8[]",
    "string[]",
    "float64[]",
    "builtin_interfaces/Time",
]
FIELDS = [
    "header",
    "tick",
    "frames",
    "fresh",
    "machines",
    "devices",
    "in_synchronism",
    "setpoints",
    "controller",
    "value",
]


@given(
    fields=st.lists(
        st.tuples(st.sampled_from(LEAVES), st.sampled_from(FIELDS)), unique_by=lambda pair: pair[1], max_size=8
    ),
    data=st.binary(max_size=120),
)
@example([("uint64", "tick")], b"\xff" * 8)
@example([("uint64", "tick")], (10**15).to_bytes(8, "little"))
@example([("float64", "tick")], struct.pack("<d", math.nan))
@example([("float64", "tick")], struct.pack("<d", -math.inf))
@example([("float64", "tick")], struct.pack("<d", 1e300))
@example([("float32", "tick"), ("bool", "fresh")], struct.pack("<f?", math.nan, 1))
@example([("float64[]", "tick")], struct.pack("<Qd", 1, math.nan))
@example([("string", "tick")], struct.pack("<I", 4) + b"nan\0")
@FUZZ
def test_other_schemas_by_our_names_are_refused(fields: list[tuple[str, str]], data: bytes) -> None:
    text = "\n".join(f"{kind} {name}" for kind, name in fields) + "\n"
    text += "=" * 80 + "\nMSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n"
    names = {"/pmu/frames": "PmuDataFrame", "/pmu/delivered": "PmuDataFrame", "/plant/state": "PlantState"}
    names |= {"/c/setpoints": "DeviceSetpoints", "/setpoints/delivered": "DeviceSetpoints"}
    with tempfile.TemporaryDirectory() as folder:
        place = foreign(Path(folder) / "run", "", {t: (n, text) for t, n in names.items()}, b"\0\1\0\0" + data)
        with pytest.raises(FactsDampingError) as caught:
            load(place)
        assert "\n" not in str(caught.value)


def late(topic: str, message: Any) -> Any:
    """A message, or with a tick far away where it is the last of the plant's."""
    if topic in FAR and message.tick == 59:
        message.tick = 10**14
    return message


def test_tick_far_away_neither_hangs_nor_fills_the_memory(
    tmp_path: Path, record: Record, messages: Any, written: Callable[..., None]
) -> None:
    """As a sender of another version, or of another kind, might number them."""
    written(record, tmp_path / "run", change=late)
    loaded = load(tmp_path / "run")
    assert {f"{topic}: 1 messages of ticks outside the run are left out" for topic in FAR} <= set(loaded.notes)
    assert len(loaded.time_ns) == 59


def test_tick_far_away_in_a_bag_without_a_run_does_not_either(
    tmp_path: Path, record: Record, messages: Any, written: Callable[..., None]
) -> None:
    written(record, tmp_path / "run", change=late, configuration="none")
    loaded = load(tmp_path / "run")
    assert any(note.startswith(f"/pmu/delivered: {10**14 - 60} of") for note in loaded.notes)
    assert loaded.gap_tick in (59, 60)


@pytest.mark.parametrize(
    "topic", ["/plant/state", "/pmu/delivered", "/controller_0_ANFTSC/setpoints", "/identifier_0_X/estimate"]
)
def test_missing_message_ends_the_replay_at_its_tick(tmp_path: Path, record: Record, written: Any, topic: str) -> None:
    written(record, tmp_path / "run", skip=lambda name, tick: (name, tick) == (topic, 41))
    loaded = load(tmp_path / "run")
    assert loaded.gap_tick == 41
    case = replay.case_of(loaded, "it", None, [])
    part = replay.fitted(loaded, case)
    assert part.ticks.tolist() == list(range(41))
    assert len(part.issued) > 5
    assert replay.first_difference(part, replay.play(case, part)[0]) is None


@pytest.mark.parametrize("change", ["older", "newer", "text", "list", "other"])
def test_run_of_another_version_is_left_out_with_a_line(
    tmp_path: Path, record: Record, written: Any, change: str
) -> None:
    configuration = dict(record.configuration)
    if change == "newer":
        configuration["weather"] = "rain"
    elif change == "older":
        configuration["system"] = {"name": "two_area", "machines": []}
    content: Any = {"text": "nothing", "list": [1, 2], "other": {"seed": [1], "controllers": 5}}.get(
        change, configuration
    )
    written(record, tmp_path / "run", configuration=yaml.safe_dump(content))
    loaded = load(tmp_path / "run")
    assert loaded.configuration == {}
    (note,) = loaded.notes
    assert "configuration" in note
    assert "\n" not in note


@pytest.mark.parametrize("verb", ["analyze", "replay", "export"])
@pytest.mark.parametrize("damage", ["cut", "middle", "header", "empty", "noise", "run", "absent"])
def test_commands_say_it_in_lines(
    tmp_path: Path, whole: bytes, record: Record, capsys: Any, verb: str, damage: str
) -> None:
    middle = len(whole) // 2
    data = {
        "cut": whole[: middle + middle // 2],
        "middle": whole[:middle] + bytes(b ^ 0xFF for b in whole[middle : middle + 40]) + whole[middle + 40 :],
        "header": b"\0" + whole[1:],
        "empty": b"",
        "noise": bytes(range(256)) * 20,
        "run": whole.replace(b"frame_rate: 60", b"frame_rate: 61"),
    }.get(damage)
    file = tmp_path / "run.mcap"
    if data is not None:
        file.write_bytes(data)
    out = {"analyze": ["--out", str(tmp_path / "out")], "export": ["--out", str(tmp_path / "out.csv")]}.get(verb, [])
    status = main([verb, str(file), *out])
    said = capsys.readouterr().err
    sound = damage in ("cut", "middle") or (damage == "run" and verb == "export")
    assert status == (0 if sound else 2), said
    assert "Traceback" not in said
    assert said.count("\n") >= 1
    assert sound or said.count("\n") == 1
    if sound:
        assert "missing" in said or "damaged" in said


def test_topics_of_other_types_beside_ours_do_no_harm(tmp_path: Path, record: Record, written: Any) -> None:
    written(record, tmp_path / "run", more={"/chatter": "std_msgs/msg/String"})
    assert load(tmp_path / "run").notes == []
    assert schema_text("std_msgs/msg/String").startswith("#")


@settings(max_examples=25, suppress_health_check=list(HealthCheck))
@given(seed=st.integers(0, 2**32), command=st.sampled_from(["analyze", "replay", "views"]))
def test_run_in_a_recording_that_is_nearly_right(
    tmp_path_factory: Any, record: Record, written: Any, capsys: Any, seed: int, command: str
) -> None:
    """As another version, or somebody else, may have stored it: what it names is not opened."""
    folder = tmp_path_factory.mktemp("stored")
    stored = yaml.safe_dump(record.configuration, allow_unicode=True)
    text = mutated(stored, random.Random(seed)).decode(errors="replace")
    written(record, folder / "run", configuration=text)
    out = ["--out", str(folder / "out")] if command != "replay" else []
    assert main([command, str(folder / "run"), *out]) in (0, 1, 2)
    errors = capsys.readouterr().err
    assert "Traceback" not in errors
    assert errors.replace("\n", "").isprintable() or errors == ""


def test_damaged_recordings(tmp_path: Path, whole: bytes, capsys: Any) -> None:
    """Status 0, or 2 and one line; RECORDINGS=5000 tries more."""
    dice = random.Random(1)
    statuses = set()
    for number in range(RECORDINGS):
        file = tmp_path / f"{number}.mcap"  # stays, to be looked at, where this fails
        file.write_bytes(damaged(whole, dice))
        status = main(["export", str(file), "--out", str(tmp_path / "out.parquet")])
        errors = capsys.readouterr().err
        statuses.add(status)
        assert status in (0, 2), (file, errors)
        assert "Traceback" not in errors
        assert status == 0 or errors.count("\n") == 1, (file, errors)
        assert list(tmp_path.glob("*.new")) == []
        file.unlink()
    assert statuses == {0, 2}
