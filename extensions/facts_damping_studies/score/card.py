"""Cards of controllers: what was measured in all cases of a set, compared with no control, the reference and others.

    change = mean_k mean_e m_ke,  m_ke = mean of log(index / index without control) over the cases of event e of kind k

Where one of the two loses synchronism, the log ratio is LOST or -LOST; where both do it is 0; it is LOST at most.
The score is the part of the reduction that the upper reference has (`statistics.score_of`): no control has 0, the
reference 100. Kinds that the set has `beside` the score are on the card, not in the score.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from facts_damping.errors import InputError
from facts_damping_studies.campaigns.invariants import HARM
from facts_damping_studies.score.entries import FIXED, FULL, NONE, Entry, document, measured_entries, stored_entries
from facts_damping_studies.score.score_card import KindScore, ScoreCard, Worst
from facts_damping_studies.score.statistics import (
    LOST,
    Changes,
    change_in,
    change_of,
    changes,
    groups,
    paired,
    probability,
    rounded,
    score_of,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from numpy.typing import NDArray

    from facts_damping_studies.score.cases.sets import Controllers, Set
    from facts_damping_studies.score.measure import Measured

    Tell = Callable[[int, int], None]

LOWEST, HIGHEST, FREQUENCY_HZ = 0.8, 1.2, 1.0  # limits of a machine's voltage, p.u., and of its frequency's deviation
VIOLATIONS = 0.05  # of the cases in the score, beyond which a controller is disqualified


def log_ratio(index: float | None, reference: float | None) -> float:
    """The logarithm of an index relative to a reference in the same case; None: synchronism is lost."""
    if index is None or reference is None:
        return LOST * ((index is None) - float(reference is None))
    return min(LOST, float(np.log(index / reference)))


def logs(measured: Sequence[Measured], none: Sequence[Measured]) -> NDArray[np.float64]:
    """Log ratio of the index in each case, (cases,)."""
    return np.array([log_ratio(a.measure, b.measure) for a, b in zip(measured, none, strict=True)])


def entries_of(
    case_set: Set, controllers: Mapping[str, Controllers], fresh: Sequence[str], jobs: int, progress: Tell
) -> dict[str, Entry]:
    """Entries of no control, the references and controllers: those of shipped cards of this set, the others measured.

    `fresh`: measured in any case. Raises `InputError`.
    """
    wanted: dict[str, Controllers] = {**dict.fromkeys(FIXED, ()), **controllers}
    stored = {
        name: entry
        for name, entry in stored_entries(case_set).items()
        if name in wanted and name not in fresh and list(entry.rows) == list(wanted[name])
    }
    measured = measured_entries(
        case_set, {name: rows for name, rows in wanted.items() if name not in stored}, jobs, progress
    )
    return {name: stored.get(name) or measured[name] for name in wanted}


def cards_of(case_set: Set, entries: Mapping[str, Entry]) -> list[ScoreCard]:
    """The cards of controllers and references among entries, each beside the others. Raises `InputError`."""
    return [_card(case_set, entries, name) for name in entries if name != NONE]


def compared(case_set: Set, measured: Sequence[Sequence[Measured]], none: Sequence[Measured]) -> Changes:
    """Changes in all kinds, with resamples that are the same for a set."""
    ratios = np.array([logs(cases, none) for cases in measured])
    kinds, events = [case.kind for case in case_set.cases], [case.event for case in case_set.cases]
    return changes(ratios, kinds, events, int(case_set.digest, 16))


def scored(changed: Changes, beside: Sequence[str]) -> Changes:
    """Changes in the kinds that are in the score."""
    at = [k for k, kind in enumerate(changed.kinds) if kind not in beside]
    if not at:
        raise InputError("beside: all kinds given; allowed: at least one kind that is in the score")
    return Changes(tuple(changed.kinds[k] for k in at), changed.by_kind[:, at], changed.drawn_by_kind[:, at])


def _card(case_set: Set, entries: Mapping[str, Entry], name: str) -> ScoreCard:
    entry, none, beside = entries[name], entries[NONE].cases, case_set.content.beside
    others = [other for other in entries if other not in (name, NONE)]
    ranked = [name, *(other for other in others if other not in FIXED)]
    every = [name, *others]
    whole = compared(case_set, [*(entries[other].cases for other in every), entry.unsupervised], none)
    inside, full = scored(whole, beside), every.index(FULL)
    among = Changes(inside.kinds, *(a[[every.index(other) for other in ranked]] for a in inside[1:]))
    ordered = groups(among)
    return ScoreCard(
        entry=entry,
        entry_document=document(entry, case_set),
        score=score_of(inside, 0, full),
        unsupervised=score_of(inside, len(every), full),
        change=change_of(inside, 0),
        group=0 if name in FIXED else next(i for i, group in enumerate(ordered, 1) if 0 in group),
        groups=len(ordered),
        best=rounded(float(probability(among)[0])),
        kinds={kind: _kind(case_set, kind, entry.cases, none, whole) for kind in whole.kinds},
        beside=list(beside),
        against={other: paired(inside, 0, every.index(other)) for other in others},
        does_harm=[kind for kind in whole.kinds if change_in(whole, 0, kind).low > 100.0 * (HARM - 1.0)],
        lost_without_control=sum(measured.lost_s is not None for measured in none),
        **_totals(entry.cases),
        **_qualified(case_set, entry, none),
    )


def _kind(case_set: Set, kind: str, cases: Sequence[Measured], none: Sequence[Measured], changed: Changes) -> KindScore:
    at = [i for i, case in enumerate(case_set.cases) if case.kind == kind]
    return KindScore(
        cases=len(at),
        events=len({case_set.cases[i].event for i in at}),
        change=change_in(changed, 0, kind),
        lost=sum(cases[i].lost_s is not None for i in at),
        lost_without_control=sum(none[i].lost_s is not None for i in at),
        tripped=sum(cases[i].tripped for i in at),
    )


def _totals(cases: Sequence[Measured]) -> dict[str, Any]:
    """Figures over all cases."""
    known = [measured for measured in cases if measured.frequency_hz is not None]
    worst = (
        max(measured.frequency_hz or 0.0 for measured in known),
        min(measured.lowest or 0.0 for measured in known),
        max(measured.highest or 0.0 for measured in known),
    ) if known else None  # fmt: skip
    return {
        "lost": sum(measured.lost_s is not None for measured in cases),
        "tripped": sum(measured.tripped for measured in cases),
        **{
            name: rounded(float(np.mean([getattr(measured, name) for measured in cases])))
            for name in ("effort", "saturated", "travel")
        },
        "computing": max(measured.computing for measured in cases),
        "worst": None if worst is None else Worst(*worst),
    }


def _qualified(case_set: Set, entry: Entry, none: Sequence[Measured]) -> dict[str, Any]:
    """Cases beyond limits, and why a controller is disqualified."""
    pairs = list(zip(entry.cases, none, strict=True))
    beyond = [i for i, (measured, free) in enumerate(pairs) if _violates(measured) and not _violates(free)]
    inside = [i for i, case in enumerate(case_set.cases) if case.kind not in case_set.content.beside]
    counted, why = [i for i in beyond if i in inside], ""
    breaches = {measured.breach: i for i, measured in reversed(list(enumerate(entry.cases))) if measured.breach}
    if breaches:
        what, i = next(reversed(breaches.items()))
        why = f"{what} (case {i})"
    elif (slowest := max(measured.computing for measured in entry.cases)) > 1.0:
        why = f"it computes {slowest:.3g} times as long as time goes"
    elif len(counted) > VIOLATIONS * len(inside):
        limits = f"{FREQUENCY_HZ:g} Hz or {LOWEST:g} to {HIGHEST:g} p.u."
        why = f"{len(counted)} of {len(inside)} cases are beyond {limits} only with it; allowed: {VIOLATIONS:.0%}"
    return {"violations": beyond, "disqualified": why}


def _violates(measured: Measured) -> bool:
    """Whether a case is beyond the limits of voltage and frequency, or loses synchronism."""
    if measured.frequency_hz is None or measured.lowest is None or measured.highest is None:
        return True
    return measured.frequency_hz > FREQUENCY_HZ or measured.lowest < LOWEST or measured.highest > HIGHEST


def ranking(cards: Sequence[ScoreCard]) -> list[ScoreCard]:
    """Cards, the best first; those that are disqualified at the end."""
    return sorted(cards, key=lambda card: (bool(card.disqualified), -card.score.value))
