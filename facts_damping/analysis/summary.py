"""The figures of a run, and how they are computed."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from facts_damping.analysis import releases, supervision
from facts_damping.analysis.effort import max_injected_voltage, record_roughness, saturation_duty
from facts_damping.analysis.indices import performance_indices
from facts_damping.analysis.judging import RUN, judge_run
from facts_damping.analysis.latency import frames_lost, latency, left_out
from facts_damping.analysis.measures import event_times, speed_differences
from facts_damping.analysis.modes import ambient
from facts_damping.analysis.modes.oscillation import instability, is_stable, settling_time, unknown
from facts_damping.analysis.modes.ringdown import METHOD, fit_ringdown
from facts_damping.analysis.response import swings_of
from facts_damping.analysis.run_warnings import controller_warnings, limit_warnings
from facts_damping.analysis.verdict import DAMPED, GROWING, LIMIT_CYCLE, LOST, UNDECIDED
from facts_damping.output.writing import finite

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray

    from facts_damping.analysis.latency import Statistics
    from facts_damping.analysis.modes.ringdown import Fit, RingdownMode
    from facts_damping.analysis.releases import Release
    from facts_damping.analysis.response import Twin
    from facts_damping.analysis.supervision import SupervisorHistory
    from facts_damping.analysis.verdict import Growth
    from facts_damping.record import NodeJoined, Record, RefusedMessages

UNSET: tuple[Any, ...] = (None, False, [], {}, "none")  # values that mean a controller's field is not set
AUTO = "auto"  # choose the method of mode identification by the excitation


class ModeFit(NamedTuple):
    """A mode of the summary: `RingdownMode` with None for an unknown standard error."""

    frequency_hz: float
    damping_ratio: float
    frequency_error_hz: float | None
    damping_ratio_error: float | None
    amplitude: list[float]  # p.u., of each speed difference
    phase_rad: list[float]

    @property
    def growth_per_s(self) -> float:
        """Its growth rate, 1/s."""
        return float(-self.damping_ratio * 2 * np.pi * self.frequency_hz / np.sqrt(1 - self.damping_ratio**2))


class FitQuality(NamedTuple):
    """How the modes were fitted: start of the ringdown (s), number of poles, signal to residual (dB)."""

    start_s: float
    order: int
    snr_db: float


class LimitCycle(NamedTuple):
    """Amplitude of a limit cycle, p.u., and fraction of its time that each device's setpoint is at its limit."""

    amplitude_pu: float
    saturation_duty: dict[str, float]


@dataclass(frozen=True, kw_only=True)
class Oscillation:
    """Verdict, indices and modes of a run; without synchronism to its end only the verdict with its reason.

    `run`: its short form. `stable`: in synchronism to the end; None: unknown. `verdict_of`: what was judged
    (`judging`). `indices` count from t = 0, `indices_since_event` from the first event; `indices_of_response` are those
    of the response to the events, without noise.
    """

    run: dict[str, Any]
    stable: bool | None
    instability: str | None
    verdict: str
    verdict_because: str | None
    verdict_of: str | None = None
    damped: bool = False
    growth_per_s: Growth | None = None
    limit_cycle: LimitCycle | None = None
    indices: dict[str, float] | None = None
    indices_since_event: dict[str, float] | None = None
    indices_of_response: dict[str, float] | None = None
    settling_time_s: float | None = None
    modes: Sequence[ModeFit] = ()  # the strongest first
    modes_method: str | None = None
    ringdown: FitQuality | None = None

    @property
    def deciding_mode(self) -> ModeFit | None:
        """The mode that the verdict is of: the strongest, if `growing` the one with that growth; None: none agrees."""
        grows, settled = self.verdict == GROWING, self.verdict in (DAMPED, GROWING)
        agreeing = [mode for mode in self.modes if not settled or (mode.damping_ratio < 0.0) == grows]
        growth = self.growth_per_s.value if grows and self.growth_per_s else None
        return min(agreeing, key=lambda mode: 0.0 if growth is None else abs(mode.growth_per_s - growth), default=None)


@dataclass(frozen=True, kw_only=True)
class Summary(Oscillation):
    """Figures of a run; the fields are the keys of its JSON (docs/results_json.md).

    `roughness` is (5.34) over dt^2, `roughness_per_frame` without. `converged`, `step_change`: whether half the
    integration step keeps the result, and the relative change of each figure (`convergence`); None: not tried.
    """

    duration_s: float
    roughness: float
    roughness_per_frame: float
    max_injected_voltage_pu: float | None
    saturation_duty: dict[str, float]
    latency_ms: Statistics
    latencies_left_out: int
    frames_lost: int
    releases: list[Release]
    refused_setpoints: dict[str, dict[str, int]]
    refused_messages: list[RefusedMessages]
    joined: list[NodeJoined]
    supervision: list[SupervisorHistory]
    warnings: list[str]
    converged: bool | None = None
    step_change: dict[str, float] | None = None


