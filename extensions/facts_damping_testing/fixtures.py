"""For tests of nodes, including the user's own: a graph in this process, without DDS, in simulated time.

`loopback` is a pytest fixture: `from facts_damping.testing import loopback`. During the test `rclpy` and this package's
nodes run on it, and `time.sleep` lets simulated time pass (docs/extensions.md).
"""

from __future__ import annotations

import os
import sys
from typing import TYPE_CHECKING, Any

import pytest

from facts_damping.api.cases import case_of
from facts_damping.api.results import Result, load_recording
from facts_damping.nodes.launching import graph
from facts_damping_testing.loopback import opening

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence
    from os import PathLike
    from pathlib import Path

    from facts_damping_testing.loopback.processes import Process, World

__all__ = ["Loopback", "loopback"]


class Loopback:
    """A graph in this process."""

    def __init__(self, world: World) -> None:
        """Called by the fixture."""
        self._world = world

    def start(self, name: str, main: Callable[[], Any], arguments: Sequence[str] = ()) -> Process:
        """Start a node by its entry point; it runs while this thread waits, and ends with the test.

        `name`: its name in errors; `arguments`: as on a command line (`--ros-args ...`).
        """
        return self._world.start(name, main, arguments, os.environ, sys.stdout, sys.stderr)

    def run(
        self, run: str | PathLike[str] | None, out: Path, mode: str = "lockstep", timeout: float = 5.0, **fields: Any
    ) -> Result:
        """Run a graph as `facts-damping run --out` does, and load its recording.

        `fields`: of the run, as in `facts_damping.simulate`; a controller with a node of your own is `external` there.
        Raises `InputError`, and `RunError` naming a node that ended or stays silent.
        """
        outcome = graph.run(case_of(run, fields), mode, out, lambda _done, _of: None, timeout)
        return load_recording(outcome.recording)


@pytest.fixture
def loopback() -> Iterator[Loopback]:
    """A graph in this process."""
    with opening.opened() as world:
        yield Loopback(world)
