"""What follows from the runs of the profile deployment: who helps, by how much, in which event; what adds what."""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from facts_damping_reproduction import candidates as who
from facts_damping_reproduction.paired import Effect, agree, by_draw, effect

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from facts_damping_reproduction.candidates import Candidate
    from facts_damping_reproduction.held_out import HeldOut

    Row = dict[str, Any]
    Keep = Callable[[Row], bool]

# The first events of `held_out_two_area` are new events at operating points as in training; the others new conditions.
EVENTS = 6
UNCONVERGED = 1  # runs of a candidate in `checked` that half the step may change: with more it is not ranked
DELAY, LATENCY = "more_delay_s", 0.003  # column, and what of it the preset has


def has_place(changed: int, over_none: Effect) -> bool:
    """Whether a candidate has a place in an order: it is converged, and loses no draw that is kept without control.

    `changed`: how many of its runs half the integration step changes.
    """
    return changed <= UNCONVERGED and over_none.lost == 0 and over_none.ratio is not None


class Ranked(NamedTuple):
    """A candidate among all."""

    who: Candidate
    over_none: Effect
    converged: int  # runs of `checked` that half the step leaves as they are
    checked: int
    saturated: float  # fraction of the time at a limit, without an event
    tripped: float  # fraction of the draws

    @property
    def place(self) -> bool:
        """Whether it has a place in the order."""
        return has_place(self.checked - self.converged, self.over_none)


class Answer(NamedTuple):
    """Two candidates side by side, in each event and in all."""

    who: str
    against: str
    events: dict[str, Effect]
    new_events: Effect  # all of those
    new_conditions: Effect
    all: Effect


class Borne(NamedTuple):
    """How much delay a candidate bears, beside that of the preset, s."""

    who: Candidate
    by_delay: dict[float, Effect]  # over no control

    @property
    def helps_to(self) -> float | None:
        """The largest delay up to which it is better than no control at all; None: at none."""
        last = None
        for delay, found in sorted(self.by_delay.items()):
            if not found.better or found.lost:
                break
            last = delay
        return last


class Judgement(NamedTuple):
    """All that the page tells."""

    ranked: list[Ranked]
    over_none: list[Answer]  # finalists, and who stands beside them
    learning: list[Answer]  # networks beside themselves with learning off
    adaptive: list[Answer]  # the best network beside the best fixed design, for each set of devices
    second: list[Answer]  # with both devices beside the SSSC alone
    compensation: list[Answer]  # with a compensation beside without
    supervision: list[Answer]  # supervised beside unsupervised
    device_lost: list[Answer]
    borne: list[Borne]
    changed: Counter[str]  # how many runs of each in `checked` half the integration step changes, by label
    again: tuple[int, int]  # effects of other draws that are the same within the intervals, and of how many


def judge(held: HeldOut) -> Judgement:
    """Everything that the page tells."""
    many, changed = held.many, Counter(row["who"] for row in held.checked if not row["error"] and not row["converged"])
    events = list(dict.fromkeys(row["event"] for row in many))
    lost = list(dict.fromkeys(row["event"] for row in held.device_lost))
    controlled = [one for one in held.finalists if one.name != who.NONE]

    def answers(pairs: Sequence[tuple[str, str]], rows: Sequence[Row] = many) -> list[Answer]:
        return [_answer(one, other, events, rows, rows) for one, other in pairs]

    over_none = answers([(one.label, who.NONE) for one in (*controlled, *held.beside)])
    again = answers([(one.label, who.NONE) for one in controlled], held.again)
    return Judgement(
        ranked=_ranked(held, changed),
        over_none=over_none,
        learning=answers([(one.label, who.frozen(one).label) for one in controlled if one.family in who.NETWORKS]),
        adaptive=answers(_best_pairs(controlled)),
        second=answers(_second(controlled)),
        compensation=answers(_compensated(controlled)),
        supervision=[
            _answer(one.label, who.unsupervised(one).label, events, held.few, held.unsupervised) for one in controlled
        ],
        device_lost=[
            _answer(one.label, who.NONE, lost, held.device_lost, held.device_lost)
            for one in controlled
            if len(one.devices) > 1
        ],
        borne=[_borne(one, held.delays) for one in controlled],
        changed=changed,
        again=_same(over_none, again),
    )


