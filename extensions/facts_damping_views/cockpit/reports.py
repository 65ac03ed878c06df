"""Reports of what is recorded so far, by processes of their own, one at a time."""

from __future__ import annotations

import asyncio
import os
import subprocess
import sys
import tempfile
from collections import Counter
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from facts_damping.input_files import read_bytes

if TYPE_CHECKING:
    from collections.abc import Coroutine

T = TypeVar("T")
REPORT_S = 300.0  # longest time for a report
REPORT_BYTES = 100_000_000  # longest report

Report = tuple[bytes | None, str]  # the page, or why there is none


def folder_of(folder: Path, number: int) -> Path:
    """Folder of a run that starts again and again: `number` counts from 1."""
    return folder if number == 1 else folder / f"run_{number}"


def recording(first: str, number: int) -> str:
    """Recording of a run that starts again and again; `first`: that of the first time."""
    path = Path(first)
    return str(folder_of(path.parent, number) / path.name)


class Reports:
    """Computes one report at a time. Who asks for one that is being computed shares it; it ends when all have gone."""

    def __init__(self) -> None:
        self._turn = asyncio.Lock()
        self._tasks: dict[str, asyncio.Task[Report]] = {}  # by recording
        self._waiting = Counter[str]()  # clients, by recording

    async def get(self, recording: str) -> Report:
        """The page of a recording, or why there is none. Raises `InputError` if it is too long."""
        if recording not in self._tasks:
            self._tasks[recording] = asyncio.create_task(self._in_turn(recording))
        self._waiting[recording] += 1
        try:
            return await asyncio.shield(self._tasks[recording])
        finally:
            self._waiting[recording] -= 1
            if not self._waiting[recording]:
                self._tasks.pop(recording).cancel()

    async def _in_turn(self, recording: str) -> Report:
        async with self._turn:
            return await report(recording)


async def while_there(request: Any, work: Coroutine[Any, Any, T]) -> T | None:
    """The result of work for a client. If the client goes away, the work is cancelled; then None."""
    tasks = asyncio.ensure_future(work), asyncio.ensure_future(_gone(request))
    try:
        await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
        return tasks[0].result() if tasks[0].done() else None
    finally:
        for task in tasks:
            task.cancel()


async def _gone(request: Any) -> None:
    while (await request.receive())["type"] != "http.disconnect":
        pass


async def report(recording: str) -> Report:
    """The page of `facts-damping analyze RECORDING --report` for what is recorded so far, or why there is none.

    If it is cancelled, nothing is left of it.
    """
    with tempfile.TemporaryDirectory() as folder:
        page = Path(folder) / "report.html"
        process = _begin("analyze", recording, "--report", str(page), "--out", folder)
        try:
            _, errors = await asyncio.to_thread(process.communicate, timeout=REPORT_S)
        except subprocess.TimeoutExpired:
            return None, f"report: not done within {REPORT_S:g} s"
        finally:  # waits for its end right here: when the server ends, all that is awaited is cancelled
            process.kill()
            process.wait()
        if page.is_file():
            return read_bytes(page, REPORT_BYTES), ""
        return None, errors.decode(errors="replace").strip().rpartition("\n")[2]


def _begin(*arguments: str) -> subprocess.Popen[bytes]:
    """Start a command of this package, which leaves the processors to others."""
    command, null = [sys.executable, "-m", "facts_damping", *arguments], subprocess.DEVNULL
    process = subprocess.Popen(command, stdin=null, stdout=null, stderr=subprocess.PIPE)
    with suppress(OSError):  # it may have ended
        os.setpriority(os.PRIO_PROCESS, process.pid, 10)
    return process
