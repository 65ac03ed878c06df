"""File of a node's adapted weights."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from facts_damping.case.controllers import with_weights
from facts_damping.errors import InputError, RunError
from facts_damping.nodes import clock
from facts_damping.nodes.base.parameters import declare, descriptor
from facts_damping.output.writing import write_whole
from facts_damping.parameters.files import check_writable
from facts_damping.parameters.yaml_text import dump

if TYPE_CHECKING:
    from collections.abc import Callable

    from rclpy.node import Node

    from facts_damping.case.model import Case
    from facts_damping.parameters.run import Weights

SAVE_S = 10.0  # wall time between two writes


class WeightsFile:
    """File of a node's adapted weights, updated periodically so that a killed node leaves it behind."""

    def __init__(self, node: Node) -> None:
        text = "file for the adapted weights, written every 10 s and at the end; empty: none"
        name = str(declare(node, "save", "", descriptor(text)))
        text = "true: start with the weights in the file of `save`, if it exists"
        resume: bool = declare(node, "resume", False, descriptor(text))
        check_writable(name or None, "save")
        if resume and not name:
            raise InputError("resume: true given; allowed: with save")
        self._path, self._resume = Path(name) if name else None, bool(resume)
        self._saved, self.resumed = clock.monotonic(), False

    def start(self, case: Case, index: int) -> Case:
        """The case with the saved weights in controller `index`; unchanged without `resume` or if there is no file."""
        if self._path is None or not self._resume or not self._path.is_file():
            return case
        controllers = list(case.controllers)
        controllers[index], self.resumed = with_weights(controllers[index], self._path), True
        return replace(case, controllers=controllers)

    def keep(self, learnt: Callable[[], Weights | None], last: bool = False) -> None:
        """Write the weights atomically, every `SAVE_S` and at the `last` call, which alone may raise `RunError`."""
        if self._path is None or not (last or clock.monotonic() - self._saved > SAVE_S):
            return
        self._saved = clock.monotonic()
        if (weights := learnt()) is None:
            return
        try:
            write_whole(self._path, dump(weights.model_dump()))
        except OSError as error:  # such as a full disk: no reason to stop during the run
            if last:
                raise RunError(f"save: {self._path}: cannot be written: {error.strerror}") from error
