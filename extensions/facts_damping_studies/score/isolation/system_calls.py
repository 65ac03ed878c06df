"""A seccomp filter: which calls of the kernel the process of a controller may make.

What it needs to compute and to read is allowed. A thread, a process, a signal, or another process's memory ends it; an
FMU may start threads, whose time counts. Anything else, such as to change a file or to open a socket, fails as if the
kernel did not have it. A file may be opened only to be read. Numbers of the calls:
arch/x86/entry/syscalls/syscall_64.tbl and include/uapi/asm-generic/unistd.h of Linux; the filter's form:
https://docs.kernel.org/userspace-api/seccomp_filter.html.
"""

from __future__ import annotations

import ctypes
import errno
import os
import platform
import struct
from typing import NamedTuple

# Names of calls, and their numbers on x86-64 and on aarch64, -1 where there is none.
ALLOWED = """
    read 0 63, write 1 64, close 3 57, stat 4 -1, fstat 5 80, lstat 6 -1, poll 7 -1, lseek 8 62, mmap 9 222,
    mprotect 10 226, munmap 11 215, brk 12 214, rt_sigaction 13 134, rt_sigprocmask 14 135, rt_sigreturn 15 139,
    pread64 17 67, readv 19 65, writev 20 66, access 21 -1, select 23 -1, sched_yield 24 124, mremap 25 216,
    madvise 28 233, dup 32 23, dup2 33 -1, nanosleep 35 101, getpid 39 172, exit 60 93, uname 63 160,
    getcwd 79 17, chdir 80 49, fchdir 81 50, readlink 89 -1, gettimeofday 96 169, getrlimit 97 163,
    getrusage 98 165, times 100 153, getuid 102 174, getgid 104 176, geteuid 107 175, getegid 108 177,
    getppid 110 173, sigaltstack 131 132, statfs 137 43, fstatfs 138 44, arch_prctl 158 -1, gettid 186 178,
    time 201 -1, futex 202 98, sched_getaffinity 204 123, getdents64 217 61, set_tid_address 218 96,
    restart_syscall 219 128, fadvise64 221 223, clock_gettime 228 113, clock_getres 229 114,
    clock_nanosleep 230 115, exit_group 231 94, newfstatat 262 79, readlinkat 267 78, faccessat 269 48,
    pselect6 270 72, ppoll 271 73, set_robust_list 273 99, get_robust_list 274 100, dup3 292 24, preadv 295 69,
    getcpu 309 168, getrandom 318 278, statx 332 291, rseq 334 293, faccessat2 439 439
"""
FATAL = """
    shmget 29 194, shmat 30 196, connect 42 203, accept 43 202, sendto 44 206, sendmsg 46 211,
    bind 49 200, listen 50 201, socketpair 53 199, clone 56 220, fork 57 -1, vfork 58 -1, execve 59 221,
    kill 62 129, semget 64 190, msgget 68 186, ptrace 101 117, rt_sigqueueinfo 129 138, mount 165 40,
    tkill 200 130, mq_open 240 180, add_key 248 217, keyctl 250 219, unshare 272 97, accept4 288 242,
    rt_tgsigqueueinfo 297 240, perf_event_open 298 241, sendmmsg 307 269, setns 308 268,
    process_vm_readv 310 270, process_vm_writev 311 271, bpf 321 280, execveat 322 281, userfaultfd 323 282,
    pidfd_send_signal 424 424, io_uring_setup 425 425, pidfd_open 434 434, clone3 435 435, pidfd_getfd 438 438
"""
OPENAT, OPEN, FCNTL, PRLIMIT, IOCTL = (257, 56), (2, -1), (72, 25), (302, 261), (16, 29)
CLONE, CLONE3, CLONE_THREAD = (56, 220), (435, 435), 0x10000
MACHINES = {"x86_64": (0, 0xC000003E), "aarch64": (1, 0xC00000B7)}  # column of the tables, and name of the interface
X32 = 0x40000000  # calls of x86-64's other interface begin here
CHANGES = os.O_ACCMODE | os.O_CREAT | os.O_TRUNC  # flags of a file that is not only read
DUPLICATES = (0, 1, 2, 3, 4, 1030)  # commands of fcntl on descriptors; others lock files
KILL, FAIL, ALLOW = 0x80000000, 0x00050000, 0x7FFF0000
LOAD, EQUAL, AT_LEAST, ANY_BIT, RETURN = 0x20, 0x15, 0x35, 0x45, 0x06  # of the filter's machine
NUMBER, INTERFACE, ARGUMENTS = 0, 4, 16  # offsets in what a filter sees
PR_SET_NO_NEW_PRIVS, PR_SET_SECCOMP, FILTER = 38, 22, 2


