"""Rows of a study's tables: runs, margins, fractions of failed runs."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, NamedTuple

from facts_damping.analysis.indices import INDICES
from facts_damping_studies.margins.criteria import CriterionFigures
from facts_damping_studies.margins.margins import FailedFraction, OverSeeds  # noqa: TC001 (read by `Row`)
from facts_damping_studies.rows import Row

IDENTITY = ("system", "scenario", "controller", "scheme", "link", "seed")  # columns of every study
QUANTILES = (0, 1, 5, 10, 25, 50, 75, 90, 95, 99, 100)  # %, of the latency
LATENCIES = ("latency_mean_ms", *(f"latency_p{q}_ms" for q in QUANTILES[:-1]), "latency_max_ms")


class RunFigures(NamedTuple):
    """Figures of a run, as of `simulate` (docs/results_json.md); None where undefined."""

    stable: bool
    verdict: str
    damped: bool | None
    instability: str | None
    duration_s: float
    indices: dict[str, float | None]  # by the names of INDICES
    ITAE_of_response: float | None  # p.u. s^2, of runs with noise
    settling_time_s: float | None
    roughness: float | None  # p.u./s^2
    max_injected_voltage_pu: float | None
    saturation_duty: float | None  # fraction of the frames at a limit, of the device that is longest
    latency: dict[str, float | None]  # from measurement to device, ms, by the names of LATENCIES
    frames_lost: int
    trips: int  # of supervisors
    growth_per_s: float | None
    growth_low_per_s: float | None  # ends of its interval
    growth_high_per_s: float | None
    warnings: str | None  # separated by semicolons


class HalfStep(NamedTuple):
    """What changes with half the integration step."""

    converged: bool | None
    step_change: float | None  # relative change of the index that changes most
    verdict_half_step: str


class Interarea(NamedTuple):
    """The interarea mode of a run's ringdown; None if there is none."""

    interarea_hz: float | None
    interarea_damping_ratio: float | None


class FirstTrip(NamedTuple):
    """The first trip of a run by a supervisor; None: its cause has no number."""

    s: float  # time
    cause: str  # a monitor, or another cause (docs/supervision.md)
    value: float | None
    limit: float | None
    unit: str | None


def figure_names(*, modes: bool, check_step: bool = False) -> list[str]:
    """Columns of the figures of a run."""
    names = [name for name in RunFigures._fields if name not in ("indices", "latency")]
    after, latest = names.index("duration_s") + 1, names.index("frames_lost")
    names = [*names[:after], *INDICES, *names[after:latest], *LATENCIES, *names[latest:]]
    return [*names, *(HalfStep._fields if check_step else ()), *(Interarea._fields if modes else ())]


@dataclass(frozen=True)
class SweepRow(Row):
    """A run of a study; of one that failed, what was known before."""

    columns: dict[str, Any]  # those of IDENTITY, then the swept ones, as far as the run changes them
    horizon_s: float | None = None  # None: the case could not be made
    figures: RunFigures | None = None  # None: the run failed
    half_step: HalfStep | None = None  # None: not checked
    interarea: Interarea | None = None  # None: modes were not asked for
    first_trip: FirstTrip | None = field(default=None, metadata={"prefix": "trip_"})  # None: no trip
    at_limits: bool = False  # whether it is undecided, as a device is at its limits to the end
    # What the study asks for: those of `CriterionFigures` that its criteria need, and figures by `true_jacobian.names`.
    asked: dict[str, float | None] = field(default_factory=dict)
    error: str | None = field(kw_only=True)  # why the run, or one of its figures, failed

    @property
    def place(self) -> tuple[str, str]:
        """System and scenario."""
        return self.columns["system"], self.columns["scenario"]

    @property
    def stable(self) -> bool:
        """Whether the machines stay in synchronism; False also if the run failed."""
        return self.figures is not None and self.figures.stable

    @property
    def unsure(self) -> bool:
        """Whether half the integration step gives another result."""
        return self.half_step is not None and self.half_step.converged is False

    @property
    def judged(self) -> CriterionFigures:
        """What criteria need; of a run that was possible."""
        verdict = "" if self.figures is None else self.figures.verdict
        return CriterionFigures(
            verdict, **{name: self.asked[name] for name in CriterionFigures._fields[1:] if name in self.asked}
        )


@dataclass(frozen=True)
class MarginRow(Row):
    """A margin of a place of the study by a criterion, combined over seeds."""

    place: dict[str, Any]  # columns that identify it
    criterion: str  # one of CRITERIA
    over_seeds: OverSeeds
    holds: float | None  # fraction of the coarse grid's values at which the criterion holds
    holds_s: list[list[float]]  # intervals of the values at which it holds, in at least half of the searches
    converged: bool | None = None  # with half the integration step; None: not checked
    tripped: int = 0  # runs of the search that a supervisor tripped


@dataclass(frozen=True)
class FractionRow(Row):
    """The fraction of the runs of a place of the study that fail a criterion."""

    place: dict[str, Any]  # columns that identify it
    criterion: str  # one of CRITERIA
    fraction: FailedFraction
    not_converged: int | None = None  # runs that do otherwise with half the integration step; None: not checked
    tripped: int = 0  # runs that a supervisor tripped
