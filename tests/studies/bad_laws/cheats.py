"""Laws that do what a controller may not that is scored: each at its first step."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
import threading
import time
from contextlib import suppress
from multiprocessing.shared_memory import SharedMemory
from pathlib import Path
from typing import Any

import numpy as np


class Cheat:
    """Does something at the first step, and nothing from then on."""

    done = False

    def __init__(self, spec: Any) -> None:
        self.place = spec.parameters.get("place", "")

    def step(self, t_s: float, y: Any, age_s: Any, fresh: Any) -> Any:
        if not self.done:
            self.done = True
            self.act()
        return 0.0 * y

    def act(self) -> None:
        """What it does."""


class Reads(Cheat):
    """Reads a file."""

    def act(self) -> None:
        Path(self.place).read_bytes()


class ReadsEarly(Reads):
    """Reads a file before the first step, and would go on without."""

    def __init__(self, spec: Any) -> None:
        super().__init__(spec)
        with suppress(BaseException):
            self.act()


class Writes(Cheat):
    """Leaves a file for later."""

    def act(self) -> None:
        Path(self.place).write_text("1", encoding="utf-8")


class Makes(Cheat):
    """Leaves a folder."""

    def act(self) -> None:
        Path(self.place).mkdir()


class Shares(Cheat):
    """Leaves memory for later."""

    def act(self) -> None:
        SharedMemory("facts_damping_left", create=True, size=8)


class Calls(Cheat):
    """Calls somebody."""

    def act(self) -> None:
        socket.create_connection(("127.0.0.1", 9), timeout=1)


class Starts(Cheat):
    """Starts a program."""

    def act(self) -> None:
        subprocess.run(["/bin/true"], check=True)


class Forks(Cheat):
    """Goes on in another process."""

    def act(self) -> None:
        os.fork()


class Threads(Cheat):
    """Thinks between steps."""

    def act(self) -> None:
        threading.Thread(target=time.sleep, args=(1,)).start()


class Kills(Cheat):
    """Sends a signal to the process above."""

    def act(self) -> None:
        os.kill(os.getppid(), 15)


class Native(Cheat):
    """Calls the C library."""

    def act(self) -> None:
        import ctypes  # noqa: PLC0415 (as one would that hides it)

        ctypes.CDLL(None).getpid()


class Traces(Cheat):
    """Looks into another process's memory."""

    def act(self) -> None:
        with Path(f"/proc/{os.getppid()}/mem").open("rb") as memory:
            memory.read(1)
        raise ValueError("saw another's memory")


class Fools(Cheat):
    """Calls the kernel itself, with the audit hook fooled: by code that says that it is NumPy's."""

    def __init__(self, spec: Any) -> None:
        super().__init__(spec)
        self.what = spec.parameters["call"]

    def act(self) -> None:
        text = "import ctypes\ndef call(name, *rest): return getattr(ctypes.CDLL(None), name)(*rest)"
        space: dict[str, Any] = {}
        exec(compile(text, str(np.__file__), "exec"), space)
        calls = {
            "socket": (2, 1, 0),
            "fork": (),
            "kill": (os.getppid(), 9),
            "ptrace": (16, os.getppid(), 0, 0),
            "process_vm_readv": (os.getppid(), None, 0, None, 0, 0),
            "shmget": (1234, 8, 0o1600),
            "open": (self.place.encode(), 0),
            "creat": (self.place.encode(), 0o600),
            "mkdir": (self.place.encode(), 0o700),
            "unlink": (__file__.encode(),),
        }
        raise ValueError(f"came back with {space['call'](self.what, *calls[self.what])}")


class Sleeps(Cheat):
    """Thinks longer than the run waits."""

    def act(self) -> None:
        time.sleep(60.0)


class Spins(Cheat):
    """Computes longer than the run waits."""

    def act(self) -> None:
        while True:
            pass


class SpinsEarly(Cheat):
    """Computes before the first step."""

    def __init__(self, spec: Any) -> None:
        while True:
            pass


class Hoards(Cheat):
    """Asks for more memory than there is to be."""

    def act(self) -> None:
        bytearray(1 << 33)


class Exits(Cheat):
    """Ends its process."""

    def act(self) -> None:
        from facts_damping.interruption import exit_now  # noqa: PLC0415 (as one would that looks for it)

        exit_now(7)


class Answers(Cheat):
    """Answers before it is asked: its process goes on while the run does."""

    def act(self) -> None:
        os.write(3, b"\x09\0\0\0U" + bytes(8))


class Shouts(Cheat):
    """Answers what is no answer."""

    def act(self) -> None:
        os.write(3, b"\xff\xff\xff\xff")


class Patches(Cheat):
    """Changes the package's functions, in all modules that it can reach."""

    def act(self) -> None:
        from facts_damping.analysis import indices  # noqa: PLC0415 (what it patches)
        from facts_damping.simulation import loop  # noqa: PLC0415 (what it patches)

        def best(*_: Any, **__: Any) -> dict[str, float]:
            return {"ITAE": 0.0}

        vars(indices)["performance_indices"] = best
        vars(loop)["run"] = best
        for module in list(sys.modules.values()):
            if getattr(module, "performance_indices", None) is not None:
                vars(module)["performance_indices"] = best
        import builtins  # noqa: PLC0415 (what it patches)

        vars(builtins)["open"] = best


class Busy(Cheat):
    """Computes for 2 ms at each step, and sleeps for 2 ms."""

    def step(self, t_s: float, y: Any, age_s: Any, fresh: Any) -> Any:
        until = time.perf_counter() + 0.002
        while time.perf_counter() < until:
            pass
        time.sleep(0.002)
        return 0.0 * y
