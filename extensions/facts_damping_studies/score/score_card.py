"""What a card of a controller holds, and its JSON."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

if TYPE_CHECKING:
    from facts_damping_studies.score.measure import Measured
    from facts_damping_studies.score.statistics import Estimate


class KindScore(NamedTuple):
    """What came out in the cases of a kind."""

    cases: int
    change: Estimate  # of the measure, against no control
    lost: int  # cases that lose synchronism
    lost_without_control: int
    tripped: int  # cases in which a supervisor took the controller off


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

    controller: str
    set: str  # name and version of the set of cases
    set_digest: str
    score: float  # %, reduction of the measure that can be claimed
    change: Estimate  # of the measure, against no control
    kinds: dict[str, KindScore]
    against: dict[str, Estimate]  # of the measure, against other controllers
    effort: float  # mean setpoint relative to its limit
    saturated: float  # fraction of the time at a limit
    cases: list[tuple[str, Measured]]  # kind of each case, and what was measured
    does_harm: list[str]  # kinds in which it is worse than no control
    hunted: Hunted | None = None  # None: none was asked for

    @property
    def lost(self) -> int:
        """Cases that lose synchronism."""
        return sum(kind.lost for kind in self.kinds.values())

    @property
    def tripped(self) -> int:
        """Cases in which a supervisor took the controller off."""
        return sum(kind.tripped for kind in self.kinds.values())

    @property
    def lost_without_control(self) -> int:
        """Cases that lose synchronism without control."""
        return sum(kind.lost_without_control for kind in self.kinds.values())

    def document(self) -> dict[str, Any]:
        """The JSON of a card."""
        parts = {
            "change": self.change._asdict(),
            "kinds": {name: {**kind._asdict(), "change": kind.change._asdict()} for name, kind in self.kinds.items()},
            "against": {name: change._asdict() for name, change in self.against.items()},
            "cases": [{"kind": kind, **measured._asdict()} for kind, measured in self.cases],
        }
        content = {name: parts.get(name, value) for name, value in vars(self).items() if name != "hunted"}
        if self.hunted is not None:
            worst = {"ratio": None} if self.hunted.worst is None else self.hunted.worst._asdict()
            content["worst"] = {"cases": self.hunted.cases, **worst}
        return content
