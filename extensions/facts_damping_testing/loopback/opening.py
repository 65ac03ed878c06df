"""Opens a loopback: until it is closed, nodes of this process use it instead of DDS, and its time instead of the clock.

`rclpy`'s Python code stays. Replaced are the names of its C++ part (`implementation`) and what belongs to a process:
default context, executor, arguments, outputs, environment, signals, time.
"""

from __future__ import annotations

import importlib
import os
import signal
import sys
import time
from contextlib import ExitStack, contextmanager
from functools import lru_cache, partial
from typing import TYPE_CHECKING, Any

import rclpy
import rclpy.logging
import rclpy.utilities
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.impl.implementation_singleton import rclpy_implementation

from facts_damping.extensions import given
from facts_damping.nodes import clock
from facts_damping.nodes.base import run
from facts_damping.nodes.executables import module_of
from facts_damping.nodes.launching import forked, preload  # noqa: F401 (all nodes, so that all see it)
from facts_damping_testing.loopback import implementation
from facts_damping_testing.loopback.processes import FIRST_PID, Process, World, current, never, process

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence

    from rclpy.executors import Executor

FOREIGN = "facts_damping_testing.foreign"
NODES = (row.value for row in given("nodes").values())  # of other packages
PATCHED = "rclpy", "facts_damping.nodes", FOREIGN, *NODES  # packages whose modules use the loopback


class StandIn:
    """A module of which some names are replaced."""

    def __init__(self, module: Any, names: Mapping[str, Any]) -> None:
        """`names`: replaced names and their values; a `Mine` is evaluated for the process that runs."""
        self.module, self._names = module, names

    def __getattr__(self, name: str) -> Any:
        replacement = self._names.get(name)
        if replacement is None:
            return getattr(self.module, name)
        return replacement.of(process()) if isinstance(replacement, Mine) else replacement


class Mine:
    """A value that each process has of its own, by a function of the process."""

    def __init__(self, of: Callable[[Process], Any]) -> None:
        self.of = of


def _handle_signal(number: int, handler: Any) -> None:
    process().handlers[number] = handler


STAND_INS = (
    StandIn(rclpy_implementation, implementation.NAMES),
    StandIn(
        sys,
        {"argv": Mine(lambda p: p.arguments), "stdout": Mine(lambda p: p.output), "stderr": Mine(lambda p: p.errors)},
    ),
    StandIn(os, {"environ": Mine(lambda running: running.environment if running.pid else os.environ)}),
    StandIn(signal, {"signal": _handle_signal}),
)


def _default_context(*, shutting_down: bool = False) -> Context:
    values = process().values
    context: Context = values.setdefault("context", Context())
    if shutting_down:
        del values["context"]
    return context


def _try_shutdown(*, context: Context | None = None) -> None:
    (context or _default_context(shutting_down=True)).try_shutdown()


def _executor() -> Executor:
    here = process()
    if "executor" not in here.values:
        here.values["executor"] = SingleThreadedExecutor(context=_default_context())
        here.at_end.append(here.values["executor"].shutdown)
    executor: Executor = here.values["executor"]
    return executor


FUNCTIONS: dict[Any, Any] = {
    rclpy.utilities.get_default_context: _default_context,
    rclpy.utilities.try_shutdown: _try_shutdown,
    rclpy.get_global_executor: _executor,
    rclpy.logging.get_logger: implementation.Logger,
}


def sleep(here: Process, seconds: float) -> None:
    """Let simulated time pass, in place of `time.sleep`."""
    here.world.wait(never, here.world.now_ns + max(0, int(seconds * 1e9)))


TIME: dict[str, Callable[..., Any]] = {
    "monotonic": lambda here: here.world.now_ns * 1e-9,
    "monotonic_ns": lambda here: here.world.now_ns,
    "perf_counter": lambda here: here.world.now_ns * 1e-9,
    "perf_counter_ns": lambda here: here.world.now_ns,
    "time": lambda here: here.wall_ns() * 1e-9,
    "time_ns": Process.wall_ns,
    "sleep": sleep,
}


def _simulated(real: Callable[..., Any], ours: Callable[..., Any]) -> Callable[..., Any]:
    """Simulated time for processes of a loopback, real time for other threads."""

    def call(*arguments: Any) -> Any:
        here = current.get()
        return real(*arguments) if here is None else ours(here, *arguments)

    return call


def _start(
    here: World, node: str, arguments: Sequence[str], environment: Mapping[str, str], output: str, errors: str
) -> Process:
    """Start a node in place of `forked.start`."""
    node_module = importlib.import_module(module_of(node))
    streams = [open(name, "a", buffering=1) for name in (output, errors)]  # noqa: SIM115, PTH123 (closed at its end)
    started = here.start(node, node_module.main, arguments, environment, *streams)
    started.at_end += [stream.close for stream in streams]
    return started


def _names(modules: Iterable[str]) -> Iterator[tuple[Any, str, Any]]:
    """All names of those modules that use the loopback: module, name, value."""
    for name in sorted(modules):
        if name.startswith(PATCHED) and not name.startswith(__package__ or ""):
            yield from (
                (sys.modules[name], global_name, value) for global_name, value in list(vars(sys.modules[name]).items())
            )


@lru_cache(maxsize=1)
def _places(modules: frozenset[str]) -> list[tuple[Any, str, Any]]:
    """Names of modules that are replaced: module, name, the loopback's value."""
    ours_of = {id(stand_in.module): stand_in for stand_in in STAND_INS} | {
        id(real): ours for real, ours in FUNCTIONS.items()
    }
    return [(module, name, ours_of[id(value)]) for module, name, value in _names(modules) if id(value) in ours_of]


@contextmanager
def opened(seed: int | None = None) -> Iterator[World]:
    """Open a loopback for the time of the context; `seed`: of the order of turns (World)."""
    here, before = World(seed), frozenset(sys.modules)
    with ExitStack() as patched:

        def put(module: Any, name: str, value: Any) -> None:
            patched.callback(setattr, module, name, getattr(module, name))
            setattr(module, name, value)

        for place in _places(before):
            put(*place)
        for name, ours in TIME.items():
            simulated = _simulated(getattr(time, name), ours)
            put(time, name, simulated)
            if name in clock.__all__:
                put(clock, name, simulated)
        kill = os.kill
        put(os, "kill", lambda pid, number: (here.signal if pid >= FIRST_PID else kill)(pid, number))
        put(run, "end_after", lambda *_: None)
        put(forked, "load", lambda: None)
        put(forked, "start", partial(_start, here))
        try:
            yield here
        finally:
            here.close()
    for module, name, value in _names(sys.modules.keys() - before):  # modules that were imported meanwhile
        if isinstance(value, StandIn):
            setattr(module, name, value.module)
        for real, ours in FUNCTIONS.items():
            if value is ours:
                setattr(module, name, real)
