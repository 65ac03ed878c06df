"""A node from its start to its end: middleware, errors, exit status."""

from __future__ import annotations

import os
import signal
import sys
import warnings
from contextlib import suppress
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

import rclpy
from rclpy.exceptions import ParameterException
from rclpy.signals import SignalHandlerOptions

from facts_damping.errors import FactsDampingError, RunError, one_line, traced
from facts_damping.input_files import naming_no_files
from facts_damping.nodes.base.discovery import (
    finish,
)
from facts_damping.nodes.base.exit_watchdog import end_after
from facts_damping.nodes.base.log import NodeLog
from facts_damping.nodes.base.parameters import accept_whole_numbers, check_declared, usage
from facts_damping.nodes.base.spinner import HEARD_S, BeginAgain, Stopped, stop_by_signals
from facts_damping.terminal import INTERRUPTIONS

if TYPE_CHECKING:
    from collections.abc import Callable

    from rclpy.node import Node

    from facts_damping.nodes.base.spinner import Spinner

RANGE = "ROS_AUTOMATIC_DISCOVERY_RANGE"
FAST_DDS = {"fastdds": "3.", "fastrtps": "2."}  # how wheels, variables and our profiles are named after its versions
LEAVE_S = 5.0  # wall time that a node takes at most to leave the graph


class NodeBody(Protocol):
    """What a node is beside its ROS side: set up by its constructor, made ready, then run."""

    spinner: Spinner

    def ready(self) -> None:
        """Wait for others, and take what is needed from here on."""

    def run(self) -> None:
        """Work until done or interrupted."""


def profile(this_host: bool) -> tuple[str, Path] | None:
    """Our profile in the words of the wheels' Fast DDS, and the variable that it is given by; others would complain."""
    for name, major in FAST_DDS.items():
        with suppress(PackageNotFoundError):
            if version(f"ros-{name}").startswith(major):
                file = f"{name}_this_host.xml" if this_host else f"{name}.xml"
                return f"{name.upper()}_DEFAULT_PROFILES_FILE", Path(__file__).parents[1] / file
    return None


def _set_up_middleware() -> None:
    """Have Fast DDS use UDP alone and, if it is that of wheels, a profile of ours, unless the user says otherwise.

    In shared memory a node that is killed would leave what is its own to whoever comes next in the domain.
    """
    os.environ.setdefault("FASTDDS_BUILTIN_TRANSPORTS", "UDPv4")
    this_host = os.environ.get(RANGE) == "LOCALHOST"
    ours = profile(this_host)
    if ours is None or ours[0] in os.environ:
        return
    os.environ[ours[0]] = str(ours[1])
    if this_host:
        os.environ[RANGE] = "SYSTEM_DEFAULT"  # as the profile says


def run_node(name: str, make: Callable[[Node], NodeBody], does: str) -> None:
    """Make a node and run it to its end: exit status 0 done or interrupted, 1 failed, 2 bad input.

    One line says why. `does`: what `--help` says first. Where the graph runs free, another plant has it made anew.
    """
    _set_up_middleware()
    stop_by_signals()
    warnings.filterwarnings("ignore", "failed to send response", RuntimeWarning)  # who asked may have left
    if _asks_for_help():
        os.environ[RANGE] = "OFF"  # nobody need know of a node that does not run
    status = None
    while status is None:
        try:
            if not rclpy.ok():
                rclpy.init(args=sys.argv, signal_handler_options=SignalHandlerOptions.NO)
            node = rclpy.create_node(name, start_parameter_services=True)
        except Exception as error:  # noqa: BLE001 (arguments of ROS 2 that rclpy cannot use, each kind in its own way)
            sys.stderr.write(f"{name}: {one_line(error)}\n")
            sys.exit(2)
        status = _run(node, make, does)
        if status is not None:
            _limit_the_end(status)
        node.destroy_node()
    rclpy.try_shutdown()
    sys.exit(status)


def _asks_for_help() -> bool:
    return not {"-h", "--help"}.isdisjoint(sys.argv[1:])


def _run(node: Node, make: Callable[[Node], NodeBody], does: str) -> int | None:
    """Run a node to its end; its exit status, or None where it has to begin again."""
    accept_whole_numbers(node)
    log = NodeLog(node)
    try:
        part = make(node)
        if _asks_for_help():
            sys.stdout.write(f"{usage(node, does)}\n")
            return 0
        check_declared(node)
        try:
            with naming_no_files("a message, a service or a parameter"):
                part.ready()
                part.run()
        except RunError as error:
            raise RunError(f"{error}{part.spinner.remark()}") from error
        finally:
            part.spinner.close()
        finish(node.publishers, HEARD_S)
        log.info("ended")
    except Stopped:
        finish(node.publishers, HEARD_S)
        log.info("ended: stopped by a signal")
    except BeginAgain:
        log.info("another plant has begun: this node begins again, too")
        return None
    except (FactsDampingError, ParameterException) as error:
        log.fatal(one_line(error), traced(error))
        return 1 if isinstance(error, RunError) else 2
    return 0


def _limit_the_end(status: int) -> None:
    """Have a process whose work is done and written end as it should, also if its middleware does not let it."""
    for number in INTERRUPTIONS:
        signal.signal(number, signal.SIG_IGN)  # it ends; Python, when it ends, would let them kill it
    sys.stdout.flush()
    end_after(LEAVE_S, status)