class _Program(ctypes.Structure):
    _fields_ = (("length", ctypes.c_ushort), ("filter", ctypes.c_char_p))


class Step(NamedTuple):
    """A step of a filter: operation, operand, and how many steps to skip if it is true, and if not."""

    operation: int
    operand: int
    if_true: int = 0
    if_false: int = 0


def _argument(i: int, upper: bool = False) -> Step:
    """Load the lower or upper half of argument i."""
    return Step(LOAD, ARGUMENTS + 8 * i + 4 * upper)


def _if_call(number: int, steps: list[Step]) -> list[Step]:
    """Steps for one call, which end in a return."""
    return [] if number < 0 else [Step(EQUAL, number, 0, len(steps)), *steps]


def steps_of(machine: str, *, threads: bool) -> list[Step]:
    """The filter for a machine; `threads`: whether threads may be started, but still no process."""
    column, interface = MACHINES[machine]
    steps = [Step(LOAD, INTERFACE), Step(EQUAL, interface, 1, 0), Step(RETURN, KILL), Step(LOAD, NUMBER)]
    if machine == "x86_64":
        steps += [Step(AT_LEAST, X32, 0, 1), Step(RETURN, KILL)]
    if threads:  # the newer call has its flags where a filter does not see them; without it the older is used
        steps += _if_call(CLONE3[column], [Step(RETURN, FAIL | errno.ENOSYS)])
        of_thread = [_argument(0), Step(ANY_BIT, CLONE_THREAD, 1, 0), Step(RETURN, KILL), Step(RETURN, ALLOW)]
        steps += _if_call(CLONE[column], of_thread)
    for action, table in ((ALLOW, ALLOWED), (KILL, FATAL)):
        for row in table.split(","):
            steps += _if_call(int(row.split()[1 + column]), [Step(RETURN, action)])
    refused = Step(RETURN, FAIL | errno.EACCES)
    for call, flags in ((OPENAT, 2), (OPEN, 1)):
        steps += _if_call(call[column], [_argument(flags), Step(ANY_BIT, CHANGES, 0, 1), refused, Step(RETURN, ALLOW)])
    commands = [Step(EQUAL, command, len(DUPLICATES) - i, 0) for i, command in enumerate(DUPLICATES)]
    steps += _if_call(FCNTL[column], [_argument(1), *commands, refused, Step(RETURN, ALLOW)])
    halves = [_argument(2), Step(EQUAL, 0, 0, 3), _argument(2, upper=True), Step(EQUAL, 0, 0, 1)]
    steps += _if_call(PRLIMIT[column], [*halves, Step(RETURN, ALLOW), refused])  # limits may be read
    steps += _if_call(IOCTL[column], [Step(RETURN, FAIL | errno.ENOTTY)])
    return [*steps, Step(RETURN, FAIL | errno.ENOSYS)]


def filter_calls(*, threads: bool) -> bool:
    """Filter the calls of this process from here on; returns whether the platform can."""
    machine = platform.machine()
    if machine not in MACHINES:
        return False
    steps = steps_of(machine, threads=threads)
    packed = b"".join(struct.pack("=HBBI", step.operation, step.if_true, step.if_false, step.operand) for step in steps)
    program, library = _Program(len(steps), packed), ctypes.CDLL(None, use_errno=True)
    if library.prctl(PR_SET_NO_NEW_PRIVS, 1, 0, 0, 0):
        return False
    return bool(library.prctl(PR_SET_SECCOMP, FILTER, ctypes.byref(program), 0, 0) == 0)
