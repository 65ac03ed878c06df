"""Log of a node: ROS 2 log messages, and lines for the program that started it."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING

from facts_damping.escaping import escaped
from facts_damping.nodes.base.parameters import declare, descriptor

if TYPE_CHECKING:
    from rclpy.node import Node


class NodeLog:
    """Writes ROS 2 log messages and, with parameter `progress`, lines on standard output for a calling program."""

    def __init__(self, node: Node) -> None:
        text = "true: progress and reasons as lines on standard output and error, for a program that runs the graph"
        if not node.has_parameter("progress"):
            declare(node, "progress", False, descriptor(text))
        self._name, self._logger = node.get_fully_qualified_name().lstrip("/"), node.get_logger()
        self.lines = bool(node.get_parameter("progress").value)

    def line(self, text: str, *, always: bool = False) -> None:
        """Write a line for the program; `always`: also for a user, but not in the log."""
        if self.lines or always:
            sys.stdout.write(f"{escaped(text)}\n")
            sys.stdout.flush()

    def report(self, text: str) -> None:
        """Write a line and log it at level info."""
        self.line(text)
        self.info(text)

    def info(self, text: str) -> None:
        """Log a message at level info."""
        self._logger.info(escaped(text))

    def warning(self, text: str) -> None:
        """Log a warning."""
        self._logger.warning(escaped(text))

    def error(self, text: str) -> None:
        """Log an error and write it as a line."""
        self.line(text)
        self._logger.error(escaped(text))

    def fatal(self, text: str, details: str) -> None:
        """Log why the node ends; `details`: traceback lines for standard error."""
        self._logger.fatal(escaped(text))
        sys.stderr.write(escaped(details))
        if self.lines:
            sys.stderr.write(f"{self._name}: {escaped(text)}\n")
