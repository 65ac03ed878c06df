"""All files that users name are read here, with checks.

A file must be regular and of limited size, also when unpacked. Only a command line, or a file named there, may name
files; those named by recordings, messages, services and parameters are never opened (`naming_no_files`).
"""

from __future__ import annotations

import os
import stat
from contextlib import contextmanager
from contextvars import ContextVar
from functools import cache
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING
from zipfile import ZipFile

from facts_damping.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Iterator

TEXT = 10_000_000  # bytes of a YAML file, table, program or matrices
MATRICES = 100_000_000  # bytes of unpacked matrices
GRID = 50_000_000  # bytes of another program's grid
FMU, FMU_UNPACKED = 500_000_000, 2_000_000_000
RECORDING = 4_000_000_000
KINDS = {
    stat.S_IFDIR: "a folder",
    stat.S_IFIFO: "a pipe",
    stat.S_IFSOCK: "a socket",
    stat.S_IFCHR: "a device",
    stat.S_IFBLK: "a device",
}

_others: ContextVar[str | None] = ContextVar("_others", default=None)  # source of file names now, if not the user
_opened: set[Path] = set()  # files that this process has read for the user


@cache
def share_folder() -> Path:
    """Folder that holds `config`: a checkout, or `share/facts_damping` of an installation."""
    for parent in Path(__file__).resolve().parents:
        for folder in (parent, parent / "share" / "facts_damping"):
            if (folder / "package.xml").is_file() and (folder / "config").is_dir():
                return folder
    raise InputError(
        f"no config folder found above {Path(__file__).resolve().parent}; allowed: a checkout or an installation"
    )


@contextmanager
def naming_no_files(who: str) -> Iterator[None]:
    """In the block, file names come from others than the user: only shipped files are opened.

    Files read before may be read again. `who`: name of the source in errors.
    """
    before = _others.set(who)
    try:
        yield
    finally:
        _others.reset(before)


def is_file(path: Path, allowed: str = "a file") -> bool:
    """Whether there is a file. Raises `InputError` for anything else, and if the source of the name may not open files.

    `allowed`: what may be given, for the error.
    """
    _check_named(path)
    try:
        _check_kind(path, path.stat(), maximum=None, allowed=allowed)
    except (FileNotFoundError, NotADirectoryError, ValueError):  # ValueError: a name that no file can have
        return False
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}; allowed: {allowed}") from error
    return True


def read_bytes(path: Path, maximum: int = TEXT) -> bytes:
    """Content of a file of at most `maximum` bytes. Raises `InputError`."""
    flags = os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC
    check_file(path, maximum)  # a folder cannot be opened below
    with _opening(path), os.fdopen(os.open(path, flags), "rb") as file:
        about = os.fstat(file.fileno())
        _check_kind(path, about, maximum)
        content = file.read(about.st_size or min(maximum, TEXT) + 1)  # files of the kernel have no size
        if len(content) > maximum:
            raise InputError(f"{path}: more than {maximum} bytes; allowed: at most {maximum}")
    return content


def read_text(path: Path, maximum: int = TEXT, errors: str = "strict") -> str:
    """UTF-8 text of a file; `errors`: as for `bytes.decode`. Raises `InputError`."""
    try:
        return read_bytes(path, maximum).decode("utf-8", errors).replace("\r\n", "\n")
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: cannot be read: {error.reason} at byte {error.start}; allowed: UTF-8") from error


def check_file(path: Path, maximum: int) -> None:
    """Raise `InputError` if a library may not open a file: by source of the name, kind, or size."""
    with _opening(path):
        _check_kind(path, path.stat(), maximum)


def check_unpacked(path: Path, content: bytes, maximum: int) -> None:
    """Raise `InputError` for a ZIP archive (NPZ, FMU) of more than `maximum` bytes unpacked."""
    with ZipFile(BytesIO(content)) as archive:
        size = sum(member.file_size for member in archive.infolist())
    if size > maximum:
        raise InputError(f"{path}: more than {maximum} bytes unpacked; allowed: at most {maximum}")


@contextmanager
def _opening(path: Path) -> Iterator[None]:
    """Open a file within the block; later it may be opened again. Raises `InputError` where it may not or cannot be."""
    _check_named(path)
    try:
        yield
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}; allowed: a file that can be read") from error
    if _others.get() is None:
        _opened.add(_place(path))


def _place(path: Path) -> Path:
    return Path(os.path.normpath(path.absolute()))


def _check_named(path: Path) -> None:
    """Raise `InputError` if the source of the name may not open the file."""
    who = _others.get()
    if who is None or (place := _place(path)) in _opened or share_folder() / "config" in place.parents:
        return
    raise InputError(f"{path}: named by {who}, which may open no file; allowed: its content")


def _check_kind(path: Path, about: os.stat_result, maximum: int | None, allowed: str = "a file") -> None:
    if not stat.S_ISREG(about.st_mode):
        raise InputError(f"{path}: {KINDS.get(stat.S_IFMT(about.st_mode), 'no file')} given; allowed: {allowed}")
    if maximum is not None and about.st_size > maximum:
        raise InputError(f"{path}: {about.st_size} bytes; allowed: at most {maximum}")
