"""Parts of loops that are built one after the other in a process: one that is made of the same data begins again."""

from __future__ import annotations

import threading
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import numpy as np

from facts_damping.caching import shared
from facts_damping.compiling.structs import Struct, Table
from facts_damping.simulation.assembly import needs_residues

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from numpy.typing import NDArray

    from facts_damping.case.model import Case

MANY = 4  # parts that a thread keeps: those of a run and of its twin, and of one beside it
LARGEST = 1 << 24  # bytes of one


def arrays_in(part: Any) -> Iterator[NDArray[Any]]:
    """All arrays in structs and tuples of structs."""
    if isinstance(part, np.ndarray):
        yield part
    elif isinstance(part, (Struct, Table, tuple)):
        for inside in part:
            yield from arrays_in(inside)


def of_frames(case: Case, *, draws: bool = True) -> str:
    """What PMUs and links are made of; `draws`: with the seed of their random numbers."""
    system, links = case.system, [link.model_dump_json() for link in case.links]
    pmus, signals = [pmu.model_dump_json() for pmu in system.pmus], list(system.signals.items())
    devices = case.run.devices, sum(len(controller.devices) for controller in case.controllers)
    others = case.used_links, devices, system.frequency, case.run.frame_rate, case.ticks, draws and case.run.seed
    return f"{case.measurement.model_dump_json()} {links} {pmus} {signals} {others}"


def of_control(case: Case) -> str:
    """What controllers, identifiers and supervisors are made of; the seed where they draw random numbers."""
    draws = any(controller.scheme or controller.faults for controller in case.controllers)
    run = case.run.model_dump_json(exclude={"seed", "asked", "scenario", "system", "model", "load_noise", "duration"})
    rows = [row.model_dump_json() for row in (*case.controllers, *case.system.devices)]
    supervision = case.supervision and case.supervision.model_dump_json()
    plant = case.designed_on.model_dump_json() if needs_residues(case) else ""
    return f"{run} {rows} {supervision} {of_frames(case, draws=draws)} {plant}"


MADE_OF = {"frames": of_frames, "control": of_control}  # links and PMUs; controllers, identifiers and supervisors


class Parts(threading.local):
    """Parts of the loops that this thread built last; a loop that uses them ends the life of those before."""

    lent = False

    def __init__(self) -> None:
        self._known: dict[str, tuple[Any, list[tuple[NDArray[Any], NDArray[Any]]]]] = {}

    def again(self, name: str, case: Case, make: Callable[[Case], Any]) -> Any:
        """A case's part of a name in `MADE_OF`, at its start: a known one if it was made of the same data."""
        data = f"{name} {MADE_OF[name](case)}"
        if data not in self._known:
            part = make(case)
            arrays = list(arrays_in(part))
            if sum(array.nbytes for array in arrays) <= LARGEST:
                starts = [(array, array.copy()) for array in arrays]
                shared(self._known, data, lambda: (part, starts), maximum=MANY)
            return part
        self._known[data] = part, starts = self._known.pop(data)  # the newest
        for array, start in starts:
            array[...] = start
        return part


def new(_name: str, case: Case, make: Callable[[Case], Any]) -> Any:
    """A part that no other loop uses."""
    return make(case)


_parts = Parts()


@contextmanager
def lent() -> Iterator[Callable[..., Any]]:
    """Make parts (`Parts.again`) of a loop that ends within; new ones for another that a program of it runs."""
    if _parts.lent:
        yield new
        return
    _parts.lent = True
    try:
        yield _parts.again
    finally:
        _parts.lent = False
