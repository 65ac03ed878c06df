"""Programs in processes of their own, which a crash or a missing library of one does not harm."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any, NamedTuple

from facts_damping.errors import RunError
from facts_damping.interruption import tie_to_parent

if TYPE_CHECKING:
    from collections.abc import Iterator

# One thread for each program: what is compared is the work, and a machine may have few cores.
THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")
WORKER = "facts_damping_bench.worker"


def end_with_parent(parent: int) -> None:
    """Make this process end when the one that started it does, and leave an interrupt to that one."""
    tie_to_parent(signal.SIGKILL, parent)
    signal.signal(signal.SIGINT, signal.SIG_IGN)


class Session(NamedTuple):
    """A program's process, and the file that takes what it prints."""

    process: subprocess.Popen[str]
    log: Path

    def read(self) -> dict[str, Any]:
        """The next answer. Raises `RunError` where the program failed or its process died."""
        assert self.process.stdout is not None  # noqa: S101 (it is a pipe)
        line = self.process.stdout.readline()
        if not line:
            code = self.process.wait()
            said = [log_line for log_line in self.log.read_text(errors="replace").splitlines() if log_line.strip()]
            raise RunError(f"its process ended with {code}: {said[-1].strip() if said else 'it said nothing'}")
        answer: dict[str, Any] = json.loads(line)
        if "error" in answer:
            raise RunError(answer["error"])
        return answer

    def ask(self, step: float, load: float = 1.0, **more: Any) -> dict[str, Any]:
        """One run with a step (s), the load at B7 scaled."""
        assert self.process.stdin is not None  # noqa: S101 (it is a pipe)
        try:
            self.process.stdin.write(json.dumps({"step": step, "load": load, "more": more}) + "\n")
            self.process.stdin.flush()
        except BrokenPipeError:
            pass  # what it died of is read below
        return self.read()


@contextmanager
def session(module: str) -> Iterator[Session]:
    """A program that gets ready: its first answer says when it is. It is ended with the block."""
    with TemporaryDirectory(prefix="bench-") as folder:
        log = Path(folder) / "log"
        command = [sys.executable, "-m", WORKER, module, folder, str(os.getpid())]
        with log.open("w") as stream:
            process = subprocess.Popen(
                command,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=stream,
                text=True,
                cwd=folder,
                env={**os.environ, **dict.fromkeys(THREADS, "1")},
            )
        try:
            yield Session(process, log)
        finally:
            process.kill()
            process.communicate()
