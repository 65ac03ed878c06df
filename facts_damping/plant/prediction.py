"""Where the ports' sources are next: the start of each solution of the network; compiled.

A source moves along u(t) = s(x(t)). Halfway through a step of h the network is solved twice, before and beyond the
path: u -+ h^2 / 8 s' x''. This `SPREAD` changes little from step to step, as do the rate and the bend of u.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from facts_damping.compiling import compiled
from facts_damping.elementary.arithmetic import divided

if TYPE_CHECKING:
    from facts_damping.compiling.structs import Complex1, Complex2

RATE, BEND, SPREAD = range(3)  # rows of `PlantState.source_motion`, p.u./s and p.u./s^2, at the end of the last step
BEGIN, HALFWAY = range(2)  # rows of `Work.source_path`, p.u., of a step


@compiled
def moved(motion: Complex2, p: int, seconds: float) -> complex:
    """How far the source of port p moves from the end of the last step in `seconds`, also before it, p.u."""
    return seconds * (motion[RATE, p] + 0.5 * seconds * motion[BEND, p])  # type: ignore[no-any-return]


@compiled
def predict(part: int, h: float, ahead: bool, source: Complex1, motion: Complex2, path: Complex2) -> None:
    """Keep the sources' path in a step of h seconds; `ahead`: also move them to its next part, `part`."""
    half = 0.5 * h
    for p in range(source.size):
        if part == 1:
            path[BEGIN, p] = source[p]
            if ahead:
                source[p] += moved(motion, p, half) - 0.5 * half * half * motion[SPREAD, p]
        elif part == 2:
            path[HALFWAY, p] = source[p]
            if ahead:
                source[p] += half * half * motion[SPREAD, p]
        elif part == 3:
            motion[SPREAD, p] = divided(source[p] - path[HALFWAY, p], half * half)
            path[HALFWAY, p] = 0.5 * (path[HALFWAY, p] + source[p])
            if ahead:
                source[p] = 2.0 * path[HALFWAY, p] - path[BEGIN, p] + half * half * motion[BEND, p]


@compiled
def keep_motion(h: float, end: Complex1, motion: Complex2, path: Complex2) -> None:
    """Write the rate and the bend of the sources at the end of a step of h seconds: those of a square."""
    half = 0.5 * h
    for p in range(end.size):
        first, second = divided(path[HALFWAY, p] - path[BEGIN, p], half), divided(end[p] - path[HALFWAY, p], half)
        motion[BEND, p] = divided(second - first, half)
        motion[RATE, p] = second + 0.5 * (second - first)
