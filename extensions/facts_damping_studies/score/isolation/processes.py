"""The template of this process, which forks those of controllers, and the connection to one of them."""

from __future__ import annotations

import atexit
import contextlib
import json
import os
import secrets
import socket
import struct
import subprocess
import sys
import threading
import time
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from facts_damping.errors import RunError
from facts_damping.interruption import interruptions_held
from facts_damping_studies.score.isolation.messages import LENGTH, MOST_BYTES, frame
from facts_damping_studies.score.isolation.readable import LIBRARIES, code_roots, libraries, within

if TYPE_CHECKING:
    from collections.abc import Sequence

START = (
    "import sys; sys.path[:] = sys.argv[1].split('\\n'); "
    "from facts_damping_studies.score.isolation.template import serve; serve(int(sys.argv[2]))"
)
THREADS = ("OPENBLAS", "OMP", "MKL", "NUMEXPR", "NUMBA", "VECLIB_MAXIMUM")  # number of a library's threads
PASSED = ("PATH", "HOME", "LANG", "LC_ALL", "LD_LIBRARY_PATH", "NUMBA_CACHE_DIR", "XDG_CACHE_HOME")
START_S = 60.0  # wall time in which the template must have started, or forked
SCHEDULED = 2  # of a process's clock: time of processor, as the scheduler counts it


class Connection:
    """A connection to the process of a controller."""

    def __init__(self, end: socket.socket, process: int) -> None:
        self.process = process
        self._socket, self._received = end, b""

    def send(self, content: bytes, patience_s: float) -> None:
        """Send a frame. Raises `TimeoutError`, or `OSError` if the process has ended."""
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_SNDTIMEO, _timeval(patience_s))
        try:
            self._socket.sendall(frame(content))
        except BlockingIOError as error:
            raise TimeoutError from error

    def receive(self, patience_s: float) -> bytes:
        """Content of the next frame; empty if the process has ended. Raises `TimeoutError`."""
        until = time.monotonic() + patience_s
        while not (complete := self._complete()):
            left = until - time.monotonic()
            if left <= 0.0:
                raise TimeoutError
            self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVTIMEO, _timeval(left))
            with contextlib.suppress(BlockingIOError, ConnectionResetError):
                part = self._socket.recv(MOST_BYTES)
                if not part:
                    return b""
                self._received += part
        self._received = self._received[LENGTH.size + len(complete) :]
        return complete

    def _complete(self) -> bytes:
        if len(self._received) < LENGTH.size:
            return b""
        size = LENGTH.unpack_from(self._received)[0]
        if not 0 < size <= MOST_BYTES:
            raise ValueError(f"a message of {size} bytes")
        content = self._received[LENGTH.size : LENGTH.size + size]
        return content if len(content) == size else b""

    def unread(self) -> bytes:
        """What has come and was not received as a frame."""
        with contextlib.suppress(OSError):
            self._received += self._socket.recv(MOST_BYTES, socket.MSG_DONTWAIT)
        return self._received

    def cpu_s(self) -> float:
        """Time of processor that the process has used, s; 0 once it has gone."""
        try:
            return time.clock_gettime((~self.process << 3) | SCHEDULED)
        except OSError:
            return 0.0

    def close(self) -> None:
        """End the connection."""
        self._socket.close()


class Template:
    """A template, and how it is asked."""

    def __init__(self) -> None:
        """Start it. Raises `RunError` if that fails."""
        self._lock = threading.Lock()
        self._socket, other = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        with other:
            arguments = [sys.executable, "-s", "-B", "-c", START, "\n".join(_path()), str(other.fileno())]
            self._popen = subprocess.Popen(
                arguments,
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.PIPE,
                cwd="/",
                env=_environment(),
                pass_fds=(other.fileno(),),
                start_new_session=True,  # an interruption ends the run, which then closes the socket
            )
        self._socket.settimeout(START_S)
        self._answer()
        atexit.register(self.close)

    @property
    def process(self) -> int:
        """Its process number."""
        return self._popen.pid

    def fork(self, modules: Sequence[str], fmu: str | None) -> Connection:
        """Fork a process; `modules`: of libraries, loaded first; `fmu`: a file, unpacked first."""
        for _ in range(secrets.randbelow(8)):  # numbers of sockets do not count the runs, either
            for end in socket.socketpair():
                end.close()
        ours, its = socket.socketpair()
        with self._lock, its, interruptions_held():
            request = json.dumps({"fork": list(modules), "fmu": fmu}).encode()
            socket.send_fds(self._socket, [request], [its.fileno()])
            process = int(self._answer())
        return Connection(ours, process)

    def end(self, process: int) -> int:
        """End a process; returns its exit status, negative if a signal ended it."""
        with self._lock, interruptions_held():
            self._socket.send(json.dumps({"end": process}).encode())
            return int(self._answer())

    def _answer(self) -> Any:
        try:
            text = self._socket.recv(MOST_BYTES)
        except OSError as error:
            raise RunError(f"the template of controllers' processes does not answer: {error}") from error
        if not text:
            lines = self._popen.communicate()[1].decode(errors="replace").strip().splitlines()
            raise RunError(f"the template of controllers' processes has ended: {lines[-1] if lines else 'no reason'}")
        return json.loads(text)

    def close(self) -> None:
        """End it, and all processes that it has forked."""
        atexit.unregister(self.close)
        self._socket.close()
        try:
            self._popen.communicate(timeout=START_S)
        except subprocess.TimeoutExpired:
            self._popen.kill()
            self._popen.communicate()


def template() -> Template:
    """The template of this process; it is started when it is first asked for."""
    return _template(os.getpid())


@cache
def _template(_process: int) -> Template:
    return Template()


def _path() -> list[str]:
    """Where the template finds libraries and this package, and nothing else if that can be told apart."""
    entries = [entry for entry in sys.path if entry]
    return [
        *code_roots(),
        *(e for e in entries if Path(e).name in LIBRARIES or within(os.path.realpath(e), libraries())),
    ]


def _environment() -> dict[str, str]:
    """An environment that is the same in all runs; libraries compute in one thread, as in the run's own process."""
    passed = {name: os.environ[name] for name in PASSED if name in os.environ}
    return {**passed, "PYTHONHASHSEED": "0", **{f"{name}_NUM_THREADS": "1" for name in THREADS}}


def _timeval(seconds: float) -> bytes:
    return struct.pack("@ll", int(seconds), int(seconds % 1.0 * 1e6) or 1)
