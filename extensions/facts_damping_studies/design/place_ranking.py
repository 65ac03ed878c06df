"""Ranking of places: all at once, the best again with the device installed, until all that count are.

Those that count are the places of the pairs, the devices of the system itself, and unless the grid is large the
strongest for each mode, the strongest in series and in parallel for the target, and where a device is impossible.
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

    from facts_damping.compiling.structs import Complex2
    from facts_damping.parameters.plant.system import System
    from facts_damping.small_signal.eigenmodes import Eigenmode
    from facts_damping_studies.design.places import Place

BEST = 6  # places of each sort that are analysed with the device
LARGE = 500  # buses above which that takes seconds for each, so that it pays in several processes


def ranked(
    system: System,
    observability: Complex2,
    candidates: Sequence[Place],
    modes: Sequence[Eigenmode],
    target: int,
    paired: Callable[[Sequence[Tried]], set[int]],
    jobs: int,
    progress: Callable[[int, int], None],
) -> list[Tried]:
    """Analyses of all places. `observability`: of the signals; `paired`: indices of the places of the best pairs."""
    trials = [Trial(system, candidate, modes) for candidate in candidates]
    new = [i for i, candidate in enumerate(candidates) if not candidate.own]
    effect = at_once.effects(system, [candidates[i].device for i in new], modes)
    tried = [places.not_tried(trial, "") for trial in trials]
    for j, i in enumerate(new):
        about = Tried(candidates[i], effect.controllability[:, j], observability)
        tried[i] = places.not_tried(trials[i], effect.why_not[j]) if effect.why_not[j] else about
    near = {i: None if tried[i].why_not else effect.values[:, j].tolist() for j, i in enumerate(new)}
    large = len(system.buses) > LARGE
    impossible = {i for i in new if tried[i].why_not}
    exact = impossible if large else set[int]()
    again = set(range(len(trials))) - set(new) | impossible - exact
    while again := (again | (set() if large else _strongest(tried, target)) | paired(tried)) - exact:
        some = sorted(again)
        analysed = run_all(_again, [(trials[i], near.get(i)) for i in some], jobs if large else 1, progress)
        for i, attempt in zip(some, analysed, strict=True):
            tried[i] = attempt
        exact = exact | again
    return tried


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
