"""The mildest form of a case that still violates an invariant.

What can be left out is left out: the fault, what was chosen beside the base run, the seed. Then the fault ends sooner,
begins at a rounder time, and gets smaller. Each step is kept if the margin is still below zero and no smaller than
before (D. R. MacIver, A. F. Donaldson, Test-Case Reduction via Test-Case Generation, ECOOP 2020).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from facts_damping_studies.campaigns.faults import FAULTS, NOTHING

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from facts_damping_studies.campaigns.campaign import Choice

    Point = tuple[Choice, list[float]]  # choice, and numbers from 0 to 1 for the size of its fault
    Step = Callable[[Choice, list[float]], Iterator[Point]]

DURATIONS = (0.1, 0.2, 0.5, 1.0, 2.0, 5.0)  # s
PARTS = (0.0, 0.125, 0.25, 0.5, 0.75)  # of the distance of a size from the mildest


def shrunk(
    choice: Choice, sizes: list[float], margin_of: Callable[[Choice, list[float]], float]
) -> tuple[Point, float]:
    """The mildest form of a case that violates an invariant, and its margin.

    `margin_of(choice, sizes)`: the margin of a case, infinity if it cannot be run.
    """
    mildest = choice, sizes
    worst = margin = margin_of(*mildest)
    for step in steps(choice, sizes):
        for milder in step(*mildest):
            reached = margin_of(*milder)
            if worst <= reached < 0.0:
                mildest, margin = milder, reached
                break
    return mildest, margin


def steps(choice: Choice, sizes: list[float]) -> list[Step]:
    """What is tried, in this order: each gives milder points, the mildest first."""
    labels = [lambda chosen, of, name=name: _unchosen(chosen, of, name) for name in choice.chosen]
    parts = [lambda chosen, of, i=i: _smaller(chosen, of, i) for i in range(len(sizes))]
    return [_without_fault, *labels, _seed_of_base_run, _shorter, _rounder, *parts]


def _without_fault(choice: Choice, _sizes: list[float]) -> Iterator[Point]:
    if choice.fault != NOTHING:
        yield choice._replace(fault=NOTHING, duration=None), []


def _unchosen(choice: Choice, sizes: list[float], name: str) -> Iterator[Point]:
    yield choice._replace(chosen={other: label for other, label in choice.chosen.items() if other != name}), sizes


def _seed_of_base_run(choice: Choice, sizes: list[float]) -> Iterator[Point]:
    yield choice._replace(seed=None), sizes


def _shorter(choice: Choice, sizes: list[float]) -> Iterator[Point]:
    for duration in DURATIONS:
        if choice.fault != NOTHING and (choice.duration is None or duration < choice.duration):
            yield choice._replace(duration=duration), sizes


def _rounder(choice: Choice, sizes: list[float]) -> Iterator[Point]:
    for digits in (0, 1, 2):
        if choice.fault != NOTHING and (start := round(choice.start, digits)) > 0.0:
            yield choice._replace(start=start), sizes


def _smaller(choice: Choice, sizes: list[float], i: int) -> Iterator[Point]:
    mild: Any = FAULTS[choice.fault].mild
    for part in PARTS if i < len(sizes) else ():
        yield choice, [*sizes[:i], mild + part * (sizes[i] - mild), *sizes[i + 1 :]]
