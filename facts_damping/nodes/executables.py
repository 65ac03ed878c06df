"""Entry points of `ros2 run facts_damping NODE`: compile kernels if needed, load the node, run it."""

from __future__ import annotations

import importlib
import os
import signal

from facts_damping.terminal import INTERRUPTIONS, heeded


def _start(node: str, *, computes: bool = True) -> None:
    """Load and run a node; `computes`: it needs kernels, which are compiled if this machine has none."""
    for number in heeded():
        signal.signal(number, lambda *_: os._exit(0))  # until the node handles signals: nothing to clean up yet
    signal.pthread_sigmask(signal.SIG_UNBLOCK, INTERRUPTIONS)  # a launch blocks them until here
    if computes:
        importlib.import_module("facts_damping.nodes.base.warmup").compile_once()
    importlib.import_module(f"facts_damping.nodes.{node}").main()


def plant_sim() -> None:
    """Entry point of `ros2 run facts_damping plant_sim`."""
    _start("plant_sim")


def wan_link() -> None:
    """Entry point of `ros2 run facts_damping wan_link`."""
    _start("wan_link")


def controller() -> None:
    """Entry point of `ros2 run facts_damping controller`."""
    _start("controller")


def identifier() -> None:
    """Entry point of `ros2 run facts_damping identifier`."""
    _start("identifier")


def supervisor() -> None:
    """Entry point of `ros2 run facts_damping supervisor`."""
    _start("supervisor")


def recorder() -> None:
    """Entry point of `ros2 run facts_damping recorder`."""
    _start("recorder", computes=False)


def live_view() -> None:
    """Entry point of `ros2 run facts_damping live_view`."""
    _start("live_view", computes=False)


def c37118_server() -> None:
    """Entry point of `ros2 run facts_damping c37118_server`."""
    _start("c37118_server")


def c37118_client() -> None:
    """Entry point of `ros2 run facts_damping c37118_client`."""
    _start("c37118_client")
