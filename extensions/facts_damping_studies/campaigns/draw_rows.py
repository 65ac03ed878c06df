"""Rows of a campaign's draws and graphs."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple

from facts_damping_studies.campaigns.actions import Actions
from facts_damping_studies.campaigns.invariants import Effect, EffectAlone
from facts_damping_studies.rows import Row

OF_GRAPHS = ("recorded", "as_computed", "nothing_forged_acts")  # conditions for graphs beside those for records


class DrawnFault(NamedTuple):
    """What was drawn: the base run, the fault with its group, and the labels of the lists."""

    base_run: str
    fault: str
    group: str  # as in `faults.Fault`
    wrong: bool  # whether control is wrong while it lasts
    start_s: float
    labels: dict[str, str]  # label by list; `lasts`: duration, s, empty: to the end

    @property
    def place(self) -> tuple[str, str]:
        """Base run and scenario; the latter is empty if none is drawn."""
        return self.base_run, self.labels.get("scenario", "")


class Law(NamedTuple):
    """The first controller of a run."""

    controller: str
    scheme: str | None


class GraphStart(NamedTuple):
    """How a graph was run."""

    mode: str  # of its nodes
    real: str  # what was done to a node, or to the domain


class GraphRun(NamedTuple):
    """What came of a graph."""

    begun_s: float | None  # simulated time of the fault; None: the run ended before
    back_s: float | None  # simulated time at which a suspended node was resumed
    wall_s: float
    deadline_misses: int
    nodes_ended: list[str]  # reasons of nodes that ended before the run
    forged: int  # messages of the attacker
    refused: int  # messages that nodes refused
    notes: list[str]  # of the recording
    conditions: dict[str, bool | None]  # whether each of OF_GRAPHS holds; None: not applicable


class Intervention(NamedTuple):
    """What a supervisor did, and what that did to the grid."""

    actions: Actions
    effect: Effect
    released: bool  # whether a device released its reference
    alone: dict[str, bool]  # whether each rule of `invariants.ALONE` holds


NOTHING_DRAWN = DrawnFault("", "", "", wrong=False, start_s=0.0, labels={})
NO_LAW = Law("", None)
NOT_JUDGED = Intervention(Actions(), Effect(), released=False, alone={})


@dataclass(frozen=True)
class DrawRow(Row):
    """A draw of a campaign, simulated or as a graph; of one that failed, what was known before."""

    number: int
    graph: bool = False
    error: str | None = field(kw_only=True)  # why it failed
    drawn: DrawnFault = NOTHING_DRAWN
    law: Law = NO_LAW
    horizon_s: float | None = None  # None: a graph, whose duration is the campaign's
    graph_start: GraphStart | None = None
    judgement: Intervention = NOT_JUDGED
    graph_run: GraphRun | None = None
    unsupervised: EffectAlone | None = field(default=None, metadata={"prefix": "unsupervised_"})  # None: not asked for

    @property
    def actions(self) -> Actions:
        """What the supervisor did."""
        return self.judgement.actions

    @property
    def effect(self) -> Effect:
        """What that did to the grid."""
        return self.judgement.effect

    @property
    def unsupervised_itae(self) -> float | None:
        """ITAE without supervision, p.u. s^2; None: unknown, or synchronism is lost."""
        return None if self.unsupervised is None else self.unsupervised.ITAE

    @property
    def invariants(self) -> dict[str, bool | None]:
        """Whether each invariant and each condition for graphs holds; None: not applicable."""
        conditions = {} if self.graph_run is None else self.graph_run.conditions
        return {**self.judgement.alone, **self.effect.invariants, **conditions}

    @property
    def holds(self) -> bool:
        """Whether it was run, and all that is applicable holds."""
        return self.error is None and False not in self.invariants.values()
