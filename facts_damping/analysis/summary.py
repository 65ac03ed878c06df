"""The figures of a run, and a table that compares several runs."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from facts_damping.analysis import convergence, releases, supervision
from facts_damping.analysis.effort import max_injected_voltage, record_roughness, saturation_duty
from facts_damping.analysis.indices import INDICES, performance_indices
from facts_damping.analysis.judging import RUN, judge_run
from facts_damping.analysis.latency import frames_lost, latency, left_out
from facts_damping.analysis.measures import event_times, speed_differences
from facts_damping.analysis.modes import ambient
from facts_damping.analysis.modes.oscillation import instability, is_stable, settling_time, unknown
from facts_damping.analysis.modes.ringdown import METHOD, fit_ringdown
from facts_damping.analysis.response import Twin, swings_of
from facts_damping.analysis.run_warnings import controller_warnings, limit_warnings
from facts_damping.analysis.verdict import DAMPED, LIMIT_CYCLE, LOST, UNDECIDED
from facts_damping.output import tables

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray

    from facts_damping.analysis.modes.ringdown import Fit
    from facts_damping.record import Record

# Rows of the table: label, path into a summary, format.
ROWS = (
    ("in synchronism", ("stable",), ""),
    ("ended by", ("instability",), ""),
    ("verdict", ("verdict",), ""),
    ("growth [1/s]", ("growth_per_s",), ".4f"),
    ("duration [s]", ("duration_s",), ".2f"),
    *((name, ("indices", name), ".4g") for name in INDICES),
    ("settling time [s]", ("settling_time_s",), ".2f"),
    ("max injected voltage [p.u.]", ("max_injected_voltage_pu",), ".4f"),
    ("roughness [p.u./s²]", ("roughness",), ".4g"),
    ("strongest mode [Hz]", ("modes", 0, "frequency_hz"), ".3f"),
    ("  its damping ratio", ("modes", 0, "damping_ratio"), ".4f"),
    ("latency, mean [ms]", ("latency_ms", "mean"), ".2f"),
    ("latency, 99 % [ms]", ("latency_ms", "p99"), ".2f"),
    ("frames lost", ("frames_lost",), "d"),
)
UNSET: tuple[Any, ...] = (None, False, [], {}, "none")  # values that mean a controller's field is not set
WORDS = {True: "yes", False: "no", None: "-"}
AUTO = "auto"  # choose the method of mode identification by the excitation


def summarise(
    record: Record,
    differences: Mapping[str, NDArray[np.float64]] | None = None,
    *,
    method: str | None = AUTO,
    twin: Twin | None = None,
) -> dict[str, Any]:
    """Figures of a run, ready for JSON: numbers, None and lists of them.

    `differences`: name -> (ticks,), p.u., the speed differences to judge; default: those of the configuration.
    `twin`: of a run with noise (simulation/twins.py); verdict, modes and settling time are then those of its
    response to the events, by the default differences. Without it, verdicts of runs with noise can be wrong.
    `method`: how modes are identified, one of `analysis.poles.METHODS` or `ambient.METHOD`; AUTO: from the noise if the
    run has load noise and no event, else from the ringdown; None: not at all. For a run that is not stable, or of
    unknown stability (`stable` None), indices and settling time are None and there are no modes. `indices` count from t
    = 0, `indices_since_event` from the first event; `roughness` is (5.34) over dt^2, `roughness_per_frame` without.
    `indices_of_response` are those of the response. Raises InputError if the speed differences do not fit the record,
    or for an unknown method.
    """
    judged = speed_differences(record) if differences is None else differences
    stable, t = is_stable(record), record.time_s
    smooth = record_roughness(record)
    swings = _oscillation(record, judged, method, stable, twin if differences is None else None)
    duty, late = saturation_duty(record), latency(record)
    watched = supervision.supervision(record, find(swings, ("modes", 0, "frequency_hz")))
    return {
        "run": _run(record),
        "stable": stable,
        "instability": instability(record),
        **swings,
        "duration_s": round(float(np.ptp(t) + np.median(np.diff(t))), 6) if len(t) > 1 else 0.0,  # the last frame too
        "roughness": smooth["per_second"],
        "roughness_per_frame": smooth["per_frame"],
        "max_injected_voltage_pu": max_injected_voltage(record),
        "saturation_duty": duty,
        "latency_ms": late,
        "latencies_left_out": left_out(record),
        "frames_lost": frames_lost(record),
        "releases": releases.releases(record),
        "refused_setpoints": releases.refused_setpoints(record),
        "refused_messages": record.refused,
        "joined": record.joined,
        "supervision": watched,
        "warnings": [*controller_warnings(record, watched, late, duty), *limit_warnings(record)],
    }


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


def table(summaries: Sequence[tuple[str, Mapping[str, Any]]]) -> str:
    """Text table for a terminal: one column per run (name, summary), one row per figure."""
    rows = [[label, *(row_text(summary, path, form) for _, summary in summaries)] for label, path, form in ROWS]
    rows += [[label, *cells] for label, cells in more_rows([summary for _, summary in summaries])]
    return "\n".join(tables.table(["", *(name for name, _ in summaries)], rows))


def more_rows(summaries: Sequence[Mapping[str, Any]]) -> list[tuple[str, list[str]]]:
    """Optional rows of a table of runs, as texts; each is there if one of the runs has a value for it."""
    converged = [s.get("converged") for s in summaries]  # whether, if the integration step was halved
    found = [("converged", [WORDS[value] for value in converged])] if any(c is not None for c in converged) else []
    responses = [s.get("indices_of_response") for s in summaries]
    if any(responses):
        found.append(("ITAE of the response", [value_text(find(one, ("ITAE",)), ".4g") for one in responses]))
    found += _cycles(summaries) + supervision.rows(summaries) + releases.rows(summaries)
    if any(s.get("latencies_left_out") for s in summaries):
        found.append(("impossible latencies", [str(s.get("latencies_left_out", 0)) for s in summaries]))
    if any(s.get("refused_messages") for s in summaries):
        each = [s.get("refused_messages") or [] for s in summaries]  # each node counts the messages that it received
        texts = [releases.refused_messages(rows) or "-" for rows in each]
        found.append(("refused messages", texts))
    return found


def _cycles(summaries: Sequence[Mapping[str, Any]]) -> list[tuple[str, list[str]]]:
    """Amplitude of limit cycles, and fraction of time that devices are at their limits in them."""
    cycles = [s.get("limit_cycle") for s in summaries]
    if not any(cycles):
        return []
    fractions = [c["saturation_duty"] if c else {} for c in cycles]
    duties = [", ".join(f"{device} {100 * part:.0f}" for device, part in parts.items()) for parts in fractions]
    return [
        ("limit cycle, amplitude [p.u.]", [f"{c['amplitude_pu']:.3g}" if c else "-" for c in cycles]),
        ("  setpoints at their limit [%]", [duty or "-" for duty in duties]),
    ]


def _oscillation(
    record: Record,
    differences: Mapping[str, NDArray[np.float64]],
    method: str | None,
    stable: bool | None,
    twin: Twin | None,
) -> dict[str, Any]:
    """Figures that exist only for a run in synchronism to its end."""
    if not stable:
        because = instability(record) or unknown(record)
        undefined = (
            "verdict_of growth_per_s limit_cycle indices indices_since_event indices_of_response settling_time_s"
        )
        found = {"verdict": LOST if stable is False else UNDECIDED, "verdict_because": because, "damped": False}
        return found | dict.fromkeys(undefined.split()) | _modes(None)
    swings = swings_of(record, twin, differences)
    t, own, last = record.time_s, swings.own, swings.last
    fit, how = _fit(record, swings.judged[: swings.ringing], last, method)
    judged = judge_run(
        record,
        twin,
        swings,
        (lambda: fit) if how == METHOD else None,
        (lambda: fit) if how == ambient.METHOD else None,
    )
    if swings.response is not None and judged.of == RUN:  # it is not linear: its response has no modes
        fit, how = _fit(record, own, last, method)
    verdict = judged.judgement
    cycle = {"amplitude_pu": verdict.amplitude_pu, "saturation_duty": saturation_duty(record, verdict.start_s)}
    return {
        "verdict": verdict.verdict,
        "verdict_because": verdict.because,
        "verdict_of": judged.of,
        "damped": verdict.verdict == DAMPED,
        "growth_per_s": verdict.growth and verdict.growth._asdict(),
        "limit_cycle": cycle if verdict.verdict == LIMIT_CYCLE else None,
        "indices": performance_indices(t, own),
        "indices_since_event": performance_indices(t, own, (swings.times or [0.0])[0]),
        "indices_of_response": swings.indices,
        "settling_time_s": settling_time(t[: len(swings.judged)], swings.judged, last),
        **_modes(fit, how),
    }


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


def _modes(fit: Fit | None, method: str | None = None) -> dict[str, Any]:
    if fit is None:
        return {"modes": [], "modes_method": None, "ringdown": None}
    modes = [{key: _known(value) for key, value in mode._asdict().items() if key != "energy"} for mode in fit.modes]
    how = {"modes": modes, "modes_method": method}
    return how | {"ringdown": {"start_s": fit.start_s, "order": fit.order, "snr_db": fit.snr_db}}


def _known(value: float | tuple[float, ...]) -> float | list[float] | None:
    """A number or several for JSON; None for NaN."""
    if isinstance(value, tuple):
        return list(value)
    return None if np.isnan(value) else value


def find(summary: Any, path: Sequence[str | int]) -> Any:
    """Value at a path; None if the path ends early."""
    for key in path:
        if not summary or (isinstance(key, str) and key not in summary):
            return None
        summary = summary[key]
    return summary


def row_text(summary: Mapping[str, Any], path: Sequence[str | int], form: str) -> str:
    """A figure of the table; if the step was halved, with only the digits that hold."""
    value, change = find(summary, path), find(summary, ("step_change", path[-1]))
    known = change is not None and isinstance(value, float)
    return convergence.text(value, change, form) if known else value_text(value, form)


def value_text(value: Any, form: str) -> str:
    """A figure of the table."""
    if isinstance(value, dict):
        return f"{value['value']:{form}} ({value['low']:{form}} to {value['high']:{form}}) {value['signal']}"
    if value is None or isinstance(value, bool):
        return WORDS[value]
    return WORDS[None] if isinstance(value, float) and math.isnan(value) else format(value, form)
