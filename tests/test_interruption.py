"""Interruptions of commands: exit status, one line, nothing left; at each stage of a process."""

from __future__ import annotations

import os
import re
import shlex
import signal
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import TYPE_CHECKING, NoReturn

import pytest

from facts_damping import interruption
from facts_damping.cli.main import main
from facts_damping.cli.parser import parser
from facts_damping.interruption import INTERRUPTIONS
from facts_damping.output.terminal import Progress
from facts_damping.output.writing import write_whole
from facts_damping.parameters import files
from facts_damping.recording.writer import RecordingWriter
from tests.studies.test_campaign import SMALL
from tests.studies.test_sweep import MANY, children, is_worker

if TYPE_CHECKING:
    from collections.abc import Iterator

CASES = str(Path(__file__).parent / "data" / "case_set.yaml")
CONTINUES = "; the same command continues the study: "
NOTHING = "; nothing is kept"
COMMANDS: dict[str, tuple[list[str], str]] = {
    "sweep": (["sweep", "sweep.yaml", "--jobs", "1"], CONTINUES),
    "campaign": (["campaign", "campaign.yaml", "--jobs", "1"], CONTINUES),
    "hunt": (["campaign", "campaign.yaml", "--hunt", "1", "--jobs", "1"], CONTINUES),
    "score": (["score", "LLC", "--against", "LLC", "--cases", CASES, "--jobs", "1"], NOTHING),
    "storm": (["storm", "--minutes", "1", "--jobs", "1"], "; kept in results/storms: 0 storms that broke a rule"),
    "tune": (["tune", "smib", "LLC-tuned", "--budget", "1", "--jobs", "1"], NOTHING),
    "search": (["search", "smib", "gaussian+sam", "--budget", "100", "--jobs", "1"], NOTHING),
    "design": (["design", "two_area", "--jobs", "1"], NOTHING),
    "margin": (["margin", "two_area_small"], NOTHING),
    "simulate": (["simulate", "two_area_small", "--out", "simulated"], NOTHING),
    "validate": (["validate"], NOTHING),
}  # and what they tell besides
EXAMPLES = {
    name: shlex.split(re.findall(rf"^  facts-damping ({name}\b.*)$", command.format_help(), re.MULTILINE)[0])
    for name, command in next(
        action.choices for action in parser()._actions if isinstance(action.choices, dict)
    ).items()
}  # the first of each command


@pytest.fixture
def default_handlers() -> Iterator[None]:
    """As at a terminal: where tests run in the background, these signals may be ignored."""
    before = {number: signal.signal(number, signal.SIG_DFL) for number in INTERRUPTIONS}
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


