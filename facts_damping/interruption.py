"""Interruptions of the command line: Ctrl-C, a plain kill, a terminal that closes.

While there is nothing to clean up, an interruption ends the process at once (`end_at_once`): an exception could be lost
inside Python itself, above all in an import. After `clean_up_first` it raises `KeyboardInterrupt`, once. This module is
imported before all others, so it imports little.
"""

from __future__ import annotations

import atexit
import os
import signal
import sys
import threading
from contextlib import contextmanager, suppress
from time import monotonic
from typing import TYPE_CHECKING, Any, NoReturn

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

exit_now = os._exit  # kept for contexts in which user code may not call it
INTERRUPTIONS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
CONTINUES = "the same command continues the study"  # what an interruption tells of a study
RECORDED = "what was recorded by then is readable"
NOTHING = "nothing is kept"
AGAIN_S = 2.0  # s after an interruption in which further ones are the same: a process and its group may both get it
PR_SET_PDEATHSIG = 1  # constant of prctl(2)

_came: list[tuple[int, float]] = []  # the interruption that is being handled: its number and time
_holds: list[str] = []  # what an interruption tells besides
_written: list[str] = []  # files that are complete
_at_leave: list[Callable[[], object]] = []
_starting_tracker = threading.Lock()  # several threads may start graphs at once


def status() -> int:
    """Exit status of the interruption that was raised: 128 and the number of its signal, as of a shell."""
    return 128 + (_came[0][0] if _came else signal.SIGINT)


def text(more: str = "") -> str:
    """What an interruption tells; `more`: what holds, instead of that of `tell`."""
    holds = [more] if more else _holds
    if holds == [NOTHING] and (files := [path for path in _written if os.access(path, os.F_OK)]):
        holds = [f"kept: {', '.join(files[:3])}{f' and {len(files) - 3} more' if len(files) > 3 else ''}"]
    return "; ".join(["interrupted", *holds])


def tell(holds: str) -> None:
    """What an interruption tells from here on; after `NOTHING`, the files that were `written` by then."""
    _holds[:] = [holds]


def written(path: str) -> None:
    """Count a file that is complete."""
    _written.append(path)


def heeded() -> list[signal.Signals]:
    """Interruptions that this process handles: all except SIGHUP if that is ignored, as after `nohup`."""
    ignored = signal.getsignal(signal.SIGHUP) is signal.SIG_IGN
    return [interruption for interruption in INTERRUPTIONS if interruption != signal.SIGHUP or not ignored]


def end_at_once(number: int, _frame: Any) -> None:
    """Handle an interruption by ending the process."""
    leave(text(), number)


def leave(reason: str, number: int) -> NoReturn:
    """End this process at once because of a signal, with a line of output."""
    for act in _at_leave:
        act()
    os.write(2, f"facts-damping: {reason}\n".encode())
    exit_now(128 + number)


def at_leave(act: Callable[[], object]) -> None:
    """Do something if this process ends at once because of a signal."""
    _at_leave.append(act)


def _raise_first(number: int, _frame: Any) -> None:
    """Handle an interruption by an exception; another one, some time later, ends the process at once."""
    if not _came:
        _came.append((number, monotonic()))
        raise KeyboardInterrupt
    if monotonic() - _came[0][1] > AGAIN_S:
        leave("interrupted twice", _came[0][0])


def clean_up_first(holds: str = "") -> None:
    """From here on interruptions raise an exception, because there is something to clean up or report.

    `holds`: what an interruption tells, such as where the command continues.
    """
    if threading.current_thread() is threading.main_thread():
        _holds[:] = [holds] if holds else _holds
        for number in INTERRUPTIONS:
            if signal.getsignal(number) is end_at_once:
                signal.signal(number, _raise_first)


@contextmanager
def handled() -> Iterator[None]:
    """Handle interruptions as the command line does. At the end of the program it is too late for them."""
    before = {number: signal.getsignal(number) for number in INTERRUPTIONS}
    _came.clear()
    _holds.clear()
    _written.clear()
    for number, handler in before.items():
        if handler != signal.SIG_IGN:
            signal.signal(number, end_at_once)
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, signal.SIG_IGN if handler is end_at_once else handler)


@contextmanager
def interruptions_held() -> Iterator[None]:
    """Delay interruptions until after the block."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    received: list[int] = []
    before = {number: signal.signal(number, lambda number, _: received.append(number)) for number in INTERRUPTIONS}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, signal.SIG_DFL if handler is None else handler)
        if received:
            signal.raise_signal(received[0])


@contextmanager
def blocked() -> Iterator[None]:
    """Delay interruptions until after the block, and in processes that are started in it until they unblock them.

    Those get the signals of a terminal, too, which must not end them before they can handle signals.
    """
    with interruptions_held():
        before = signal.pthread_sigmask(signal.SIG_BLOCK, INTERRUPTIONS)
        try:
            yield
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)


def ensure_tracker(module: Any) -> None:
    """Start the resource tracker of `multiprocessing` or a like library, such that it outlives an interruption.

    After the end of this process it removes what was left, without warnings.
    """
    name = "PYTHONWARNINGS"
    with _starting_tracker:
        before = os.environ.get(name)
        os.environ[name] = "ignore"
        try:
            with blocked():
                module.ensure_running()
        finally:
            del os.environ[name]
            os.environ.update({} if before is None else {name: before})


@contextmanager
def script_apart() -> Iterator[None]:
    """Prevent `multiprocessing` from running the caller's script again in each process that is started."""
    main = vars(sys.modules["__main__"])
    attributes = {name: value for name, value in main.items() if name in ("__file__", "__spec__")}
    main.update(dict.fromkeys(attributes))
    try:
        yield
    finally:
        main.update(attributes)


def tie_to_parent(number: int = signal.SIGTERM, parent: int | None = None) -> None:
    """Have the kernel send this process a signal when its parent ends for any reason.

    `parent`: its process number, if it may have ended by now; this process then ends.
    """
    import ctypes  # noqa: PLC0415 (few processes need it)

    ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, number)
    if parent is not None and os.getppid() != parent:
        exit_now(1)


def _is_program() -> bool:
    """Whether this process is the command line, rather than a script that uses the package."""
    if sys.argv[0] == "-m" and "-m" in sys.orig_argv:
        return sys.orig_argv[sys.orig_argv.index("-m") + 1] in ("facts_damping", "facts_damping.cli.main")
    return sys.argv[0].rpartition("/")[2] == "facts-damping"


def handle_early() -> None:
    """Handle interruptions of the command line while it is imported, and their status at its end."""
    if not _is_program():
        return
    atexit.register(_end_interrupted)  # first, so that it is called last
    for number in INTERRUPTIONS:
        if signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, end_at_once)


def _end_interrupted() -> None:
    """End with the right status: Python ends with that of SIGINT if the exception has passed an `exec` of a text."""
    if _came:
        for stream in (sys.stdout, sys.stderr):
            with suppress(OSError, ValueError):
                stream.flush()
        exit_now(status())
