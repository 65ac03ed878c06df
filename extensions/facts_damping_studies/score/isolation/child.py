"""The process of a controller, from its fork to its end: confined, then the controller is made and takes its steps."""

from __future__ import annotations

import json
import os
import pickle
import secrets
import sys
import traceback
from dataclasses import dataclass, field
from functools import cache, cached_property
from typing import TYPE_CHECKING, Any, NoReturn, cast

from facts_damping.errors import InputError, one_line
from facts_damping.interruption import exit_now
from facts_damping.simulation.programs import fmus, user_code
from facts_damping.simulation.programs.policies import checked, instance
from facts_damping_studies.score.isolation import messages, refusals
from facts_damping_studies.score.isolation.confinement import confine
from facts_damping_studies.score.isolation.readable import file_of_fmu

if TYPE_CHECKING:
    from collections.abc import Callable

    import numpy as np
    from numpy.typing import NDArray

    from facts_damping.simulation.programs.spec import Spec
    from facts_damping.small_signal.linear_plant import LinearPlant
    from facts_damping_studies.score.isolation.messages import Begin

CONNECTION = 3  # file descriptor
BREACHED = 3  # exit status
_scattered: list[bytes] = []  # so that addresses of objects do not tell how often the template was asked


@dataclass(frozen=True)
class KnownSpec:
    """What a controller knows that is scored: as `simulation.programs.spec.Spec`, without the system."""

    name: str
    signals: list[str]
    devices: list[str]
    limits: NDArray[np.float64]
    rates: NDArray[np.float64]
    frame_rate: int
    seed: int
    parameters: dict[str, Any]
    ask: Callable[[], LinearPlant] = field(repr=False)

    @cached_property
    def plant(self) -> LinearPlant:
        """The linearised plant that controllers are designed on, at the start."""
        return self.ask()


def run(connection: int) -> NoReturn:
    """Be the process of a controller, from after the fork to the end; `connection`: its only way to the run."""
    try:
        _scattered.extend(bytes(secrets.randbelow(512)) for _ in range(secrets.randbelow(4096)))
        _leave_files(connection)
        content = messages.read_frame(CONNECTION)
        if content is not None:
            _serve(pickle.loads(content))  # noqa: S301 (of the run, which is trusted)
    except BaseException as error:  # noqa: BLE001 (nothing returns into the template)
        _send(messages.ERROR, one_line(error) + "".join(traceback.format_exception(error)[-3:]))
    exit_now(0)


def _leave_files(connection: int) -> None:
    """Close all files of the template but the connection; standard streams lead nowhere."""
    os.dup2(connection, CONNECTION)
    os.closerange(CONNECTION + 1, os.sysconf("SC_OPEN_MAX"))
    nowhere = os.open(os.devnull, os.O_RDWR)
    for stream in range(CONNECTION):
        os.dup2(nowhere, stream)
    os.close(nowhere)


def _send(kind: bytes, content: str | bytes = b"") -> None:
    os.write(CONNECTION, messages.frame(kind + (content.encode() if isinstance(content, str) else content)))


def _breach(sentence: str) -> NoReturn:
    _send(messages.BREACH, sentence[: messages.MOST_TEXT])
    exit_now(BREACHED)


@cache
def _plant() -> LinearPlant:
    """Ask the run for the plant, once."""
    _send(messages.PLANT)
    content = messages.read_frame(CONNECTION)
    if content is None:
        exit_now(0)
    return cast("LinearPlant", pickle.loads(content))  # noqa: S301 (of the run, which is trusted)


def _serve(begin: Begin) -> None:
    """Confine this process, make the controller, and answer each step until the run ends."""
    os.chdir(begin.folder)
    sys.argv, sys.path[:] = [""], begin.path
    readable, controller = begin.readable, begin.controller
    user_code.running.watched = True  # by the run, not by a thread here
    try:
        native = controller is not None and controller.fmu is not None
        if controller is not None and native:
            folder = fmus.unpacked(file_of_fmu(controller), begin.where)[0].name
            readable = readable._replace(folders=(*readable.folders, os.path.realpath(folder)))
        _send(messages.CONFINED, json.dumps([*confine(readable, begin.memory, native=native), "audit hook"]))
        if controller is None:
            return
        spec = KnownSpec(**begin.facts, ask=_plant)
        built = refusals.install(readable, native, _breach)
        file, step, once = instance(controller, cast("Spec", spec), begin.where)
    except InputError as error:
        _send(messages.ERROR, str(error)[: messages.MOST_TEXT])
        return
    _send(messages.READY, json.dumps([once, built()]))
    signals, devices = len(spec.signals), list(spec.devices)
    while content := messages.read_frame(CONNECTION):
        try:
            with user_code.running:
                u = step(*messages.step_of(content, signals))
            answer = content[-messages.TOKEN :] + checked(u, devices).tobytes()
        except BaseException as error:  # noqa: BLE001 (all that the user's code raises ends the run)
            _send(messages.ERROR, user_code.described(error, file)[: messages.MOST_TEXT])
            return
        _send(messages.SETPOINTS, answer)
