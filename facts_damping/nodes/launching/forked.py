"""Nodes as copies of a process that has everything loaded.

A node by itself takes two seconds of processor time to load libraries and kernels, and a graph has five nodes or more.
Here one process loads them once, whatever it is asked for later, and each node is a fork of it: a process with its own
DDS participant, as if it had been started by itself. The process that loads never starts ROS, so it has nothing that
must not be copied. It and its copies end with the process that asked for them.
"""

from __future__ import annotations

import importlib
import multiprocessing
import os
import signal
import sys
from multiprocessing import forkserver, resource_tracker, util
from threading import Lock, Thread
from typing import TYPE_CHECKING

from setproctitle import setproctitle

from facts_damping.terminal import INTERRUPTIONS, interruptions_held, script_apart

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from multiprocessing.process import BaseProcess

LOADED = "facts_damping.nodes.launching.preload"
FOLDER = "FACTS_DAMPING_FORKED"  # variable that names the folder of the socket by which copies are asked for

_starting = Lock()  # several graphs may be started at once, each by a thread


def load() -> None:
    """Begin to load, in the background; `start` waits for it."""
    multiprocessing.get_context("forkserver").set_forkserver_preload([LOADED])
    resource_tracker.ensure_running()  # which lets signals through again when it has begun
    before = signal.pthread_sigmask(signal.SIG_BLOCK, INTERRUPTIONS)  # these are the caller's to answer
    os.environ[FOLDER] = util.get_temp_dir()  # last: until the process that loads runs, a kill would leave it
    try:
        forkserver.ensure_running()
    finally:
        os.environ.pop(FOLDER, None)  # other processes that load the same do not own the folder
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def start(
    module: str, arguments: Sequence[str], environment: Mapping[str, str], output: str, errors: str
) -> BaseProcess:
    """Start a node, by its module in this package, as a process of a session of its own.

    `output`, `errors`: files that take what it says.
    """
    load()
    given = (module, list(arguments), dict(environment), output, errors)
    process = multiprocessing.get_context("forkserver").Process(target=_be, args=given, daemon=True)
    with _starting, script_apart(), interruptions_held():  # half a start would say so at length
        process.start()
    return process


def _end_with(asked: BaseProcess) -> None:
    """End as if told to, when the process that asked for this one has ended."""
    asked.join()
    os.kill(os.getpid(), signal.SIGTERM)


def _be(module: str, arguments: list[str], environment: dict[str, str], output: str, errors: str) -> None:
    """Be a node from now on."""
    setproctitle(" ".join([f"facts_damping.nodes.{module}", *arguments]))  # before the environment, where it has room
    os.setsid()
    Thread(target=_end_with, args=(multiprocessing.parent_process(),), daemon=True).start()
    os.environ.clear()
    os.environ.update(environment)
    for stream, name in ((1, output), (2, errors)):
        try:
            file = os.open(name, os.O_WRONLY | os.O_APPEND)
        except OSError:  # whoever asked has ended, and its files with it
            os._exit(1)
        os.dup2(file, stream)
        os.close(file)
    sys.argv = [module, *arguments]
    own, spinner = (importlib.import_module(f"facts_damping.nodes.{name}") for name in (module, "base.spinner"))
    spinner.stop_by_signals()
    signal.pthread_sigmask(signal.SIG_UNBLOCK, INTERRUPTIONS)
    own.main()
