"""Instructions of a compiled function, counted one by one: the same on a loaded machine and on a fast one."""

from __future__ import annotations

import ctypes
import os
import platform
import signal
import sys
from typing import Any

from facts_damping.compiling import kernels

TRACEME, PEEK, PEEK_REGISTER, POKE, POKE_REGISTER, GO_ON, KILL, STEP = 0, 2, 3, 5, 6, 7, 8, 9  # of ptrace(2)
NEXT, STACK = 8 * 16, 8 * 19  # places of the registers rip and rsp
BREAKPOINT = 0xCC
COUNTS = sys.platform == "linux" and platform.machine() == "x86_64"


_ptrace: Any = ctypes.CDLL(None).ptrace if COUNTS else None
if COUNTS:
    _ptrace.argtypes, _ptrace.restype = [ctypes.c_long] * 4, ctypes.c_long


def instructions(entry: Any, *arguments: Any) -> int:
    """Instructions of a call of an entry point, in a process of its own, without Python's before and after it.

    Raises `PermissionError` where a process may not look into another.
    """
    words, function, begin = entry._words(*arguments), entry._function, kernels._address(entry)
    process = os.fork()
    if process == 0:
        _ptrace(TRACEME, 0, 0, 0)
        os.kill(os.getpid(), signal.SIGSTOP)
        function(*words)
        os._exit(0)
    try:
        os.waitpid(process, 0)
        code = _ptrace(PEEK, process, begin, 0)
        if _ptrace(POKE, process, begin, code & ~0xFF | BREAKPOINT):
            raise PermissionError("ptrace")
        _ptrace(GO_ON, process, 0, 0)
        os.waitpid(process, 0)
        _ptrace(POKE, process, begin, code)
        _ptrace(POKE_REGISTER, process, NEXT, begin)
        end = _ptrace(PEEK, process, _ptrace(PEEK_REGISTER, process, STACK, 0), 0)
        count = 0
        while _ptrace(PEEK_REGISTER, process, NEXT, 0) != end:
            _ptrace(STEP, process, 0, 0)
            os.waitpid(process, 0)
            count += 1
        return count
    finally:
        os.kill(process, signal.SIGKILL)
        os.waitpid(process, 0)