@pytest.mark.usefixtures("default_handlers")
@pytest.mark.parametrize("name", COMMANDS)
def test_interrupted_command_tells_one_line_and_its_signal(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    """At its first progress; twice, as when a process and its group get the signal."""
    number = INTERRUPTIONS[list(COMMANDS).index(name) % len(INTERRUPTIONS)]

    def leave(status: int) -> NoReturn:
        raise SystemExit(status)

    def interrupt(_progress: Progress, _done: int, _of: int) -> None:
        try:
            signal.raise_signal(number)
        finally:
            signal.raise_signal(number)

    monkeypatch.chdir(tmp_path)
    Path("sweep.yaml").write_text(MANY)
    Path("campaign.yaml").write_text(SMALL)
    monkeypatch.setattr(Progress, "__call__", interrupt)
    monkeypatch.setattr(interruption, "exit_now", leave)
    monkeypatch.setattr(interruption, "_at_leave", [])  # this process goes on
    command, holds = COMMANDS[name]
    try:
        status: int | str | None = main(command)
    except SystemExit as left:
        status = left.code
    assert status == 128 + number
    lines = [line for line in capfd.readouterr().err.splitlines() if "--budget" not in line]
    assert len(set(lines)) == 1, lines
    assert lines[0].startswith(f"facts-damping: interrupted{holds}")


@pytest.mark.usefixtures("default_handlers")
@pytest.mark.parametrize("name", EXAMPLES)
def test_each_command_tells_at_its_start_that_nothing_is_kept(
    name: str, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    def leave(status: int) -> NoReturn:
        raise SystemExit(status)

    monkeypatch.setattr(files, "check_writable", lambda *_: signal.raise_signal(signal.SIGINT))
    monkeypatch.setattr(interruption, "exit_now", leave)
    monkeypatch.setattr(interruption, "_at_leave", [])  # this process goes on
    with pytest.raises(SystemExit, match=str(128 + signal.SIGINT)):
        main(EXAMPLES[name])
    assert capfd.readouterr().err == f"facts-damping: interrupted{NOTHING}\n"


@pytest.mark.usefixtures("default_handlers")
def test_interrupted_command_names_the_files_that_it_has_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    """A recording is kept, too, if one was written; a file that has gone is not."""
    monkeypatch.chdir(tmp_path)
    with interruption.handled():
        interruption.tell(interruption.NOTHING)
        for name in "abcde":
            write_whole(Path(f"{name}.csv"), "1")
        Path("a.csv").unlink()
        assert interruption.text() == "interrupted; kept: b.csv, c.csv, d.csv and 1 more"
        RecordingWriter(tmp_path / "recording").close()
        assert interruption.text() == "interrupted; what was recorded by then is readable"


def ended(folder: Path, code: str, **environment: str) -> tuple[int, str]:
    """Status and errors of a module, in a file in a folder, that is named as the command line."""
    begin = "import os, signal, sys, time; sys.argv[0] = 'facts-damping'\n"
    (folder / "program.py").write_text(begin + code)
    popen = subprocess.run(
        [sys.executable, "-m", "program"],
        cwd=folder,
        capture_output=True,
        text=True,
        check=False,
        env={**os.environ, **environment},
        preexec_fn=lambda: [signal.signal(number, signal.SIG_DFL) for number in INTERRUPTIONS],
    )
    return popen.returncode, popen.stderr


def test_program_handles_signals_from_its_first_import_until_it_is_gone(tmp_path: Path) -> None:
    for number in INTERRUPTIONS:
        early = f"import facts_damping\nos.kill(os.getpid(), {number:d})\n"
        assert ended(tmp_path, early) == (128 + number, "facts-damping: interrupted\n")
    late = "import atexit\natexit.register(os.kill, os.getpid(), signal.SIGTERM)\n"
    assert ended(tmp_path, f"{late}from facts_damping.cli.main import main\nsys.exit(main(['list', 'links']))") == (
        0,
        "",
    )


def test_interruption_within_an_exec_keeps_its_status(tmp_path: Path) -> None:
    """As where a named tuple is made: Python itself would end as by SIGINT."""
    code = """
from facts_damping import interruption
with interruption.handled():
    interruption.clean_up_first()
    try:
        exec("signal.raise_signal(signal.SIGTERM)", globals())
    except KeyboardInterrupt:
        sys.exit(interruption.status())
"""
    assert ended(tmp_path, code) == (143, "")


def test_second_interruption_after_a_while_ends_a_command_that_cleans_up(tmp_path: Path) -> None:
    code = """
from facts_damping import interruption
interruption.AGAIN_S = 0.0
with interruption.handled():
    interruption.clean_up_first()
    try:
        os.kill(os.getpid(), signal.SIGTERM)
    except KeyboardInterrupt:
        os.kill(os.getpid(), signal.SIGINT)
"""
    assert ended(tmp_path, code) == (143, "facts-damping: interrupted twice\n")


def test_interruption_ends_a_fork_server_that_still_loads(tmp_path: Path) -> None:
    code = """
from facts_damping import interruption
from facts_damping.nodes.launching import forked
with interruption.handled():
    forked.load()
    os.kill(os.getpid(), signal.SIGTERM)
"""
    assert ended(tmp_path, code, TMPDIR=str(tmp_path)) == (143, "facts-damping: interrupted\n")
    assert not list(tmp_path.glob("pymp-*"))


POOL = """
import sys, time
from facts_damping import interruption
from facts_damping_studies.sweeps.pool import run_all
with interruption.handled():
    try:
        run_all(time.sleep, [0.0, 60.0, 60.0], 2, lambda done, _: done and print("runs", flush=True))
    except KeyboardInterrupt:
        sys.exit(interruption.status())
"""


def left_by(pid: int) -> list[str]:
    """Semaphores and folders that a pool of a process has in shared memory."""
    return [path.name for path in Path("/dev/shm").iterdir() if f"loky-{pid}-" in path.name or f"_{pid}_" in path.name]


def guarded(pid: int) -> bool:
    """Whether a process blocks or ignores what a terminal sends to all its processes."""
    status = dict(line.split(":\t", 1) for line in Path(f"/proc/{pid}/status").read_text().splitlines())
    mask = int(status["SigBlk"], 16) | int(status["SigIgn"], 16)
    return all(mask >> (number - 1) & 1 for number in (signal.SIGINT, signal.SIGHUP))


@pytest.mark.parametrize("number", [signal.SIGHUP, signal.SIGKILL])
def test_struck_pool_leaves_no_line_and_nothing_in_memory(number: signal.Signals) -> None:
    """By a terminal that closes, whose processes all get the signal; and killed."""
    with subprocess.Popen(
        [sys.executable, "-c", POOL],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        preexec_fn=lambda: signal.signal(signal.SIGHUP, signal.SIG_DFL),  # noqa: PLW1509
    ) as popen:
        assert popen.stdout is not None
        while not (guards := [guarded(pid) for pid in children(popen.pid) if is_worker(pid)]):
            time.sleep(0.01)
        assert all(guards)  # from the start
        assert popen.stdout.readline() == "runs\n"
        assert left_by(popen.pid)
        (os.kill if number == signal.SIGKILL else os.killpg)(popen.pid, number)
        _, errors = popen.communicate(timeout=60)  # its workers and trackers have closed their ends, too
    assert (popen.returncode, errors) == (-number if number == signal.SIGKILL else 128 + number, "")
    deadline = time.monotonic() + 60.0
    while left_by(popen.pid):
        assert time.monotonic() < deadline, left_by(popen.pid)
        time.sleep(0.05)


def test_tracker_is_started_by_several_threads_at_once() -> None:
    """As graphs of a campaign do; the environment is what it was."""

    class Slow:
        @staticmethod
        def ensure_running() -> None:
            time.sleep(0.005)

    before = os.environ.get("PYTHONWARNINGS")
    with ThreadPoolExecutor(8) as threads:
        list(threads.map(lambda _: interruption.ensure_tracker(Slow), range(16)))
    assert os.environ.get("PYTHONWARNINGS") == before
