"""The process of a controller is confined by the kernel, before the controller's code is loaded.

Each means is used where the platform has it; `confine` says which hold.

- limits of memory, of files written (none) and of open files (`setrlimit`);
- a name space of its own in which all file systems are read-only, so that not even a time of access stays behind, and
  /proc is empty (`unshare`, `mount_setattr`);
- Landlock: files are read only where `readable.py` says, https://docs.kernel.org/userspace-api/landlock.html;
- a filter of system calls (`system_calls.py`).
"""

from __future__ import annotations

import ctypes
import os
import resource
import stat
from contextlib import suppress
from typing import TYPE_CHECKING

from facts_damping_studies.score.isolation.system_calls import PR_SET_NO_NEW_PRIVS, filter_calls

if TYPE_CHECKING:
    from collections.abc import Callable

    from facts_damping_studies.score.isolation.readable import Readable

MOST_OPEN = 64  # files
CLONE_NEWNS, CLONE_NEWUSER = 0x20000, 0x10000000
MOUNT_SETATTR, AT_FDCWD, AT_RECURSIVE, MOUNT_ATTR_RDONLY, MS_PRIVATE = 442, -100, 0x8000, 1, 1 << 18
CREATE_RULESET, ADD_RULE, RESTRICT_SELF = 444, 445, 446  # system calls of Landlock, on all machines
VERSION, PATH_BENEATH = 1, 1  # flag of the first, kind of rule of the second
READ_FILE, READ_DIR = 1 << 2, 1 << 3
FILE_RIGHTS = {1: 13, 2: 14, 3: 15, 5: 16}  # number of rights, from a version on
NETWORK, SCOPES = (4, 0b11), (6, 0b11)  # version from which there are these rights, and all of them


class _MountAttributes(ctypes.Structure):
    _fields_ = tuple((name, ctypes.c_uint64) for name in ("set", "clear", "propagation", "namespace"))


class _Ruleset(ctypes.Structure):
    _fields_ = tuple((name, ctypes.c_uint64) for name in ("files", "network", "scopes"))


class _Beneath(ctypes.Structure):
    _pack_ = 1
    _fields_ = (("rights", ctypes.c_uint64), ("descriptor", ctypes.c_int32))


def confine(readable: Readable, memory: int, *, native: bool) -> tuple[str, ...]:
    """Confine this process, which has one thread. Returns what holds.

    `memory`: bytes of address space; `native`: whether it may start threads, as native code does.
    """
    _limit(memory)
    landlock = landlock_version()
    means: list[tuple[str, Callable[[], bool]]] = [
        ("read-only mounts", _read_only),
        (f"Landlock {landlock}", lambda: _only_read(readable, landlock)),
        ("seccomp", lambda: filter_calls(threads=native)),  # last: it ends all others
    ]
    return (f"memory {memory / 2**30:.3g} GB", *(name for name, confined in means if confined()))


def landlock_version() -> int:
    """Version of the kernel's Landlock; 0: none."""
    return max(0, _call(CREATE_RULESET, None, 0, VERSION))


def _limit(memory: int) -> None:
    limits = {
        resource.RLIMIT_AS: memory,
        resource.RLIMIT_CORE: 0,
        resource.RLIMIT_FSIZE: 0,
        resource.RLIMIT_NOFILE: MOST_OPEN,
    }
    for what, most in limits.items():
        hard = resource.getrlimit(what)[1]
        bound = most if hard == resource.RLIM_INFINITY else min(most, hard)
        resource.setrlimit(what, (bound, bound))


def _call(number: int, *arguments: object) -> int:
    return int(ctypes.CDLL(None, use_errno=True).syscall(ctypes.c_long(number), *arguments))


def _read_only() -> bool:
    """Make all file systems read-only for this process, and empty /proc; returns whether it may."""
    library = ctypes.CDLL(None, use_errno=True)
    if library.unshare(CLONE_NEWNS) and library.unshare(CLONE_NEWNS | CLONE_NEWUSER):
        return False
    attributes = _MountAttributes(MOUNT_ATTR_RDONLY, 0, MS_PRIVATE, 0)
    size = ctypes.c_size_t(ctypes.sizeof(attributes))
    if _call(MOUNT_SETATTR, AT_FDCWD, b"/", AT_RECURSIVE, ctypes.byref(attributes), size):
        return False
    return bool(library.mount(b"none", b"/proc", b"tmpfs", ctypes.c_ulong(MOUNT_ATTR_RDONLY), None) == 0)


def _only_read(readable: Readable, version: int) -> bool:
    """Restrict this process to files that it may read; returns whether the kernel can."""
    if not version:
        return False
    rights = (1 << max(bits for since, bits in FILE_RIGHTS.items() if since <= version)) - 1
    ruleset = _Ruleset(rights, *(rights if version >= since else 0 for since, rights in (NETWORK, SCOPES)))
    fields = 1 + sum(version >= since for since, _ in (NETWORK, SCOPES))
    descriptor = _call(CREATE_RULESET, ctypes.byref(ruleset), ctypes.c_size_t(8 * fields), 0)
    if descriptor < 0:
        return False
    for path in (*readable.libraries, *readable.folders):
        _allow(descriptor, path, READ_FILE | READ_DIR)
    for path in readable.files:
        _allow(descriptor, path, READ_FILE)
    for path in readable.listed:
        _allow(descriptor, path, READ_DIR)
    ctypes.CDLL(None).prctl(PR_SET_NO_NEW_PRIVS, 1, 0, 0, 0)
    restricted = _call(RESTRICT_SELF, descriptor, 0) == 0
    os.close(descriptor)
    return restricted


def _allow(ruleset: int, path: str, rights: int) -> None:
    """Add a rule for a path; what is gone by now needs none."""
    with suppress(OSError):
        place = os.open(path, os.O_PATH | os.O_CLOEXEC)
        if not stat.S_ISDIR(os.fstat(place).st_mode):
            rights &= ~READ_DIR
        _call(ADD_RULE, ruleset, PATH_BENEATH, ctypes.byref(_Beneath(rights, place)), 0)
        os.close(place)
