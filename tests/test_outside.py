"""What comes from outside goes through the doors: for files, for text, and for the user's own code."""

from __future__ import annotations

import ast
import json
import os
import signal
import socket
import subprocess
import sys
import time
import zipfile
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from mcap.opcode import Opcode
from mcap.writer import MCAP0_MAGIC
from scipy.io import savemat

import facts_damping
from facts_damping import input_files
from facts_damping.case.loading import load_case, recorded_case
from facts_damping.cli.main import main
from facts_damping.errors import InputError, one_line
from facts_damping.escaping import SCREEN, escaped, shortened
from facts_damping.parameters.yaml_text import MAX_ENTRIES
from facts_damping.recording.chunks import HEAD, MAX_OTHERS
from facts_damping.simulation.changes import with_event, with_link
from facts_damping.simulation.programs import fmus
from tests.commands import assert_one_line

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

ROOT = Path(facts_damping.__file__).parents[1]
SOURCES = [ROOT / "facts_damping", ROOT / "extensions"]

# Who opens files beside the door, and which.
FILES = {
    "input_files.py": "the door",
    "case/linear_laws.py": "reads, of memory, what the door has read",
    "case/mat_file.py": "reads, of memory, what the door has read",
    "cli/main.py": "standard output's end",
    "cli/new.py": "reads the package's templates",
    "compiling": "reads the package's source, writes kernels",
    "nodes/launching/forked.py": "writes what nodes say",
    "nodes/launching/processes.py": "what nodes say",
    "facts_damping_testing/loopback": "writes what nodes say; reads parameter files of the command line",
    "facts_damping_testing/tap_relay.py": "opens a device of the system's for virtual networks, by its name",
    "facts_damping_views/exporting.py": "writes",
    "recording/schemas.py": "reads installed definitions of messages",
    "recording/writer.py": "writes",
    "simulation/programs/fmus.py": "unpacks what the door has read",
    "small_signal/linear_plant.py": "writes",
    "facts_damping_testing/storm/storm_graph.py": "reads again what nodes say",
    "facts_damping_studies/campaigns/campaign_pages.py": "reads shipped pages",
    "facts_damping_studies/score/isolation/child.py": "closes standard streams of a user's program",
    "facts_damping_studies/score/isolation/confinement.py": "names to the kernel what a user's program may read",
    "facts_damping_studies/sweeps/journal.py": "appends to its own file, once the door has let it",
    "facts_damping_validation/table.py": "reads shipped references",
}
LOADERS = {"load", "loadtxt", "genfromtxt", "loadmat", "ZipFile", "fromfile"}
OPENERS = {"open", "fdopen", "read_text", "read_bytes", *LOADERS}
BESIDE = {"load": ("np", "numpy"), "open": ()}  # of names that others have, too: whose are meant

# Who writes to the terminal beside the door.
SPEAKERS = {
    "output/terminal.py": "the door",
    "nodes/base/log.py": "what nodes say, escaped",
    "nodes/base/run.py": "what nodes say, escaped",
    "compiling": "lines of its own, which its parent reads",
    "interruption.py": "a line, before the door is loaded",
    "nodes/base/warmup.py": "errors, escaped",
}


def calls(file: Path) -> Iterator[ast.Call]:
    return (node for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))) if isinstance(node, ast.Call))


def opens(call: ast.Call) -> bool:
    """Whether a call opens a file, as far as its name tells."""
    function = call.func
    if isinstance(function, ast.Name):
        return function.id in {"open", *LOADERS} - {"load"}
    if not isinstance(function, ast.Attribute) or function.attr not in OPENERS:
        return False
    of = function.value.id if isinstance(function.value, ast.Name) else ""
    return function.attr != "load" or of in BESIDE["load"]


def outside(is_opening: Callable[[ast.Call], bool], allowed: dict[str, str]) -> list[str]:
    """Places of calls in files of the package that are not allowed, and allowed files that have none."""
    places, used = [], set()
    files = [(file, file.relative_to(source).as_posix()) for source in SOURCES for file in sorted(source.rglob("*.py"))]
    for file, name in files:
        room = next((place for place in allowed if name == place or name.startswith(f"{place}/")), None)
        for call in filter(is_opening, calls(file)):
            used.add(room)
            if room is None:
                places.append(f"{name}:{call.lineno}")
    return places + sorted(set(allowed) - used)


def speaks(call: ast.Call) -> bool:
    """Whether a call writes to standard output or standard error."""
    text = ast.unparse(call.func)
    return text in ("print", "sys.stdout.write", "sys.stderr.write") or (
        text == "os.write" and ast.unparse(call.args[0]) in ("1", "2")
    )


