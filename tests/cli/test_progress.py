"""What a terminal shows while a command works."""

from __future__ import annotations

import os
import pty
import subprocess
import sys

import pytest

SILENT = "import time, facts_damping.terminal as t; t.SILENCE_S = 1.0\nwith t.at_work('modes'): "
SLEEPS, SAYS = "time.sleep(2.5)", "time.sleep(2.5); t.clear_line(); print('done')"
COUNTS = "p = t.Progress('mine', 'runs'); p(1, 2); time.sleep(2.5); p.close()"


def shown(program: str) -> str:
    """What a program writes, where standard error is a terminal."""
    terminal, its_side = pty.openpty()
    done = subprocess.run(
        [sys.executable, "-c", SILENT + program], check=True, stderr=its_side, stdout=its_side, timeout=60
    )
    os.close(its_side)
    assert done.returncode == 0
    with os.fdopen(terminal, "rb", buffering=0) as told:
        text = told.read(4096).decode()
    return text.replace("\r\n", "\n")


@pytest.mark.parametrize(("program", "last"), [(SLEEPS, "\r\x1b[K"), (SAYS, "\r\x1b[Kdone\n")])
def test_a_command_that_says_nothing_for_long_is_seen_to_work(program: str, last: str) -> None:
    """And nothing of that stays in what it says in the end."""
    text = shown(program)
    assert "\rmodes: 1 s\x1b[K\rmodes: 2 s\x1b[K" in text
    assert text.endswith(last)


def test_a_line_of_progress_is_kept_up_to_date() -> None:
    lines = shown(COUNTS).split("\r")
    assert "1/2 runs, 0 s" in lines[1]
    assert "1/2 runs, 2 s" in lines[-1] or "1/2 runs, 3 s" in lines[-1]
    assert "modes" not in "".join(lines)


def test_a_pipe_gets_no_such_line() -> None:
    done = subprocess.run([sys.executable, "-c", SILENT + SLEEPS], check=True, capture_output=True, text=True)
    assert (done.stdout, done.stderr) == ("", "")
