"""Life of a node's process: middleware set-up, errors, exit status, and an end that a hanging middleware cannot stop.

About once in fifty runs on a loaded machine, a destructor of Fast DDS 3.2 waits for ever (in
`ResourceEvent::unregister_timer`) while it holds Python's GIL, so neither Python code nor signal handlers run.
A POSIX timer then calls `_exit` in a thread of its own (POSIX.1-2017, timer_create with SIGEV_THREAD).
"""

from __future__ import annotations

import ctypes
import os
import signal
import sys
import warnings
from contextlib import suppress
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import TYPE_CHECKING

import rclpy
from rclpy.exceptions import ParameterException
from rclpy.signals import SignalHandlerOptions

from facts_damping.errors import FactsDampingError, RunError, one_line, traced
from facts_damping.input_files import naming_no_files
from facts_damping.interruption import INTERRUPTIONS
from facts_damping.nodes import clock
from facts_damping.nodes.base.discovery import finish
from facts_damping.nodes.base.log import NodeLog
from facts_damping.nodes.base.managed import ManagedNode
from facts_damping.nodes.base.parameters import usage
from facts_damping.nodes.base.spinner import DRAIN_S, BeginAgain, Stopped, stop_by_signals

if TYPE_CHECKING:
    from collections.abc import Callable

    from facts_damping.nodes.base.managed import NodeBody

RANGE = "ROS_AUTOMATIC_DISCOVERY_RANGE"
FAST_DDS = {"fastdds": "3.", "fastrtps": "2."}  # name in wheels, variables and profiles; Fast DDS version
LEAVE_S = 5.0  # longest wall time for a node to leave the graph
SIGEV_THREAD = 2


@cache
def profile(this_host: bool) -> tuple[str, Path] | None:
    """Environment variable and file of our profile for the installed Fast DDS wheel; None without such a wheel."""
    for name, major in FAST_DDS.items():
        with suppress(PackageNotFoundError):
            if version(f"ros-{name}").startswith(major):
                file = f"{name}_this_host.xml" if this_host else f"{name}.xml"
                return f"{name.upper()}_DEFAULT_PROFILES_FILE", Path(__file__).parents[1] / file
    return None


def _set_up_middleware() -> None:
    """Make Fast DDS use only UDP and, if it comes from a wheel, our profile, unless the user sets the variables.

    With shared memory, a killed node would leave its segments behind for the next nodes in the domain.
    """
    os.environ.setdefault("FASTDDS_BUILTIN_TRANSPORTS", "UDPv4")
    this_host = os.environ.get(RANGE) == "LOCALHOST"
    ours = profile(this_host)
    if ours is None or ours[0] in os.environ:
        return
    os.environ[ours[0]] = str(ours[1])
    if this_host:
        os.environ[RANGE] = "SYSTEM_DEFAULT"  # the profile limits discovery instead


def run_node(name: str, make: Callable[[ManagedNode], NodeBody], description: str) -> None:
    """Make a node, run it and exit: status 0 done or interrupted, 1 failed, 2 bad input.

    An error is logged in one line. `description`: first line of `--help`. The node is made anew when the plant of a
    free graph was replaced, and after `cleanup`.
    """
    _set_up_middleware()
    stop_by_signals()
    warnings.filterwarnings("ignore", "failed to send response", RuntimeWarning)  # the client may have left
    asks_for_help = not {"-h", "--help"}.isdisjoint(sys.argv[1:])
    if asks_for_help:
        os.environ[RANGE] = "OFF"  # a node that only prints its help need not be discovered
    status, autostart = None, None
    while status is None:
        try:
            if not rclpy.ok():
                rclpy.init(args=sys.argv, signal_handler_options=SignalHandlerOptions.NO)
            node = ManagedNode(name, make, autostart)
        except Exception as error:  # noqa: BLE001 (arguments of ROS 2 that rclpy cannot use, each kind in its own way)
            sys.stderr.write(f"{name}: {one_line(error)}\n")
            sys.exit(2)
        status = _run(node, usage_of=description if asks_for_help else "")
        autostart = not node.cleaned and (node.autostart or node.active)
        if status is not None:
            _limit_the_end(status)
        node.destroy_node()
    rclpy.try_shutdown()
    sys.exit(status)


def _run(node: ManagedNode, usage_of: str) -> int | None:
    """Run a node to its end. Returns the exit status, or None if the node must begin again.

    `usage_of`: what the node does, to write only its help; empty: run it.
    """
    log = NodeLog(node)
    try:
        if usage_of:
            node.construct()
            sys.stdout.write(f"{usage(node, usage_of)}\n")
            return 0
        body = node.start() if node.autostart else node.configured()
        try:
            with naming_no_files("a message, a service or a parameter"):
                body.ready()
                node.wait_active(body)
                body.run()
        except RunError as error:
            raise RunError(f"{error}{body.spinner.remark()}") from error
        finally:
            body.spinner.close()
        finish(node.publishers, DRAIN_S)
        log.info("ended")
    except Stopped:
        finish(node.publishers, DRAIN_S)
        log.info("ended: stopped by a signal")
    except BeginAgain:
        log.info("unconfigured" if node.cleaned else "another plant has started: this node restarts")
        return None
    except (FactsDampingError, ParameterException) as error:
        log.fatal(one_line(error), traced(error))
        return 1 if isinstance(error, RunError) else 2
    return 0


def _limit_the_end(status: int) -> None:
    """Make sure that a finished process ends with `status`, even if its middleware hangs."""
    for number in INTERRUPTIONS:
        signal.signal(number, signal.SIG_IGN)  # else a signal during Python's shutdown would kill the process
    sys.stdout.flush()
    end_after(LEAVE_S, status)


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
    if library.timer_create(clock.CLOCK_MONOTONIC, ctypes.byref(event), ctypes.byref(timer)) or library.timer_settime(
        timer, 0, ctypes.byref(times), None
    ):
        raise OSError(ctypes.get_errno(), os.strerror(ctypes.get_errno()))
