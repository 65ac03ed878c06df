"""User's own code: found by name and run; its errors become one line."""

from __future__ import annotations

import hashlib
import importlib
import inspect
import os
import signal
import sys
import threading
import time
import traceback
from contextlib import contextmanager, suppress
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any

from facts_damping.errors import InputError, one_line
from facts_damping.extensions import given
from facts_damping.input_files import is_file, read_bytes
from facts_damping.interruption import exit_now, heeded, leave

if TYPE_CHECKING:
    from collections.abc import Iterator

PATIENCE_S = 2.0  # wall time

_loaded: dict[Path, tuple[int, Any]] = {}  # modules of files that were run, with the files' time of change


def find(text: str, where: str) -> Any:
    """The class that a text names. Raises `InputError` if there is none."""
    place, colon, name = text.rpartition(":")
    if not colon:
        known = given("policies")
        if text not in known:
            others = ", ".join(["module:Class", "path/to/file.py:Class", *known])
            raise InputError(f"{where}: '{text}' given; allowed: {others}")
        place, _, name = known[text].value.rpartition(":")
    if place.endswith(".py") and not is_file(Path(place)):
        raise InputError(f"{where}: {place}: no such file; allowed: a file in Python with the class")
    with users(where, place, f"as {place} was loaded"), _importable(Path.cwd()):
        module = _run_file(Path(place)) if place.endswith(".py") else importlib.import_module(place)
    policy_class = getattr(module, name, None)
    if not isinstance(policy_class, type):
        classes = [key for key, value in vars(module).items() if isinstance(value, type) and hasattr(value, "step")]
        raise InputError(f"{where}: no class '{name}' in {place}; allowed: {', '.join(classes) or 'one with a step'}")
    return policy_class


@contextmanager
def users(where: str, file: str, when: str) -> Iterator[None]:
    """Context for running user code of a file: any error is raised as `InputError`."""
    try:
        with running:
            yield
    except (InputError, KeyboardInterrupt):
        raise
    except BaseException as error:
        raise InputError(f"{where}: {described(error, file)}, {when}") from error


class _Running:
    """Context in which user code runs: the code cannot end the process or keep it from ending.

    `os._exit` raises an error, so that a run does not appear complete; in a process forked meanwhile it works as usual.
    If the same call has not returned `PATIENCE_S` after an interruption, for example in a library that hangs, the
    process ends with one line.
    """

    def __init__(self) -> None:
        self._process, self._calls, self.watched, self._since = 0, 0, False, 0

    def __enter__(self) -> None:
        if not self.watched and threading.current_thread() is threading.main_thread():
            self.watched = True
            self._watch()
        self._process = os.getpid()
        self._calls += 1
        self._since = self._calls
        os._exit = self._refuse  # type: ignore[assignment]

    def __exit__(self, *_: object) -> None:
        os._exit = exit_now
        self._since = 0

    def _refuse(self, status: int) -> None:
        if os.getpid() != self._process:
            exit_now(status)
        raise RuntimeError(f"os._exit({status}) called; allowed: an exception")

    def _watch(self) -> None:
        read, write = os.pipe()
        os.set_blocking(write, False)
        before = signal.set_wakeup_fd(write, warn_on_full_buffer=False)
        if before >= 0:  # somebody else's, as of asyncio in a notebook: it stays
            signal.set_wakeup_fd(before)
            for end in (read, write):
                os.close(end)
            return
        threading.Thread(target=self._end_what_hangs, args=(read,), daemon=True).start()

    def _end_what_hangs(self, interrupts: int) -> None:
        while number := os.read(interrupts, 1):
            call = self._since
            if number[0] not in heeded() or not call:
                continue
            time.sleep(PATIENCE_S)
            if self._since == call:
                leave("interrupted; user code has not returned", number[0])


running = _Running()


@contextmanager
def _importable(folder: Path) -> Iterator[None]:
    """Allow imports of modules in a folder, as for a script in that folder."""
    sys.path.insert(0, str(folder))
    try:
        yield
    finally:
        with suppress(ValueError):  # user code may have changed it, too
            sys.path.remove(str(folder))


def _run_file(path: Path) -> Any:
    """A file as a module: run once, and again after it changes; the running script itself is not run again."""
    whole = path.resolve()
    script = sys.modules["__main__"]
    if getattr(script, "__file__", None) and Path(str(script.__file__)).resolve() == whole:
        return script
    written = whole.stat().st_mtime_ns
    if _loaded.get(whole, (None,))[0] != written:
        name = f"policy_{whole.stem}_{hashlib.sha256(os.fsencode(whole)).hexdigest()[:8]}"
        module = ModuleType(name)
        module.__file__ = str(whole)
        sys.modules[name] = module
        with _importable(whole.parent):  # compiled here: Python's own cache compares only size and whole seconds
            exec(compile(read_bytes(whole), str(whole), "exec"), vars(module))  # noqa: S102 (the user's own)
        _loaded[whole] = (written, module)
    return _loaded[whole][1]


def file_of(member: Any) -> str:
    """The file of a class; empty if it has none, such as a compiled one."""
    try:
        return inspect.getsourcefile(member) or ""
    except TypeError:
        return ""


def described(error: BaseException, file: str) -> str:
    """An error of user code in one line, with the line of code that raised it."""
    frames = traceback.extract_tb(error.__traceback__)
    user_frames = [frame for frame in frames if file and Path(frame.filename).name == Path(file).name]
    if isinstance(error, SyntaxError) and error.filename:
        at = f"{Path(error.filename).name}:{error.lineno}: "
    else:
        at = f"{Path(user_frames[-1].filename).name}:{user_frames[-1].lineno}: " if user_frames else ""
    return ": ".join(filter(None, [f"{at}{type(error).__name__}", one_line(error)]))