@pytest.fixture
def odd(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with what is no file that one reads, under names of all that is read; the current one."""
    monkeypatch.chdir(tmp_path)
    for suffix in ("yaml", "csv", "npz", "mat", "fmu", "mcap", "db3", "m", "raw", "py"):
        os.mkfifo(tmp_path / f"pipe.{suffix}")
        (tmp_path / f"zero.{suffix}").symlink_to("/dev/zero")
        (tmp_path / f"folder.{suffix}").mkdir()
    with socket.socket(socket.AF_UNIX) as held:
        held.bind("socket.yaml")
    return tmp_path


def trace(file: str) -> str:
    return f"link={{{{up: [{{{{model: trace, file: {file}}}}}]}}}}"


NAMED = {
    "run": ["simulate", "{}.yaml"],
    "system": ["modes", "{}.yaml"],
    "scenario": ["simulate", "--set", "scenario={}.yaml"],
    "weights": ["simulate", "--set", "controllers.0.name=HBsWC", "--set", "controllers.0.weights={}.yaml"],
    "trace": ["simulate", "--set", trace("{}.csv")],
    "recorded trace": ["simulate", "--set", trace("{}.mcap")],
    "law": ["simulate", "--set", "controllers=[{{name: mine, linear: {}.npz}}]"],
    "MATLAB law": ["simulate", "--set", "controllers=[{{name: mine, linear: {}.mat}}]"],
    "policy": ["simulate", "--set", "controllers=[{{name: mine, policy: '{}.py:Mine'}}]"],
    "FMU": ["simulate", "--set", "controllers=[{{name: mine, fmu: {}.fmu}}]"],
    "new key": ["new", "key", "{}.yaml"],
    "keys": ["run", "--set", "security.keys={}.yaml", "--out", "out"],
    "recording": ["analyze", "{}.mcap"],
    "bag": ["analyze", "{}.db3"],
    "MATPOWER": ["import", "{}.m"],
    "PSS/E": ["import", "{}.raw"],
    "study": ["sweep", "{}.yaml"],
    "campaign": ["campaign", "{}.yaml"],
}


@pytest.mark.timeout(60)
@pytest.mark.parametrize("kind", ["pipe", "zero", "folder"])
@pytest.mark.parametrize("command", NAMED.values(), ids=NAMED)
def test_pipe_device_or_folder_in_place_of_a_file_is_refused_at_once(
    odd: Path, capsys: pytest.CaptureFixture[str], command: list[str], kind: str
) -> None:
    what = {"pipe": "a pipe given", "zero": "a device given", "folder": "a folder given"}[kind]
    if kind == "folder" and command[-1].endswith((".mcap", ".db3", ".mcap}}]}}")):
        what = "holds no .mcap file"
    assert_one_line(2, [part.format(kind) for part in command], what, capsys)
    assert not (odd / "out").exists()


def test_socket_and_a_file_that_is_too_large_are_named(odd: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert_one_line(2, ["simulate", "socket.yaml"], "socket.yaml", capsys)
    with (odd / "large.yaml").open("wb") as file:
        file.truncate(input_files.TEXT + 1)  # which takes no room
    assert_one_line(2, ["simulate", "large.yaml"], "allowed: at most 10000000", capsys)
    (odd / "noise.yaml").write_bytes(b"system: \xff")
    assert_one_line(2, ["simulate", "noise.yaml"], "invalid start byte at byte 8; allowed: UTF-8", capsys)


def bomb(path: Path, member: str, size: int) -> None:
    """A small archive of zeros that unpack to this size."""
    with (
        zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive,
        archive.open(member, "w", force_zip64=True) as file,
    ):
        for _ in range(size >> 20):
            file.write(bytes(1 << 20))


def test_archive_that_unpacks_to_too_much_is_refused_before_unpacking(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("facts_damping.case.linear_laws.MATRICES", 20 << 20)
    monkeypatch.setattr(fmus, "FMU_UNPACKED", 20 << 20)
    bomb(tmp_path / "law.npz", "A.npy", 30 << 20)
    bomb(tmp_path / "law.fmu", "modelDescription.xml", 30 << 20)
    savemat(tmp_path / "law.mat", {"A": np.zeros((1000, 4000))}, do_compression=True)
    for field, file in (("linear", "law.npz"), ("linear", "law.mat"), ("fmu", "law.fmu")):
        assert (tmp_path / file).stat().st_size < 1 << 20
        row = f"controllers=[{{name: mine, {field}: {file}}}]"
        assert_one_line(2, ["simulate", "--set", row], f"{file}: more than {20 << 20} bytes unpacked", capsys)


def test_archive_does_not_leave_its_folder(tmp_path: Path) -> None:
    file = tmp_path / "escape.fmu"
    with zipfile.ZipFile(file, "w") as archive:
        archive.writestr("../../escaped", "out")
        archive.writestr("/escaped", "out")
    with pytest.raises(InputError, match=r"escape\.fmu: cannot be read"):
        fmus.unpacked(file, "here")
    assert not Path("/escaped").exists()
    assert not (tmp_path.parent / "escaped").exists()


SECRET = "s3cret: of the system's"  # first line of a file that is nobody's to see


@pytest.fixture
def secret(tmp_path: Path) -> dict[str, str]:
    """Files that exist, by their kind, and are not to be opened."""
    paths = {"yaml": tmp_path / "secret.yaml", "csv": tmp_path / "secret.csv", "npz": tmp_path / "secret.npz"}
    for path in paths.values():
        path.write_text(SECRET)
    os.mkfifo(tmp_path / "pipe.yaml")
    return {kind: str(path) for kind, path in paths.items()} | {"pipe": str(tmp_path / "pipe.yaml")}


# Where a run's content may name a file, and of which kind.
PLACES: dict[str, Callable[[str], dict[str, Any]]] = {
    "system": lambda file: {"system": file},
    "model": lambda file: {"model": file},
    "scenario": lambda file: {"scenario": file},
    "measurement": lambda file: {"measurement": file},
    "link": lambda file: {"link": file},
    "supervision": lambda file: {"supervision": file},
    "weights": lambda file: {"controllers": [{"name": "HBsWC", "scheme": "direct", "weights": file}]},
    "own link": lambda file: {"controllers": [{"name": "LLC", "link": file}]},
    "law": lambda file: {"controllers": [{"name": "mine", "linear": file}]},
    "trace": lambda file: {"link": {"up": [{"model": "trace", "file": file}]}},
}


@pytest.mark.timeout(60)
@pytest.mark.parametrize("kind", ["yaml", "pipe", "csv", "npz", "absent"])
@pytest.mark.parametrize("place", PLACES)
def test_recording_names_no_file(secret: dict[str, str], place: str, kind: str) -> None:
    file = secret.get(kind, "/nowhere/at_all.yaml")
    content = load_case("two_area_small").document() | PLACES[place](file)
    with pytest.raises(InputError) as refused:
        recorded_case(content, "of somebody")
    assert "s3cret" not in str(refused.value)
    assert "no such file" not in str(refused.value)  # whether there is one is not told, either
    if kind == "yaml":
        assert f"{file}: named by the recording of somebody, which may open no file" in str(refused.value)


@pytest.mark.timeout(60)
def test_change_of_a_run_names_no_file(secret: dict[str, str]) -> None:
    case = load_case(None, [])
    for text in (secret["yaml"], secret["pipe"], f"{{up: [{{model: trace, file: {secret['csv']}}}]}}"):
        with pytest.raises(InputError, match="named by a change of a run"):
            with_link(case, 0, text)
        with pytest.raises(InputError) as refused:
            with_event(case, text, 10**9)
        assert "s3cret" not in str(refused.value)
    assert with_link(case, 0, "delay_100ms").links[0].up


def test_only_files_named_by_the_user_and_shipped_ones_may_be_opened(tmp_path: Path) -> None:
    named, other = tmp_path / "own.yaml", tmp_path / "other.yaml"
    named.write_text("a: 1")
    other.write_text("a: 1")
    assert input_files.read_text(named) == "a: 1"
    with input_files.naming_no_files("a test"):
        assert input_files.read_text(named) == "a: 1"
        assert input_files.read_text(input_files.share_folder() / "config" / "runs" / "two_area_small.yaml")
        for path in (other, input_files.share_folder() / "config" / ".." / "setup.py"):
            with pytest.raises(InputError, match="named by a test"):
                input_files.read_bytes(path)


def test_too_many_are_refused_by_their_count(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    row = "  - {time: 1.0, kind: line_out, line: line_1}\n"
    Path("many.yaml").write_text("scenario:\n" + row * (MAX_ENTRIES + 1))
    assert_one_line(2, ["simulate", "many.yaml"], f"more than {MAX_ENTRIES} tables in a list", capsys)
    for kind in (0x90, Opcode.METADATA):  # an unknown one, and one that has something
        data = bytes(8) if kind == Opcode.METADATA else b""
        Path("many.mcap").write_bytes(MCAP0_MAGIC + (HEAD.pack(kind, len(data)) + data) * (MAX_OTHERS + 1))
        assert_one_line(2, ["analyze", "many.mcap"], f"more than {MAX_OTHERS} records beside messages", capsys)


@given(st.text())
def test_text_is_shown_as_characters_that_can_be_seen(text: str) -> None:
    shown = escaped(text)
    assert all(character.isprintable() or character in "\n\t" for character in shown)
    assert shown == text or not text.isprintable()
    assert len(shortened(shown * 100)) <= max(SCREEN, len(text))
    assert "\n" not in one_line(ValueError(text))


def test_names_steer_no_terminal(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Keys of YAML, errors of a user's code, names of files; long ones are cut."""
    monkeypatch.chdir(tmp_path)
    steer = "\x1b[2J\u202e"
    Path("key.yaml").write_text(f'"{json.dumps(steer)[1:-1]}": 1', encoding="utf-8")
    Path("long.yaml").write_text(f"system: {'x' * 100_000}")
    Path("own.py").write_text(f"raise ValueError({steer!r} + 100_000 * 'y')")
    for given_, said in (
        (["key.yaml"], r"\x1b[2J\u202e"),
        (["--set", f"scenario={steer}"], r"\x1b[2J\u202e"),
        (["long.yaml"], "xxx"),
        (["--set", "controllers=[{name: mine, policy: 'own.py:Mine'}]"], r"\x1b[2J\u202eyyy"),
    ):
        assert main(["simulate", *given_]) == 2
        errors = capsys.readouterr().err
        assert said in errors
        assert errors.removesuffix("\n").isprintable()
        assert len(errors) <= SCREEN + 20


OWN = """
import ctypes, os
class Own(BaseException): pass
class Damper:
    def __init__(self, spec): self.t = {made}
    {once}
    def step(self, t_s, y, age_s, fresh): return {step}
"""
RAISE = "(_ for _ in ()).throw(Own('own words'))"


@pytest.mark.parametrize(
    ("parts", "status", "said"),
    [
        ({"step": RAISE}, 1, "own.py:7: Own: own words, in step of mine at"),
        ({"made": RAISE}, 2, "own.py:5: Own: own words, as Damper was made"),
        ({"once": "once_a_tick = property(lambda self: 1 / 0)"}, 2, "ZeroDivisionError: division by zero, as Damper"),
        ({"step": "os._exit(0)"}, 1, "os._exit(0) called; allowed: an exception, in step of mine at"),
        ({"made": "os._exit(0)"}, 2, "os._exit(0) called; allowed: an exception, as Damper was made"),
        ({"step": "exit(0)"}, 1, "SystemExit: 0, in step of mine at"),
    ],
)
def test_code_of_ones_own_that_fails_is_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Any, parts: dict[str, str], status: int, said: str
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("own.py").write_text(OWN.format(**{"made": "0", "once": "", "step": "[0.0]", **parts}))
    command = ["simulate", "two_area_deployment", "--set", "controllers=[{name: mine, policy: 'own.py:Damper'}]"]
    assert_one_line(status, command, said, capsys)
    assert main([*command, "--verbose"]) == status
    errors = capsys.readouterr().err
    assert "Traceback" in errors
    assert said in errors.splitlines()[-1]


def test_system_that_is_none_is_refused_with_a_profile(capsys: pytest.CaptureFixture[str]) -> None:
    for value in ("5", "[1]", "true", "{name: [1]}"):
        command = ["simulate", "two_area_small", "--set", f"system={value}", "--set", "profile=deployment"]
        assert_one_line(2, command, "system", capsys)


def test_keys_are_not_quoted(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A file of keys that is damaged: what it holds stays in it."""
    file = tmp_path / "keys.yaml"
    assert main(["new", "key", str(file)]) == 0
    capsys.readouterr()
    text = file.read_text()
    key = text.partition("key: ")[2].split()[0]
    for broken in (text.replace(key, f"{key}0"), text.replace("key:", "kay:"), f"{key}: {key}", key):
        file.write_text(broken)
        assert main(["new", "key", str(file)]) == 2
        errors = capsys.readouterr().err
        assert key[:8] not in errors
        assert errors.count("\n") == 1


def test_files_are_opened_by_the_door_alone() -> None:
    assert outside(opens, FILES) == []


def test_terminal_is_written_to_by_the_door_alone() -> None:
    assert outside(speaks, SPEAKERS) == []


HANG = """
def hang():
    mutex, library = ctypes.create_string_buffer(64), ctypes.CDLL(None)
    library.pthread_mutex_lock(mutex)
    print("in", flush=True)
    library.pthread_mutex_lock(mutex)
"""


def test_library_that_hangs_does_not_hold_the_command(tmp_path: Path) -> None:
    """In C: no signal reaches Python until it comes back."""
    file = tmp_path / "own.py"
    file.write_text(OWN.format(made="0", once="", step="hang()") + HANG)
    command = ["simulate", "--set", f"controllers=[{{name: mine, policy: '{file}:Damper'}}]"]
    with subprocess.Popen(
        [sys.executable, "-m", "facts_damping", *command], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as popen:
        assert popen.stdout is not None
        assert popen.stdout.readline() == "in\n"
        time.sleep(0.3)  # until it hangs
        popen.send_signal(signal.SIGTERM)
        _, errors = popen.communicate(timeout=60)
    assert popen.returncode == 143
    assert errors == "facts-damping: interrupted; user code has not returned\n"
