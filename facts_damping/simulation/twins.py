"""The twins of a run with noise, from which its response to the events is computed (analysis/response.py).

They are its mirror, which is the same run with all noise, of loads and of PMUs, of the opposite sign, the run without
events, and that run's mirror. Mirrors are antithetic variates (J. M. Hammersley and K. W. Morton, A new Monte Carlo
technique: antithetic variates, Proc. Cambridge Phil. Soc. 52 (1956) 449-475).
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from facts_damping.analysis.response import noisy
from facts_damping.case.loading import recorded_case
from facts_damping.control.table import kind_of
from facts_damping.errors import FactsDampingError
from facts_damping.simulation.changes import rerun
from facts_damping.simulation.loop import build_loop, finish

if TYPE_CHECKING:
    from collections.abc import Callable

    from facts_damping.case.model import Case
    from facts_damping.signals import Record, RunChange
    from facts_damping.simulation.tick import Loop

EVENTS = ("event", "reset")  # changes that a run without events does not have


def mirrored(loop: Loop) -> Loop:
    """A loop with all noise of the opposite sign."""
    plant = loop.plant._replace(load_noise=-loop.plant.load_noise)
    return loop._replace(plant=plant, pmus=loop.pmus._replace(normal=-loop.pmus.normal))


def without_events(case: Case) -> Case:
    """A case without its events."""
    return replace(case, scenario=case.scenario.model_copy(update={"events": []}))


def twins(case: Case, record: Record, fresh: Callable[[Case], Loop] = build_loop) -> list[Record]:
    """The twins of a run: its mirror, the run without events, and that run's mirror; empty without events or noise.

    `fresh` builds loops.
    """
    happens = case.scenario.events or any(change.kind in EVENTS for change in record.changes)
    if not (happens and noisy(record.configuration)):
        return []

    def run(case: Case, changes: list[RunChange], *, mirror: bool) -> Record:
        loop = mirrored(fresh(case)) if mirror else fresh(case)
        return rerun(case, changes, loop) if changes else finish(case, loop)

    calm, kept = without_events(case), [change for change in record.changes if change.kind not in EVENTS]
    return [run(case, record.changes, mirror=True), *(run(calm, kept, mirror=mirror) for mirror in (False, True))]


def twins_of(record: Record) -> list[Record]:
    """The twins of a recorded run, simulated in process with its changes.

    Empty without noise or events, and if the run cannot be simulated: parts of it are missing or came from outside.
    """
    if record.notes or not (record.configuration.get("scenario") or record.events):
        return []
    try:
        over = {"duration": len(record.time_ns) / record.frame_rate}  # it may have been stopped
        case = recorded_case({**record.configuration, **over}, "recording")
        return [] if any(kind_of(one).node for one in case.controllers) else twins(case, record)
    except FactsDampingError:
        return []
