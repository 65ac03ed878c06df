"""What a terminal shows while a command works."""

from __future__ import annotations

import os
import pty
import subprocess
import sys
from typing import TYPE_CHECKING

import pytest

from facts_damping.case.loading import load_case
from facts_damping.cli.main import main
from facts_damping.digest import digest
from facts_damping.output.terminal import duration
from facts_damping.simulation import loop

if TYPE_CHECKING:
    from pathlib import Path

SILENT = "import time, facts_damping.output.terminal as t; t.SILENCE_S = 1.0\nwith t.busy_line('modes'): "
SLEEPS, SAYS = "time.sleep(2.5)", "time.sleep(2.5); t.clear_line(); print('done')"
COUNTS = "p = t.Progress('mine', 'runs'); p(1, 2); time.sleep(2.5); p.close()"
NOTES = "p = t.Progress('mine', 'runs'); p(1, 2); t.note('found'); p(2, 2); p.close()"


@pytest.fixture(scope="module")
def shown() -> dict[str, str]:
    """What programs write, where standard error is a terminal; all run at once."""
    running = {}
    for program in (SLEEPS, SAYS, COUNTS, NOTES):
        terminal, its_side = pty.openpty()
        started = subprocess.Popen([sys.executable, "-c", SILENT + program], stderr=its_side, stdout=its_side)
        os.close(its_side)
        running[program] = started, terminal
    texts = {}
    for program, (started, terminal) in running.items():
        assert started.wait(60) == 0
        with os.fdopen(terminal, "rb", buffering=0) as output:
            texts[program] = output.read(4096).decode().replace("\r\n", "\n")
    return texts


@pytest.mark.parametrize(("program", "last"), [(SLEEPS, "\r\x1b[K"), (SAYS, "\r\x1b[Kdone\n")])
def test_command_that_says_nothing_for_long_is_seen_to_work(shown: dict[str, str], program: str, last: str) -> None:
    """And nothing of that stays in what it says in the end."""
    assert "\rmodes: 1 s\x1b[K\rmodes: 2 s\x1b[K" in shown[program]
    assert shown[program].endswith(last)


def test_line_of_progress_is_kept_up_to_date(shown: dict[str, str]) -> None:
    lines = shown[COUNTS].split("\r")
    assert "1/2 runs, 0 s" in lines[1]
    assert "1/2 runs, 2 s" in lines[-1] or "1/2 runs, 3 s" in lines[-1]
    assert "modes" not in "".join(lines)


def test_note_replaces_the_line_of_progress(shown: dict[str, str]) -> None:
    first, second = shown[NOTES].split("\r\x1b[Kfound\n")
    assert ("1/2" in first, "2/2" in second) == (True, True)


def test_pipe_gets_no_such_line() -> None:
    done = subprocess.run([sys.executable, "-c", SILENT + SLEEPS], check=True, capture_output=True, text=True)
    assert (done.stdout, done.stderr) == ("", "")


def test_run_in_this_process_tells_its_ticks_and_keeps_its_bits() -> None:
    case = load_case("two_area_small", ["duration=1"])
    shown = list[tuple[int, int]]()
    record = loop.finish(case, loop.build_loop(case), lambda done, of: shown.append((done, of)))
    assert shown == [(done, 60) for done in range(12, 61, 12)]
    assert digest(record) == digest(loop.run(case))


@pytest.mark.parametrize(("step_s", "slow"), [(0.02, True), (0.0, False)])
def test_class_that_is_slower_than_a_frame_is_told_at_the_end(
    step_s: float, slow: bool, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = "import time\nclass Mine:\n    def __init__(self, spec): pass\n    def step(self, t_s, y, age_s, fresh):\n"
    (tmp_path / "mine.py").write_text(f"{text}        time.sleep({step_s})\n        return 0.0\n")
    sets = ["controllers.0.name=mine", f"controllers.0.policy={tmp_path / 'mine.py'}:Mine", "duration=0.5"]
    assert main(["simulate", "two_area_small", *(part for change in sets for part in ("--set", change))]) == 0
    (line,) = (line for line in capsys.readouterr().out.splitlines() if "steps of" in line)
    assert (": slower than a frame (16.7 ms); as a node in real time it would miss its deadlines" in line) == slow
    assert ("30 steps of 2" in line and " ms, 99 % within" in line) == slow


@pytest.mark.parametrize(
    ("seconds", "said"),
    [(41.6, "42 s"), (59.6, "1 min 0 s"), (200, "3 min 20 s"), (2729, "45 min"), (4860, "1 h 21 min")],
)
def test_times_are_said_as_people_say_them(seconds: float, said: str) -> None:
    assert duration(seconds) == said