def _answer(one: str, other: str, events: Sequence[str], rows: Sequence[Row], others: Sequence[Row]) -> Answer:
    every, reference = _of(rows, one), _of(others, other)

    def found(keep: Keep = lambda _: True) -> Effect:
        own = {draw: row for draw, row in every.items() if keep(row)}
        return effect(own, reference, lambda row: row["event"])

    return Answer(
        one,
        other,
        {event: found(lambda row, event=event: row["event"] == event) for event in events},  # type: ignore[misc]
        found(lambda row: row["event"] in events[:EVENTS]),
        found(lambda row: row["event"] not in events[:EVENTS]),
        found(),
    )


def _of(rows: Sequence[Row], label: str) -> dict[Any, Row]:
    """The rows of a candidate, by draw."""
    own = [row for row in rows if row["who"] == label and row["error"] is None]
    return by_draw(own, [name for name in ("event", "seed", DELAY) if own and name in own[0]])


def _ranked(held: HeldOut, changed: Counter[str]) -> list[Ranked]:
    """Everybody: those that have a place first, by what they are over no control."""
    found = []
    for one in held.everybody:
        if one.name == who.NONE:
            continue
        few, quiet = (_of(rows, one.label).values() for rows in (held.few, held.ambient))
        checked = len(_of(held.checked, one.label))
        found.append(
            Ranked(
                one,
                _answer(one.label, who.NONE, [], held.few, held.few).all,
                checked - changed[one.label],
                checked,
                float(np.mean([row["saturation_duty"] for row in quiet])),
                float(np.mean([row["trips"] > 0 for row in few])),
            )
        )
    return sorted(found, key=lambda one: (not one.place, one.over_none.ratio or np.inf))


def _best_pairs(finalists: Sequence[Candidate]) -> list[tuple[str, str]]:
    """For each set of devices the network and the fixed design that training has best."""
    found = []
    for devices in who.SETS:
        own = [one for one in finalists if one.devices == devices]
        fixed, network = who.best(own, family=who.FIXED), who.best_network(own)
        found += [(network.label, fixed.label)] if fixed and network else []
    return found


def _second(finalists: Sequence[Candidate]) -> list[tuple[str, str]]:
    """Fixed designs with both devices beside themselves with one, and the best network of each scheme."""
    pairs = []
    alone, both = (
        [one for one in finalists if one.devices == devices and one.compensation == who.NONE] for devices in who.SETS
    )
    for one in both:
        fixed = one.family == who.FIXED
        same = [other for other in alone if other.family == one.family and (not fixed or other.name == one.name)]
        pairs += [(one.label, same[0].label)] if same else []
    return pairs


def _compensated(finalists: Sequence[Candidate]) -> list[tuple[str, str]]:
    """Who has a compensation beside the best of its family and devices without."""
    pairs = []
    for one in finalists:
        plain = [other for other in finalists if other.compensation == who.NONE and other.devices == one.devices]
        same = [other for other in plain if other.name == one.name and other.family == one.family]
        other = same[0] if same else who.best(plain, family=one.family)
        pairs += [(one.label, other.label)] if one.compensation != who.NONE and other else []
    return pairs


def _borne(one: Candidate, rows: Sequence[Row]) -> Borne:
    own, none = _of(rows, one.label), _of(rows, who.NONE)
    delays = sorted({row[DELAY] for row in own.values()})
    found = {}
    for delay in delays:
        here = {key: row for key, row in own.items() if row[DELAY] == delay}
        found[round(delay - LATENCY, 6)] = effect(here, none, lambda _: None)
    return Borne(one, found)


def _same(first: Sequence[Answer], again: Sequence[Answer]) -> tuple[int, int]:
    """How many effects of the same two are the same within their intervals, in each event and in all."""
    others = {(one.who, one.against): one for one in again}
    told = []
    for one in first:
        other = others.get((one.who, one.against))
        if other is not None:
            told += [agree(found, other.events[event]) for event, found in one.events.items()]
            told += [agree(getattr(one, name), getattr(other, name)) for name in ("new_events", "new_conditions")]
    known = [same for same in told if same is not None]
    return sum(known), len(known)
