"""A process from which those of controllers are forked: it has loaded libraries, and runs nothing of a user.

A worker has one. It is a new interpreter with an environment that says nothing of the run, and no file open but the
socket over which it is asked. Between forks it starts a random number of threads, which end at once, so that process
numbers do not count the runs.
"""

from __future__ import annotations

import contextlib
import gc
import importlib
import json
import os
import secrets
import signal
import socket
import sys
import threading
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

from facts_damping.extensions import given
from facts_damping.interruption import exit_now
from facts_damping.simulation.programs import fmus
from facts_damping_studies.score.isolation import child

ASKED = 1 << 16  # bytes of a request
STEPS = 16  # most threads between two forks, plus 1
ENVIRONMENT = "facts_damping.environment"  # whose observations trained policies use
_warm: list[Any] = []  # such observations, once they are compiled


def serve(descriptor: int) -> None:
    """Answer requests over a socket until it is closed; then end all processes that are left.

    `{"fork": [modules], "fmu": file}` with a descriptor: modules to load first, an FMU to unpack first; the answer is
    the process number. `{"end": process number}`: the answer is its exit status, negative if a signal ended it, and 0
    if there is no such process.
    """
    requests = socket.socket(fileno=descriptor)
    signal.set_wakeup_fd(-1)
    given("policies")
    gc.collect()
    gc.freeze()
    running: set[int] = set()
    requests.send(b"{}")
    while True:
        text, descriptors, _, _ = socket.recv_fds(requests, ASKED, 1)
        if not text:
            break
        request = json.loads(text)
        if "end" in request:
            answer = _end(request["end"]) if request["end"] in running else 0
            running.discard(request["end"])
        else:
            _load(request["fork"], request["fmu"])
            answer = _fork(descriptors[0])
            running.add(answer)
        requests.send(json.dumps(answer).encode())
    for process in running:
        _end(process)


def _load(modules: list[str], fmu: str | None) -> None:
    """Load modules of libraries, and unpack an FMU, for all controllers to come, which meet the error if that fails."""
    for name in modules:
        if name not in sys.modules:
            with contextlib.suppress(Exception, SystemExit):
                importlib.import_module(name)
    if ENVIRONMENT in modules and ENVIRONMENT in sys.modules and not _warm:
        _warm.append(sys.modules[ENVIRONMENT].Window(SimpleNamespace(signals=["y"], frame_rate=50), 1))
        _warm[0].push(0.0, np.zeros(1), np.zeros(1), np.ones(1, np.bool_))  # compiles it
    if fmu is not None:
        with contextlib.suppress(Exception):
            fmus.unpacked(Path(fmu), "")


def _fork(connection: int) -> int:
    """Fork the process of a controller; returns its number."""
    for _ in range(secrets.randbelow(STEPS)):
        thread = threading.Thread(target=int)
        thread.start()
        thread.join()
    process = os.fork()
    if process == 0:
        try:
            child.run(connection)
        finally:
            exit_now(1)
    os.close(connection)
    return process


def _end(process: int) -> int:
    """End a process; returns its exit status, negative if a signal ended it."""
    os.kill(process, signal.SIGKILL)  # which changes no status of one that has ended
    return os.waitstatus_to_exitcode(os.waitpid(process, 0)[1])
