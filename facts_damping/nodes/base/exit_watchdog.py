"""Ends a process whose middleware hangs at exit.

About once in fifty runs on a loaded machine, a destructor of Fast DDS 3.2 waits for ever (in
`ResourceEvent::unregister_timer`) while it holds Python's GIL, so neither Python code nor signal handlers run.
A POSIX timer then calls `_exit` in a thread of its own (POSIX.1-2017, timer_create with SIGEV_THREAD).
"""

from __future__ import annotations

import ctypes
import os
import time

SIGEV_THREAD = 2


class _Event(ctypes.Structure):
    """Action of a timer: sigevent of <signal.h>, 64 bytes."""

    _fields_ = (
        ("value", ctypes.c_void_p),
        ("signal", ctypes.c_int),
        ("notify", ctypes.c_int),
        ("function", ctypes.c_void_p),
        ("attributes", ctypes.c_void_p),
        ("room", ctypes.c_char * 32),
    )


class _Times(ctypes.Structure):
    """Time of a one-shot timer: itimerspec of <time.h>."""

    _fields_ = tuple((name, ctypes.c_long) for name in ("every_s", "every_ns", "after_s", "after_ns"))


def end_after(seconds: float, status: int) -> None:
    """End this process with exit status `status` after `seconds`, whatever it is doing. Raises `OSError`."""
    library = ctypes.CDLL(None, use_errno=True)
    exit_ = ctypes.cast(library._exit, ctypes.c_void_p)  # noqa: SLF001 (that is its name)
    event, timer = _Event(value=status, notify=SIGEV_THREAD, function=exit_), ctypes.c_void_p()
    whole, part = divmod(seconds, 1.0)
    times = _Times(after_s=int(whole), after_ns=int(part * 1e9))
    if library.timer_create(time.CLOCK_MONOTONIC, ctypes.byref(event), ctypes.byref(timer)) or library.timer_settime(
        timer, 0, ctypes.byref(times), None
    ):
        raise OSError(ctypes.get_errno(), os.strerror(ctypes.get_errno()))
