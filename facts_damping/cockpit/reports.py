"""Reports of what is recorded so far, by processes of their own."""

from __future__ import annotations

import asyncio
import os
import sys
import tempfile
from contextlib import suppress
from pathlib import Path

from facts_damping.input_files import read_bytes

REPORT_S = 300.0  # longest time for a report
REPORT_BYTES = 100_000_000  # longest report


async def report(recording: str) -> tuple[bytes | None, str]:
    """The page of `facts-damping analyze RECORDING --report` for what is recorded so far, or why there is none."""
    with tempfile.TemporaryDirectory() as folder:
        page = Path(folder) / "report.html"
        command = [
            *(sys.executable, "-m", "facts_damping", "analyze", recording),
            "--report",
            str(page),
            "--out",
            folder,
        ]
        process = await asyncio.create_subprocess_exec(
            *command,
            stdin=asyncio.subprocess.DEVNULL,
            stdout=asyncio.subprocess.DEVNULL,
            stderr=asyncio.subprocess.PIPE,
        )
        with suppress(OSError):  # it may have ended
            os.setpriority(os.PRIO_PROCESS, process.pid, 10)
        try:
            _, errors = await asyncio.wait_for(process.communicate(), REPORT_S)
        except asyncio.TimeoutError:
            process.kill()
            await process.wait()
            return None, f"report: not done within {REPORT_S:g} s"
        if page.is_file():
            return read_bytes(page, REPORT_BYTES), ""
        return None, errors.decode(errors="replace").strip().rpartition("\n")[2]
