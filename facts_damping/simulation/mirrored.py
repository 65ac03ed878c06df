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


def has_mirror(case: Case) -> bool:
    """Whether a run has events, and noise of loads or PMUs, so that its mirror differs from it."""
    noises = [case.measurement.noise, *(one.noise for one in case.measurement.pmus.values() if one.noise)]
    noisy = case.run.load_noise is not None or any(any(noise.model_dump().values()) for noise in noises)
    return bool(case.scenario.events) and noisy


def mirrored(loop: Loop) -> Loop:
    """A loop with all noise of the opposite sign."""
    plant = loop.plant._replace(load_noise=-loop.plant.load_noise)
    return loop._replace(plant=plant, pmus=loop.pmus._replace(normal=-loop.pmus.normal))


def mirror_of(record: Record) -> Record | None:
    """The mirror of a recorded run, simulated in process with its changes.

    None if the run has no noise or no events, or cannot be simulated: parts of it are missing or came from outside.
    """
    if record.notes or not (record.configuration.get("scenario") or record.events):
        return None
    try:
        case = recorded_case(record.configuration, "recording")
        if any(kind_of(one).node for one in case.controllers) or not (has_mirror(case) or record.changes):
            return None
        loop = mirrored(build_loop(case))
        return rerun(case, record.changes, loop) if record.changes else finish(case, loop)
    except FactsDampingError:
        return None
