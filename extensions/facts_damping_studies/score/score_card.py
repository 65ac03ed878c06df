"""What a card of a controller holds, and its JSON."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

if TYPE_CHECKING:
    from facts_damping_studies.score.entries import Entry
    from facts_damping_studies.score.statistics import Estimate, Score


class KindScore(NamedTuple):
    """What came out in the cases of a kind."""

    cases: int
    events: int
    change: Estimate  # of the index, against no control
    lost: int  # cases that lose synchronism
    lost_without_control: int
    tripped: int  # cases in which a supervisor took the controller off


class Worst(NamedTuple):
    """The worst of all cases after their events, at the machines."""

    frequency_hz: float
    lowest: float  # p.u., voltage
    highest: float


class WorstCase(NamedTuple):
    """The worst of the hunted cases."""

    ratio: float  # ITAE relative to no control
    case: int  # number in the set
    kind: str
    fault: str  # one of `campaigns.faults`
    start_s: float  # of the fault
    lasts: str  # its duration, s; empty: to the end


class Hunted(NamedTuple):
    """So many hunted cases, and the worst of them; None: no case tells."""

    cases: int
    worst: WorstCase | None


@dataclass(frozen=True)
class ScoreCard:
    """A controller's card (docs/score.md)."""

    entry: Entry
    entry_document: dict[str, Any]
    score: Score  # 0: no control, 100: the upper reference
    unsupervised: Score  # the same without a supervisor
    change: Estimate  # of the index, against no control
    group: int  # among all controllers that it was ranked with, 1: the best; 0: a reference
    groups: int
    best: float  # probability that it is the best of them
    kinds: dict[str, KindScore]
    beside: list[str]  # kinds that are not in the score
    against: dict[str, Estimate]  # of the index, against others in the same cases
    lost: int  # cases of all kinds that lose synchronism
    lost_without_control: int
    tripped: int
    effort: float  # mean setpoint relative to its limit
    saturated: float  # fraction of the time at a limit
    travel: float  # 1/s, way of the setpoint relative to its limit, mean of the cases
    computing: float  # largest time of the processor, relative to that simulated
    worst: Worst | None
    does_harm: list[str]  # kinds in which it is worse than no control
    violations: list[int]  # cases beyond a limit within which they are without control
    disqualified: str  # why; empty: it is not
    hunted: Hunted | None = None  # None: none was asked for

    @property
    def controller(self) -> str:
        """Its name."""
        return self.entry.name

    @property
    def set(self) -> str:
        """Name and version of the set of cases."""
        return str(self.entry_document["set"])

    @property
    def set_digest(self) -> str:
        """Digest of the set of cases."""
        return str(self.entry_document["set_digest"])

    def document(self) -> dict[str, Any]:
        """The JSON of a card."""
        parts = {
            "kinds": {name: {**kind._asdict(), "change": kind.change._asdict()} for name, kind in self.kinds.items()},
            "against": {name: change._asdict() for name, change in self.against.items()},
        }
        content: dict[str, Any] = {"controller": self.controller}
        for name, value in vars(self).items():
            if name not in ("entry", "entry_document", "hunted"):
                content[name] = parts.get(name) or (value._asdict() if hasattr(value, "_asdict") else value)
        if self.hunted is not None:
            worst = {"ratio": None} if self.hunted.worst is None else self.hunted.worst._asdict()
            content["hunted"] = {"cases": self.hunted.cases, **worst}
        return {**content, **self.entry_document}
