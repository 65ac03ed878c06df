"""Ranking of places: all at once, the best again with the device installed, until all that count are.

Those that count are the strongest for each mode, the strongest in series and in parallel for the target, the places of
the pairs, and the devices of the system itself.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from facts_damping.devices.base import Parallel, Series
from facts_damping_studies.design import at_once, places
from facts_damping_studies.design.places import Trial, Tried
from facts_damping_studies.sweeps.pool import run_all

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from facts_damping.parameters.plant.system import System
    from facts_damping.small_signal.eigenmodes import Eigenmode
    from facts_damping_studies.design.places import Place

BEST = 6  # places of each sort that are analysed with the device
LARGE = 500  # buses from which on that pays in several processes


def ranked(
    system: System,
    candidates: Sequence[Place],
    modes: Sequence[Eigenmode],
    target: int,
    paired: Callable[[Sequence[Tried]], set[int]],
    jobs: int,
    progress: Callable[[int, int], None],
) -> list[Tried]:
    """Analyses of all places. `paired`: indices of those of the best pairs."""
    trials = [Trial(system, candidate, modes) for candidate in candidates]
    new = [i for i, candidate in enumerate(candidates) if not candidate.own]
    effect = at_once.effects(system, [candidates[i].device for i in new], modes)
    observability = places.seen(system, modes)
    found: dict[int, Tried] = {}
    for j, i in enumerate(new):
        why_not = effect.why_not[j]
        about = Tried(candidates[i], effect.controllability[:, j], observability)
        found[i] = places.not_tried(trials[i], why_not) if why_not else about
    near = dict(zip(new, effect.values.T.tolist(), strict=True))
    exact = {i for i in found if found[i].why_not}
    again = {i for i, candidate in enumerate(candidates) if candidate.own}
    jobs = jobs if len(system.buses) > LARGE else 1
    while again:
        some = sorted(again)
        found |= zip(some, run_all(_again, [(trials[i], near.get(i)) for i in some], jobs, progress), strict=True)
        exact |= again
        tried = [found[i] for i in range(len(trials))]
        again = (_strongest(tried, target) | paired(tried)) - exact
    return [found[i] for i in range(len(trials))]


def _again(task: tuple[Trial, Sequence[complex] | None]) -> Tried:
    return places.tried(*task)


def _strongest(tried: Sequence[Tried], target: int) -> set[int]:
    """The strongest places for each mode, and in series and in parallel for the target."""
    strength = np.nan_to_num(np.array([attempt.strength for attempt in tried]))
    best = {int(i) for column in strength.T for i in np.argsort(-column)[:BEST]}
    for sort in (Series, Parallel):
        of_sort = [i for i, attempt in enumerate(tried) if isinstance(attempt.place.device, sort)]
        best |= set(sorted(of_sort, key=lambda i: -strength[i, target])[:BEST])
    return {i for i in best if strength[i].any()}
