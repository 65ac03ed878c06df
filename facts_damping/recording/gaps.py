"""Ticks that a recording lacks, because a node was absent or messages are missing."""

from __future__ import annotations

from collections import Counter
from itertools import islice
from typing import TYPE_CHECKING

import numpy as np

from facts_damping.record import Absence
from facts_damping.recording import decode

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from numpy.typing import NDArray

    from facts_damping.record import RunChange
    from facts_damping.recording.decode import Series

OF_LINKS = ("delivered", "applied")  # each link has its own topics of these kinds
ROLES = {
    **dict.fromkeys(OF_LINKS, "link"),
    **dict.fromkeys(("issued", "learning"), "controller"),
    **dict.fromkeys(("supervised", "supervision"), "supervisor"),
    "estimates": "identifier",
}
# Inputs and outputs of controllers.
NEEDED_FOR_REPLAY = ("delivered", "issued", "learning", "supervised", "supervision", "estimates")
OF_PLANT = ("frames", "state")  # topics that have a message at every tick
LISTED = 5  # number of missing ticks that are listed


def late_starts(changes: Sequence[RunChange]) -> set[tuple[str, int, int]]:
    """Role, index and first tick of nodes that began after the run."""
    return {(change.role, change.index, change.tick) for change in changes if change.kind == "start"}


def first_complete_tick(series: dict[str, list[Series]], late: set[tuple[str, int, int]]) -> int:
    """First tick at which the series of all nodes that were present then have begun."""
    firsts = [(_owner(kind, i, part), int(part.ticks[0])) for kind, i, part in _of_nodes(series) if len(part.ticks)]
    return max([tick for owner, tick in firsts if not list(_begins(late, owner, 0, tick))], default=0)


def find_absences(
    series: dict[str, list[Series]], late: set[tuple[str, int, int]], first: int, end: int
) -> list[Absence]:
    """Absences of nodes: gaps from `first` to before `end` in which, or at whose end, the node began or restarted.

    A recorder may discover a node some time after it began, so a whole gap counts. For a link the gap ends where it
    began if a controller acted in the rest: then deliveries are missing. A gap within an absence of the node's own link
    is an absence as well.
    """
    away: list[Absence] = []
    for kind, i, part in _of_nodes(series):
        owner = _owner(kind, i, part)
        link = None if kind in OF_LINKS else ("link", _link(series, owner[1]))
        unserved = [x for x in away if (x.role, x.index) == link]  # complete: links come first
        for a, b in _gaps(part, first, end):
            served = any(x.first <= a and b <= x.end for x in unserved)
            begun = max(_begins(late, owner, a, b), default=None)
            if begun is not None and kind in OF_LINKS and _answered(series, late, begun, b):
                away.append(Absence(*owner, a, begun, kind))
            elif begun is not None or served:
                away.append(Absence(*owner, a, b, kind))
    return list(dict.fromkeys(away))


def missing_ticks(
    series: dict[str, list[Series]], away: Sequence[Absence], first: int, end: int
) -> Iterator[tuple[str, Series, list[tuple[int, int]]]]:
    """Kind, series, and its gaps from `first` to before `end` that are not absences of the node."""
    for kind, parts in series.items():
        for i, part in enumerate(parts):
            gaps = _gaps(part, first, end)
            if kind in ROLES:
                ends = [x.end for x in away if (x.role, x.index) == _owner(kind, i, part)]
                gaps = [(max((e for e in ends if a < e <= b), default=a), b) for a, b in gaps]
            yield kind, part, [(a, b) for a, b in gaps if a < b]


def gap_notes(series: dict[str, list[Series]], away: Sequence[Absence], last: int) -> list[str]:
    """A note for each topic that lacks ticks before the last one, which needs no reply."""
    notes = []
    for _, part, gaps in missing_ticks(series, away, 0, last):
        if gaps:
            count = sum(b - a for a, b in gaps)
            listed = list(islice((tick for a, b in gaps for tick in range(a, b)), LISTED + 1))
            text = ", ".join(map(str, listed[:LISTED])) + (", ..." if len(listed) > LISTED else "")
            notes.append(f"{part.topic}: {count} of {last + 1} ticks are missing ({text})")
    return notes


def first_missing(series: dict[str, list[Series]], away: Sequence[Absence], ticks: NDArray[np.int64]) -> int | None:
    """First tick in the span of `ticks` that `ticks` or a series of NEEDED_FOR_REPLAY lacks; None if complete."""
    first, end = int(ticks[0]), int(ticks[-1]) + 1
    needed = [gaps for kind, _, gaps in missing_ticks(series, away, first, end) if kind in NEEDED_FOR_REPLAY]
    return min([gaps[0][0] for gaps in [*needed, _between(ticks, first, end)] if gaps], default=None)


def lost_messages(series: dict[str, list[Series]], counted: Mapping[str, int], last: int) -> int:
    """Number of messages that a recording lacks: those that its recorder missed, and ticks of the plant up to the last.

    `counted`: by the recorder, for `topic` or `topic publisher`; it does not see what is missing at the end. `last`:
    last tick of the run, if the plant has told it; else -1.
    """
    lost: Counter[str] = Counter()
    for whose, count in counted.items():
        lost[whose.partition(" ")[0]] += count
    plant = [part for kind in OF_PLANT for part in series[kind] if len(part.ticks)]
    first, last = min(part.ticks[0] for part in plant), max([last, *(part.ticks[-1] for part in plant)])
    for part in plant:
        lost[part.topic] = max(lost[part.topic], sum(b - a for a, b in _gaps(part, int(first), int(last) + 1)))
    return lost.total()


def _begins(late: set[tuple[str, int, int]], owner: tuple[str, int], first: int, end: int) -> Iterator[int]:
    """Ticks at which a node began, from `first` to `end` inclusive."""
    return (tick for role, place, tick in late if (role, place) == owner and first <= tick <= end)


def _answered(series: dict[str, list[Series]], late: set[tuple[str, int, int]], first: int, end: int) -> bool:
    """Whether a controller issued a setpoint or began within these ticks, so that it received deliveries."""
    begun = any(role == "controller" and first <= tick < end for role, _, tick in late)
    return begun or any(((part.ticks >= first) & (part.ticks < end)).any() for part in series.get("issued", []))


def _of_nodes(series: dict[str, list[Series]]) -> Iterator[tuple[str, int, Series]]:
    for kind in ROLES:
        for i, part in enumerate(series.get(kind, [])):
            yield kind, i, part


def _owner(kind: str, i: int, series: Series) -> tuple[str, int]:
    """Role and index of a topic's node: links by their order in the run, others by the number in their name."""
    return ROLES[kind], i if kind in OF_LINKS else decode.place(series.topic.split("/")[-2])


def _link(series: dict[str, list[Series]], controller: int) -> int:
    """Index of the link that a controller, its supervisor and its identifier use: its own, else the first."""
    places = [decode.place(part.topic.split("/")[-3]) for part in series.get("delivered", [])]
    return max([i for i, place in enumerate(places) if place == controller], default=0)


def _gaps(series: Series, first: int, end: int) -> list[tuple[int, int]]:
    there = np.unique(series.ticks[(series.ticks >= first) & (series.ticks < end)])
    return _between(there, first, end)


def _between(there: NDArray[np.int64], first: int, end: int) -> list[tuple[int, int]]:
    """Gaps between sorted ticks, each from its first tick to before the next tick that is there."""
    before, after = np.concatenate([[first - 1], there]), np.concatenate([there, [end]])
    wide = after - before > 1
    return list(zip((before[wide] + 1).tolist(), after[wide].tolist(), strict=True))
