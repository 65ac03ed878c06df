"""The mirror of a run: the same run with all noise of the opposite sign, of loads and of PMUs.

Half the sum of a run and its mirror is the response to the events. Where the loop is linear, noise cancels in it
exactly; elsewhere terms of even order in the noise remain. These are antithetic variates (J. M. Hammersley and
K. W. Morton, A new Monte Carlo technique: antithetic variates, Proc. Cambridge Phil. Soc. 52 (1956) 449-475).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from facts_damping.case.loading import recorded_case
from facts_damping.control.table import kind_of
from facts_damping.errors import FactsDampingError
from facts_damping.simulation.changes import rerun
from facts_damping.simulation.loop import build_loop, finish

if TYPE_CHECKING:
    from facts_damping.case.model import Case
    from facts_damping.signals import Record
    from facts_damping.simulation.tick import Loop


def noisy(loop: Loop) -> bool:
    """Whether a loop's loads or PMUs have noise."""
    return len(loop.plant.load_noise) > 1 or len(loop.pmus.normal) > 1


def mirrored(loop: Loop) -> Loop:
    """A loop with all noise of the opposite sign."""
    plant = loop.plant._replace(load_noise=-loop.plant.load_noise)
    return loop._replace(plant=plant, pmus=loop.pmus._replace(normal=-loop.pmus.normal))


def mirror(case: Case, loop: Loop) -> Record | None:
    """The mirror of a case's run; `loop`: the case's, not yet run. None without noise or events."""
    return finish(case, mirrored(loop)) if case.scenario.events and noisy(loop) else None


def mirror_of(record: Record) -> Record | None:
    """The mirror of a recorded run, simulated in process with its changes.

    None if the run has no noise or no events, or cannot be simulated: parts of it are missing or came from outside.
    """
    if record.notes or not (record.configuration.get("scenario") or record.events):
        return None
    try:
        case = recorded_case(record.configuration, "recording")
        if any(kind_of(one).node for one in case.controllers):
            return None
        loop = build_loop(case)
    except FactsDampingError:
        return None
    if not noisy(loop):
        return None
    return rerun(case, record.changes, mirrored(loop)) if record.changes else finish(case, mirrored(loop))
