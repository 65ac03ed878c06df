"""The log of finished runs: a line of JSON each, appended as they come, so that a sweep that was killed goes on."""

from __future__ import annotations

import fcntl
import json
import os
import time
import zlib
from typing import IO, TYPE_CHECKING, Any

from facts_damping.errors import InputError
from facts_damping.input_files import RECORDING, check_file
from facts_damping.terminal import finite, naming

if TYPE_CHECKING:
    from pathlib import Path
    from types import TracebackType

    from typing_extensions import Self

CHECKSUM = b', "crc32": "%08x"}'  # how a line ends: that of the line without it
SYNC_S = 1.0  # so often the disk itself is waited for: a kill costs no finished run, a power cut a second's


class Journal:
    """An append-only file of rows by key; its first line names the study, and each line has a checksum.

    A damaged line, such as the torn last one of a process that was killed, is counted in `damaged` and left out: its
    run is made again. Raises `InputError` for the journal of another study, or one that another process writes.
    """

    def __init__(self, path: Path, study: str) -> None:
        """Open the journal of a study, by its fingerprint, and read what it holds."""
        if path.exists():
            check_file(path, RECORDING)
        self._file: IO[bytes] = path.open("a+b")
        self._name = str(path)
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            self._file.close()
            raise InputError(f"--out {path.parent}: another sweep writes there; allowed: another folder") from error
        self.rows: dict[str, dict[str, Any]] = {}
        self._synced = time.monotonic()
        self._read(study, path)

    def _read(self, study: str, path: Path) -> None:
        self._file.seek(0)
        content = self._file.read()
        parsed = [_parsed(line) for line in content.splitlines()]
        lines = [one for one in parsed if one is not None]
        self.damaged = len(parsed) - len(lines)
        if content and not content.endswith(b"\n"):
            self._file.write(b"\n")
        if not lines:
            self._write({"study": study})
        elif lines[0].get("study") != study:
            self._file.close()
            raise InputError(
                f"--out {path.parent}: holds runs of another study, or of one before it, its files or this "
                "package was changed; allowed: a new folder"
            )
        self.rows = {one["key"]: one["row"] for one in lines if "key" in one and "row" in one}

    def append(self, key: str, row: dict[str, Any]) -> None:
        """Keep a row."""
        row = finite(row)
        self.rows[key] = row
        self._write({"key": key, "row": row})

    def _write(self, content: dict[str, Any]) -> None:
        line = json.dumps(content, allow_nan=False).encode()
        with naming(self._name):
            self._file.write(line[:-1] + CHECKSUM % zlib.crc32(line) + b"\n")
            self._file.flush()
            if time.monotonic() - self._synced > SYNC_S:
                os.fsync(self._file.fileno())
                self._synced = time.monotonic()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Close it; others may write then."""
        with naming(self._name):
            os.fsync(self._file.fileno())
            self._file.close()


def _parsed(line: bytes) -> dict[str, Any] | None:
    """A line's content; None for a damaged one."""
    body = line[: -len(CHECKSUM % 0)] + b"}"
    if line[len(body) - 1 :] != CHECKSUM % zlib.crc32(body):
        return None
    try:
        content = json.loads(body)
    except ValueError:
        return None
    return content if isinstance(content, dict) else None
