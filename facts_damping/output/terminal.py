"""Lines on the terminal, also of progress."""

from __future__ import annotations

import errno
import os
import sys
import threading
import time
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING, ClassVar

from facts_damping.errors import one_line
from facts_damping.escaping import escaped, shortened

if TYPE_CHECKING:
    from collections.abc import Iterator

    from typing_extensions import Self

SILENCE_S = 1.0  # s; a busy line appears after this time without output


def duration(seconds: float) -> str:
    """A duration as text: 42 s, 3 min 20 s, 1 h 21 min."""
    whole = round(seconds)
    if whole < 60:
        return f"{whole} s"
    minutes, rest = divmod(whole, 60)
    if minutes < 10:
        return f"{minutes} min {rest} s"
    minutes = round(whole / 60)
    return f"{minutes} min" if minutes < 60 else f"{minutes // 60} h {minutes % 60} min"


class Progress:
    """A progress line on standard error, if that is a terminal."""

    shown: ClassVar[Progress | None] = None  # the progress line now on the terminal

    def __init__(self, label: str, unit: str = "ticks", *, shown: bool = True) -> None:
        self._label, self._unit, self._shown = escaped(label), unit, shown and _on_terminal()
        self._began, self._before, self._done, self._of = time.monotonic(), 0, 0, 1

    def __call__(self, done: int, of: int) -> None:
        """Show the progress."""
        self._done, self._of = done, of
        if self._shown:
            Progress.shown = self
            complain(str(self))

    def __str__(self) -> str:
        """The line."""
        elapsed, done, of = time.monotonic() - self._began, self._done, self._of
        bar = "#" * (30 * done // of)
        left = elapsed * (of - done) / (done - self._before) if done > self._before else 0.0
        rest = f", {duration(left)} left" if left >= 1.0 else ""
        return f"\r{self._label} [{bar:<30}] {done}/{of} {self._unit}, {duration(elapsed)}{rest}\033[K"

    def resume(self, done: int) -> None:
        """Set the number done before this start, which does not count in the estimate of remaining time."""
        self._before = done

    def __enter__(self) -> Self:
        """Return the progress, which the end of the block closes."""
        return self

    def __exit__(self, *_: object) -> None:
        """End the line."""
        self.close()

    def close(self) -> None:
        """End the line."""
        if Progress.shown is self:
            Progress.shown = None
            complain("\n")


def put(text: str, *, flush: bool = False) -> None:
    """Write to standard output. Raises OSError, also if the user's code has closed or replaced it."""
    try:
        sys.stdout.write(text)
        if flush:
            sys.stdout.flush()
    except OSError:
        raise
    except Exception as error:
        reason = f"closed, or replaced by code of the user ({one_line(error)})"
        raise OSError(errno.EBADF, reason, "standard output") from error


def complain(text: str) -> None:
    """Write to standard error; where the user's code has closed or replaced it, to its file, if that is open."""
    try:
        sys.stderr.write(text)
        sys.stderr.flush()
    except Exception:  # noqa: BLE001 (of what replaces it)
        with suppress(OSError):
            os.write(2, text.encode())


def _on_terminal() -> bool:
    """Whether standard error is a terminal; not if the user's code has closed or replaced it."""
    try:
        return sys.stderr.isatty()
    except Exception:  # noqa: BLE001 (as above)
        return False


def show(text: str) -> None:
    """Print lines on standard output; text from outside cannot control the terminal."""
    clear_line()
    put(escaped(text) + "\n")


def note(text: str) -> None:
    """Print a line of limited length on standard error."""
    clear_line()
    complain(shortened(escaped(text)) + "\n")


_waiting = threading.Event()  # a busy line is shown


@contextmanager
def busy_line(name: str) -> Iterator[None]:
    """Show a line on the terminal after `SILENCE_S` without output, and keep a progress line current.

    The line bypasses `sys.stderr`, whose lock a command may hold.
    """
    began, over = time.monotonic(), threading.Event()

    def refresh() -> None:
        while not over.wait(0.5):
            elapsed, line = time.monotonic() - began, Progress.shown
            if line is not None:
                os.write(2, str(line).encode())
            elif elapsed >= SILENCE_S:
                _waiting.set()
                os.write(2, f"\r{name}: {duration(elapsed)}\033[K".encode())

    if not _on_terminal():
        yield
        return
    thread = threading.Thread(target=refresh, daemon=True)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join()
        clear_line()


def clear_line() -> None:
    """Remove the line of `busy_line`, or of a progress, before other output."""
    if _waiting.is_set() or Progress.shown is not None:
        _waiting.clear()
        with suppress(OSError):
            os.write(2, b"\r\033[K")
