"""Entry points of `ros2 run facts_damping NODE`: compile kernels if needed, load the node, run it."""

from __future__ import annotations

import importlib
import os
import signal
from typing import TYPE_CHECKING

from facts_damping.interruption import INTERRUPTIONS, heeded

if TYPE_CHECKING:
    from collections.abc import Callable


def _start(node: str, *, computes: bool = True) -> None:
    """Load and run a node; `computes`: it needs kernels, which are compiled if this machine has none."""
    for number in heeded():
        signal.signal(number, lambda *_: os._exit(0))  # until the node handles signals: nothing to clean up yet
    signal.pthread_sigmask(signal.SIG_UNBLOCK, INTERRUPTIONS)  # a launch blocks them until here
    if computes:
        importlib.import_module("facts_damping.nodes.base.warmup").compile_or_exit(node)
    importlib.import_module(f"facts_damping.nodes.{node}").main()


def _entry_point(node: str, *, computes: bool = True) -> Callable[[], None]:
    return lambda: _start(node, computes=computes)


plant_sim = _entry_point("plant_sim")
wan_link = _entry_point("wan_link")
controller = _entry_point("controller")
identifier = _entry_point("identifier")
supervisor = _entry_point("supervisor")
c37118_server = _entry_point("c37118_server")
c37118_client = _entry_point("c37118_client")
recorder = _entry_point("recorder", computes=False)
live_view = _entry_point("live_view", computes=False)
cockpit = _entry_point("cockpit", computes=False)