def summarise(
    record: Record,
    differences: Mapping[str, NDArray[np.float64]] | None = None,
    *,
    method: str | None = AUTO,
    twin: Twin | None = None,
) -> Summary:
    """Figures of a run.

    `differences`: name -> (ticks,), p.u., the speed differences to judge; default: those of the configuration.
    `twin`: of a run with noise (simulation/twins.py); verdict, modes and settling time are then those of its
    response to the events, by the default differences. Without it, verdicts of runs with noise can be wrong.
    `method`: how modes are identified, one of `modes.poles.METHODS` or `ambient.METHOD`; AUTO: from the noise if the
    run has load noise and no event, else from the ringdown; None: not at all. For a run that is not stable, or of
    unknown stability (`stable` None), indices and settling time are None and there are no modes. Raises InputError if
    the speed differences do not fit the record, or for an unknown method.
    """
    judged = speed_differences(record) if differences is None else differences
    t, smooth = record.time_s, record_roughness(record)
    outcome = _outcome(record, judged, method, twin if differences is None else None)
    duty, late = saturation_duty(record), latency(record)
    histories = supervision.supervision(record, outcome.modes[0].frequency_hz if outcome.modes else None)
    return Summary(
        **vars(outcome),
        duration_s=round(float(np.ptp(t) + np.median(np.diff(t))), 6) if len(t) > 1 else 0.0,  # the last frame too
        roughness=smooth["per_second"],
        roughness_per_frame=smooth["per_frame"],
        max_injected_voltage_pu=max_injected_voltage(record),
        saturation_duty=duty,
        latency_ms=late,
        latencies_left_out=left_out(record),
        frames_lost=frames_lost(record),
        releases=releases.releases(record),
        refused_setpoints=releases.refused_setpoints(record),
        refused_messages=record.refused,
        joined=record.joined,
        supervision=histories,
        warnings=[*controller_warnings(record, histories, late, duty), *limit_warnings(record)],
    )


def as_json(summary: Summary) -> dict[str, Any]:
    """A summary ready for JSON; without the comparison with half the step if that was not tried."""
    content: dict[str, Any] = finite(summary)
    if summary.converged is None:
        del content["converged"], content["step_change"]
    return content


def _run(record: Record) -> dict[str, Any]:
    """Short form of the run: the system by name, even if some fields were changed; only set fields of controllers."""
    run = record.asked
    for name in ("system", "model"):
        if isinstance(run.get(name), dict):
            run[name] = run[name].get("name")
    if "controllers" in run:
        rows = run["controllers"] or []
        run["controllers"] = [{name: value for name, value in row.items() if value not in UNSET} for row in rows]
    return run


def _outcome(
    record: Record, differences: Mapping[str, NDArray[np.float64]], method: str | None, twin: Twin | None
) -> Oscillation:
    """Figures of the oscillation, most of which exist only for a run in synchronism to its end."""
    run, stable, lost = _run(record), is_stable(record), instability(record)
    if not stable:
        verdict, because = LOST if stable is False else UNDECIDED, lost or unknown(record)
        return Oscillation(run=run, stable=stable, instability=lost, verdict=verdict, verdict_because=because)
    swings = swings_of(record, twin, differences)
    t, last = record.time_s, swings.last
    fit, method = _fit(record, swings.judged[: swings.ringing], last, method)
    judged = judge_run(
        record,
        twin,
        swings,
        (lambda: fit) if method == METHOD else None,
        (lambda: fit) if method == ambient.METHOD else None,
    )
    if swings.response is not None and judged.of == RUN:  # it is not linear: its response has no modes
        fit, method = _fit(record, swings.own, last, method)
    judgement = judged.judgement
    cycle = LimitCycle(judgement.amplitude_pu, saturation_duty(record, judgement.start_s))
    return Oscillation(
        run=run,
        stable=stable,
        instability=lost,
        verdict=judgement.verdict,
        verdict_because=judgement.because,
        verdict_of=judged.of,
        damped=judgement.verdict == DAMPED,
        growth_per_s=judgement.growth,
        limit_cycle=cycle if judgement.verdict == LIMIT_CYCLE else None,
        indices=performance_indices(t, swings.own),
        indices_since_event=performance_indices(t, swings.own, (swings.times or [0.0])[0]),
        indices_of_response=swings.indices,
        settling_time_s=settling_time(t[: len(swings.judged)], swings.judged, last),
        modes=[_mode(mode) for mode in fit.modes] if fit else (),
        modes_method=method if fit else None,
        ringdown=fit and FitQuality(fit.start_s, fit.order, fit.snr_db),
    )


def _fit(
    record: Record, signals: NDArray[np.float64], since: float, method: str | None
) -> tuple[Fit | None, str | None]:
    """Modes of a run after its last event (s), and the method that identified them."""
    if method == AUTO:
        noise = record.configuration.get("load_noise") and not event_times(record)
        method = ambient.METHOD if noise else METHOD
    if method is None:
        return None, None
    if method == ambient.METHOD:
        return ambient.fit_ambient(record.time_s[: len(signals)], signals, since), method
    return fit_ringdown(record.time_s[: len(signals)], signals, since, method), method


def _mode(mode: RingdownMode) -> ModeFit:
    return ModeFit(
        mode.frequency_hz,
        mode.damping_ratio,
        _known(mode.frequency_error_hz),
        _known(mode.damping_ratio_error),
        list(mode.amplitude),
        list(mode.phase_rad),
    )


def _known(error: float) -> float | None:
    return None if np.isnan(error) else error
