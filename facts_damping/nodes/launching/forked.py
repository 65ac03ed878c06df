"""Starts nodes as forks of a process that has all libraries loaded.

A node needs two seconds of processor time to load libraries and kernels, and a graph has five nodes or more. Here a
fork server loads them once, and each node is a fork of it: a process with its own DDS participant, as if started by
itself. The fork server never initialises ROS, so it holds nothing that must not be forked. It and its forks end with
the process that started them.
"""

from __future__ import annotations

import atexit
import importlib
import multiprocessing
import os
import shutil
import signal
import sys
from contextlib import suppress
from functools import cache
from multiprocessing import forkserver, resource_tracker, util
from threading import Lock, Thread
from typing import TYPE_CHECKING

from setproctitle import setproctitle

from facts_damping.interruption import (
    INTERRUPTIONS,
    at_leave,
    blocked,
    ensure_tracker,
    interruptions_held,
    script_apart,
)
from facts_damping.nodes.executables import module_of

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from multiprocessing.process import BaseProcess

LOADED = "facts_damping.nodes.launching.preload"
FOLDER = "FACTS_DAMPING_FORKED"  # environment variable: folder of the fork server's socket

_starting = Lock()  # several threads may start graphs at once


def load() -> None:
    """Start the fork server, which loads in the background; `start` waits for it."""
    multiprocessing.get_context("forkserver").set_forkserver_preload([LOADED])
    ensure_tracker(resource_tracker)  # first, as it unblocks signals when it starts
    with blocked():  # the caller handles these
        _clean_up_at_the_end()
        os.environ[FOLDER] = util.get_temp_dir()  # last: a kill before the fork server runs would leave the folder
        try:
            forkserver.ensure_running()
        finally:
            os.environ.pop(FOLDER, None)  # other processes that import the preload module do not own the folder


@cache
def _clean_up_at_the_end() -> None:
    atexit.register(_end)
    at_leave(_end)
    at_leave(lambda: shutil.rmtree(util.get_temp_dir(), ignore_errors=True))  # else by the library itself


def _end() -> None:
    """End the fork server, also while it still loads."""
    pid = getattr(forkserver, "_forkserver")._forkserver_pid  # noqa: B009, SLF001 (it has no other)
    if pid is not None:
        with suppress(ProcessLookupError):
            os.kill(pid, signal.SIGKILL)
        with suppress(ChildProcessError):
            os.waitpid(pid, 0)


def start(node: str, arguments: Sequence[str], environment: Mapping[str, str], output: str, errors: str) -> BaseProcess:
    """Start a node, given by its name, as a process in a session of its own.

    `output`, `errors`: existing files for standard output and error.
    """
    load()
    passed = (node, list(arguments), dict(environment), output, errors)
    process = multiprocessing.get_context("forkserver").Process(target=_run_node, args=passed, daemon=True)
    with _starting, script_apart(), interruptions_held():  # an interrupted start would print a traceback
        process.start()
    return process


def _end_with(asked: BaseProcess) -> None:
    """Send SIGTERM to this process when the process that asked for it has ended."""
    asked.join()
    os.kill(os.getpid(), signal.SIGTERM)


def _run_node(node: str, arguments: list[str], environment: dict[str, str], output: str, errors: str) -> None:
    """Turn this fork into a node and run it."""
    module = module_of(node)
    setproctitle(" ".join([module, *arguments]))  # uses memory of the old environment
    os.setsid()
    Thread(target=_end_with, args=(multiprocessing.parent_process(),), daemon=True).start()
    os.environ.clear()
    os.environ.update(environment)
    for stream, name in ((1, output), (2, errors)):
        try:
            file = os.open(name, os.O_WRONLY | os.O_APPEND)
        except OSError:  # the calling process has ended, and its files with it
            os._exit(1)
        os.dup2(file, stream)
        os.close(file)
    sys.argv = [node, *arguments]
    main = importlib.import_module(module).main
    importlib.import_module("facts_damping.nodes.base.spinner").stop_by_signals()
    signal.pthread_sigmask(signal.SIG_UNBLOCK, INTERRUPTIONS)
    main()
