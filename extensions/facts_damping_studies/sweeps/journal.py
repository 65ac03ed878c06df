"""The journal of finished runs: one line of JSON per run, appended at once, so that a killed sweep can continue."""

from __future__ import annotations

import errno
import fcntl
import json
import os
import time
import zlib
from typing import IO, TYPE_CHECKING, Any, Generic, TypeVar

from facts_damping.errors import InputError
from facts_damping.input_files import RECORDING, check_file
from facts_damping.output.writing import finite, naming
from facts_damping_studies.rows import Row

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping
    from pathlib import Path

    from typing_extensions import Self

CHECKSUM = b', "crc32": "%08x"}'  # end of a line: checksum of the rest of the line
SYNC_S = 1.0  # interval of flushing to disk: a kill loses no finished run, a power cut at most this interval

AnyRow = TypeVar("AnyRow", bound=Row)


class Journal(Generic[AnyRow]):
    """An append-only file of rows by key; the first line identifies the study, and each line has a checksum.

    Damaged lines, such as an incomplete last line of a killed process, are counted in `damaged` and ignored, so their
    runs are repeated. Raises `InputError` for the journal of another study, or one in use by another process.
    """

    def __init__(self, path: Path, study: str, read: Callable[[Mapping[str, Any]], AnyRow]) -> None:
        """Open the journal of a study, identified by its fingerprint, and read its rows."""
        self._row_of = read
        if path.exists():
            check_file(path, RECORDING)
        self._file: IO[bytes] = path.open("a+b")
        self._name = str(path)
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            self._file.close()
            raise InputError(f"--out {path.parent}: another sweep writes there; allowed: another folder") from error
        self.rows: dict[str, AnyRow] = {}
        self._synced = time.monotonic()
        self._read(study, path)

    def _read(self, study: str, path: Path) -> None:
        self._file.seek(0)
        content = self._file.read()
        parsed = [_parsed(line) for line in content.splitlines()]
        lines = [row for row in parsed if row is not None]
        self.damaged = len(parsed) - len(lines)
        if content and not content.endswith(b"\n"):
            self._file.write(b"\n")
        if not lines:
            self._write({"study": study})
        elif lines[0].get("study") != study:
            self._file.close()
            holds = "holds runs of another study, or of another version of it, its files or this package"
            raise InputError(f"--out {path.parent}: {holds}; allowed: a new folder")
        self.rows = {line["key"]: self._row_of(line["row"]) for line in lines if "key" in line and "row" in line}

    def append(self, key: str, row: AnyRow) -> None:
        """Append a row; the one kept in `rows` is that which is read again, without numbers that JSON lacks."""
        cells = finite(row.cells)
        self.rows[key] = self._row_of(cells)
        self._write({"key": key, "row": cells})

    def _write(self, content: dict[str, Any]) -> None:
        line = json.dumps(content, allow_nan=False).encode()
        with naming(self._name):
            if not os.fstat(self._file.fileno()).st_nlink:  # else all runs that follow would be lost
                raise FileNotFoundError(errno.ENOENT, "removed while the study runs")
            self._file.write(line[:-1] + CHECKSUM % zlib.crc32(line) + b"\n")
            self._file.flush()
            if time.monotonic() - self._synced > SYNC_S:
                os.fsync(self._file.fileno())
                self._synced = time.monotonic()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        """Close the file and release it for other processes."""
        with naming(self._name):
            os.fsync(self._file.fileno())
            self._file.close()


def _parsed(line: bytes) -> dict[str, Any] | None:
    """The content of a line; None if it is damaged."""
    body = line[: -len(CHECKSUM % 0)] + b"}"
    if line[len(body) - 1 :] != CHECKSUM % zlib.crc32(body):
        return None
    try:
        content = json.loads(body)
    except ValueError:
        return None
    return content if isinstance(content, dict) else None
