"""A user's own nodes, started by a command and stopped with the graph."""

from __future__ import annotations

import os
import signal
import subprocess
from contextlib import suppress
from typing import IO, TYPE_CHECKING

from facts_damping.case.names import controller_addresses, link_addresses
from facts_damping.interruption import tie_to_parent

if TYPE_CHECKING:
    from collections.abc import Mapping

    from facts_damping.case.model import Case


def command(case: Case, c: int, graph: str = "") -> list[str]:
    """Command line of a controller's node, with name, namespace, topic and parameters as ROS arguments.

    `graph`: namespace of the graph, without slashes around it.
    """
    controller, address = case.controllers[c], controller_addresses(case)[c]
    delivered = link_addresses(case)[case.used_links[c]].topic("pmu/delivered")
    namespace = "/".join(part for part in (graph, address.namespace) if part)
    arguments = ["-r", f"__node:={address.name}", "-r", f"__ns:=/{namespace}"]
    arguments += ["-r", f"pmu/delivered:=/{graph}/{delivered}" if graph else f"pmu/delivered:=/{delivered}"]
    for name, value in controller.parameters.items():
        arguments += ["-p", f"{name}:={value}"]
    return [*(controller.command or []), "--ros-args", *arguments]


class Command:
    """A running command with the process interface that `graph` uses; its child processes end with it."""

    def __init__(self, arguments: list[str], environment: Mapping[str, str], output: IO[bytes]) -> None:
        self._process = subprocess.Popen(
            arguments,
            stdin=subprocess.DEVNULL,
            stdout=output,
            stderr=output,
            env=environment,
            start_new_session=True,
            preexec_fn=tie_to_parent,  # noqa: PLW1509 (it calls the kernel alone)
        )
        self.pid = self._process.pid

    @property
    def exitcode(self) -> int | None:
        """Exit status; None: it still runs."""
        return self._process.poll()

    def join(self, timeout: float | None = None) -> None:
        """Wait until it ends, then kill processes that it left running."""
        with suppress(subprocess.TimeoutExpired):
            self._process.wait(timeout)
        if self._process.poll() is not None:
            self.kill()

    def kill(self) -> None:
        """Kill it and its whole process group."""
        with suppress(ProcessLookupError):
            os.killpg(self.pid, signal.SIGKILL)
