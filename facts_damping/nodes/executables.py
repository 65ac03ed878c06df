"""Entry points of `ros2 run facts_damping NODE`: compile kernels if needed, load the node, run it."""

from __future__ import annotations

import importlib
import os
import signal
from typing import TYPE_CHECKING

from facts_damping.extensions import given
from facts_damping.interruption import INTERRUPTIONS, heeded

if TYPE_CHECKING:
    from collections.abc import Callable


def module_of(node: str) -> str:
    """Module of a node, by its name: here, or in another package (entry point of the group `facts_damping.nodes`)."""
    row = given("nodes").get(node)
    return f"facts_damping.nodes.{node}" if row is None or node in globals() else row.value


def _start(module: str, *, computes: bool = True) -> None:
    """Load and run a node; `computes`: it needs kernels, which are compiled if this machine has none."""
    for number in heeded():
        signal.signal(number, lambda *_: os._exit(0))  # until the node handles signals: nothing to clean up yet
    signal.pthread_sigmask(signal.SIG_UNBLOCK, INTERRUPTIONS)  # a launch blocks them until here
    if computes:
        importlib.import_module("facts_damping.nodes.base.warmup").compile_or_exit(module.rpartition(".")[2])
    importlib.import_module(module).main()


def entry_point(module: str, *, computes: bool = True) -> Callable[[], None]:
    """The function that starts a node, given by its module; `computes`: as of `_start`."""
    return lambda: _start(module, computes=computes)


plant_sim = entry_point("facts_damping.nodes.plant_sim")
wan_link = entry_point("facts_damping.nodes.wan_link")
controller = entry_point("facts_damping.nodes.controller")
identifier = entry_point("facts_damping.nodes.identifier")
supervisor = entry_point("facts_damping.nodes.supervisor")
recorder = entry_point("facts_damping.nodes.recorder", computes=False)
