"""An audit hook in the process of a controller: what it does that it may not ends the run with a sentence.

The kernel refuses most of it anyway (`confinement.py`); the hook says what was tried. Where the kernel has no Landlock,
the hook alone keeps files from being read.
"""

from __future__ import annotations

import ctypes
import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

from facts_damping.errors import one_line
from facts_damping_studies.score.isolation.readable import SYSTEM_FILES, Readable, within

if TYPE_CHECKING:
    from collections.abc import Callable
    from types import FrameType

CHANGES = os.O_ACCMODE | os.O_CREAT | os.O_TRUNC
CTYPES = str(Path(str(ctypes.__file__)).parent)
SILENT = ("/dev/null", "/proc/cpuinfo", "/proc/meminfo", "/proc/self/", "/sys/", "/etc/os-release")  # no sentence
# Beginnings of audit events, https://docs.python.org/3/library/audit_events.html, and what was done.
REFUSED = {
    "socket.": "opened a socket",
    **dict.fromkeys(("subprocess.Popen", "os.system", "os.exec", "os.posix_spawn", "os.spawn"), "started a program"),
    **dict.fromkeys(("os.fork", "pty.spawn"), "started a process"),
    "_thread.start_": "started a thread",
    **dict.fromkeys(("os.kill", "signal.pthread_kill"), "sent a signal"),
    **dict.fromkeys(
        (
            *("os.mkdir", "os.remove", "os.rename", "os.rmdir", "os.link", "os.symlink", "os.truncate", "os.chmod"),
            *("os.chown", "os.utime", "os.setxattr", "os.removexattr", "os.lockf", "fcntl.flock", "fcntl.lockf"),
        ),
        "changed files",
    ),
    **dict.fromkeys(("resource.setrlimit", "resource.prlimit"), "changed its limits"),
}
PROCESSES = "/proc/"  # which may be empty
NATIVE = "ctypes."  # events of calls of native code; libraries make them, too


def install(readable: Readable, native: bool, breach: Callable[[str], NoReturn]) -> Callable[[], list[str]]:
    """Add the hook to this process, for good.

    `native`: whether native code may be called, as of an FMU; `breach`: called with a sentence, does not return.
    Returns a function that tells which files beside the controller's it has read so far; no others from then on.
    """
    may_read, may_list, beginnings = _checks(readable, os.path.realpath)
    libraries, caller, text, exists = readable.libraries, _caller, one_line, os.path.exists
    real, beside, read, is_built = os.path.realpath, frozenset(readable.files), dict[str, None](), list[bool]()

    def refuse(event: str, arguments: tuple[Any, ...]) -> None:
        if event == "open":
            path, _, flags = arguments
            if isinstance(path, int) or path is None:
                return
            name = os.fsdecode(path)
            if name.startswith(SILENT):
                if flags & CHANGES or not may_read(name):
                    raise PermissionError(f"{name}: cannot be opened by a controller that is scored")
            elif flags & CHANGES:
                breach(f"opened {name} to write")
            elif not may_read(name) and (exists(name) or name.startswith(PROCESSES)):
                breach(f"opened {name}")
            elif real(name) in beside:
                if is_built and real(name) not in read:
                    breach(f"opened {name} after it was built")
                read[real(name)] = None
        elif event in ("os.listdir", "os.scandir"):
            if not isinstance(arguments[0], int) and not may_list(os.fsdecode(arguments[0] or ".")):
                raise PermissionError(f"{arguments[0]}: cannot be listed by a controller that is scored")
        elif event == "sqlite3.connect":
            breach(f"opened {text(Exception(arguments[0]))} to write")
        elif event.startswith(NATIVE):
            if not native and not within(caller(), libraries):
                breach(f"called native code: {event}")
        elif event.startswith(beginnings):
            what = next(what for beginning, what in REFUSED.items() if event.startswith(beginning))
            breach(f"{what}: {event}")

    sys.addaudithook(refuse)

    def built() -> list[str]:
        is_built.append(True)
        return [name for name in read if name not in SYSTEM_FILES]

    return built


def _checks(
    readable: Readable, real: Callable[[str], str]
) -> tuple[Callable[[str], bool], Callable[[str], bool], tuple[str, ...]]:
    """Whether a file may be read; whether a folder may be listed; beginnings of what is refused."""
    folders, files = (*readable.libraries, *readable.folders), frozenset(readable.files)
    listed = frozenset(readable.listed)

    def may_read(name: str) -> bool:
        path = real(name)
        return path in files or within(path, folders)

    def may_list(name: str) -> bool:
        path = real(name)
        return path in listed or within(path, folders)

    return may_read, may_list, tuple(REFUSED)


def _caller() -> str:
    """File of the code that caused an event of ctypes, outside of ctypes."""
    frame: FrameType | None = sys._getframe(2)  # noqa: SLF001 (below this function and the hook)
    while frame is not None and frame.f_code.co_filename.startswith(CTYPES):
        frame = frame.f_back
    return "" if frame is None else os.path.realpath(frame.f_code.co_filename)
