"""Actions of the controllers' supervisors: changes of state and their causes, probes, refusals to arm."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from facts_damping.analysis.releases import timeout
from facts_damping.monitor_table import (
    ARMED,
    BY_SCHEDULE,
    CAUSES,
    COUNTED,
    MONITORS,
    NO_CAUSE,
    PROBE_GAIN,
    PROBE_PHASE,
    PROBE_WEAK,
    SHADOW,
    STATES,
    TRIPPED,
    cause_name,
    count_text,
)
from facts_damping.parameters.supervision import Supervision, watches
from facts_damping.record import group_by
from facts_damping.signals import NANOSECONDS

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray

    from facts_damping.record import Record

SILENT = "silent"  # stands for the state of a failed supervisor
DIGITS = range(3, 7)  # digits of a value and its limit: as few as distinguish them
MAXIMUM = 6  # changes listed in a table: the first ones and the last
_NAMES = list(MONITORS)


class Bound(NamedTuple):
    """A value beyond its limit."""

    value: float
    limit: float
    unit: str


class Refusal(NamedTuple):
    """A refusal to arm: time (s) and cause, with the cause's value, limit and unit if it has a number."""

    time_s: float
    cause: str
    value: float | None = None
    limit: float | None = None
    unit: str | None = None

    @property
    def state(self) -> str:
        """Stands for the new state of a change."""
        return "not armed"


class StateChange(NamedTuple):
    """A change of state with its cause, as of a `Refusal`; SILENT: the supervisor fell silent."""

    state: str
    time_s: float
    cause: str
    value: float | None = None
    limit: float | None = None
    unit: str | None = None


class ProbeResult(NamedTuple):
    """What a probe measured, of the device whose response is known least; None: unknown."""

    gain: float | None  # response relative to the model's
    phase_deg: float | None
    coherence: float | None
    added_damping_per_s: float | None
    phase_margin_deg: float | None
    delay_margin_ms: float | None
    gain_margin: float | None


class SupervisorHistory(NamedTuple):
    """Actions of a controller's supervisor."""

    controller: str
    state: str  # the last
    fractions: dict[str, float]  # of the run's ticks by state; the sum is below 1 if it was silent
    changes: list[StateChange]
    trips: int
    refusals: list[Refusal]
    probe: ProbeResult | None  # the newest


def supervised(record: Record) -> dict[str, NDArray[Any]]:
    """Rows of SUPERVISION of each supervised controller, by its name."""
    return {record.controller_names[c]: rows for (c,), rows in group_by(record.supervision, "controller")}


def limits(record: Record) -> dict[str, float]:
    """Limit of each monitor in the run, in its unit; inf: not watched."""
    return {name: watch.limit for name, watch in watches(_given(record)).items()}


def on_ticks(record: Record, statuses: NDArray[Any], values: NDArray[Any]) -> NDArray[np.float64]:
    """Values of a supervisor's rows on the grid of the record's ticks; NaN where there is no row."""
    gridded = np.full(len(record.time_ns), np.nan)
    place, inside = np.searchsorted(record.ticks, statuses["tick"]), np.isin(statuses["tick"], record.ticks)
    gridded[place[inside]] = values[inside]
    return gridded


def strained(record: Record, statuses: NDArray[Any], minimum: float) -> dict[str, NDArray[np.float64]]:
    """Monitors relative to their limits, (ticks,), 1 at the limit; only those that once exceeded `minimum`.

    Monitors that are not watched are left out; with a limit of zero, the value itself is given.
    """
    relative = {}
    for (name, limit), values in zip(limits(record).items(), statuses["values"].T, strict=True):
        beside = on_ticks(record, statuses, values) / (limit or 1.0)
        if math.isfinite(limit) and np.any(beside > minimum):
            relative[name] = beside
    return relative


def _given(record: Record) -> Supervision:
    """The run's supervision; the defaults if the record does not hold it."""
    return Supervision.model_validate(record.configuration.get("supervision") or {})


def supervision(record: Record, mode_hz: float | None = None) -> list[SupervisorHistory]:
    """Actions of each supervisor; empty without supervisors.

    `mode_hz`: frequency of the mode, which converts the phase margin into a delay margin.
    """
    histories = []
    for name, rows in supervised(record).items():
        changes = list(_changes(record, rows))
        counts = {state: int(np.count_nonzero(rows["state"] == code)) for code, state in enumerate(STATES)}
        history = SupervisorHistory(
            name,
            changes[-1].state if changes else STATES[SHADOW],
            {state: count / len(record.time_ns) for state, count in counts.items()},
            changes,
            sum(change.state == STATES[TRIPPED] for change in changes),
            list(_refusals(record, rows)),
            _probe(rows, mode_hz),
        )
        histories.append(history)
    return histories


def _changes(record: Record, statuses: NDArray[Any]) -> Iterator[StateChange]:
    """Changes of state, and the times at which a supervisor fell silent for longer than the devices' timeout.

    The initial state is shadow.
    """
    longest = timeout(record) * record.frame_rate
    ends = np.append(statuses["tick"] + 1, record.ticks[-1] + 1)  # ticks at which each silence begins
    silent = np.append(statuses["tick"], record.ticks[-1] + 1)[1:] - ends[:-1] > longest
    changed = np.diff(statuses["state"], prepend=SHADOW) != 0
    changed[1:] |= silent[:-1]
    for i in np.flatnonzero(changed | silent):
        cause = int(statuses["cause"][i])
        if changed[i]:
            bound = _bound(record, statuses[i], cause)
            yield StateChange(
                STATES[statuses["state"][i]], _time_s(record, statuses["tick"][i]), cause_name(cause), *(bound or ())
            )
        if silent[i]:
            yield StateChange(SILENT, _time_s(record, ends[i]), "")


def _refusals(record: Record, statuses: NDArray[Any]) -> Iterator[Refusal]:
    """Causes for refusing to arm; values are of the tick before, on which the decision was based."""
    for i in np.flatnonzero(np.diff(statuses["refused"], prepend=NO_CAUSE)):
        cause = int(statuses["refused"][i])
        if cause != NO_CAUSE:
            bound = _bound(record, statuses[max(i - 1, 0)], cause)
            yield Refusal(_time_s(record, statuses["tick"][i]), cause_name(cause), *(bound or ()))


def _time_s(record: Record, tick: int) -> float:
    return int(tick) * NANOSECONDS // record.frame_rate / NANOSECONDS


def _bound(record: Record, row: Any, cause: int) -> Bound | None:
    """Value and limit of a cause; None if it has no number or the recorded value is within the limit.

    The latter holds for a return to normal, and for a probe if the failed device is not the recorded one.
    """
    probe, below = _given(record).probe, cause == PROBE_WEAK
    gain, phase = float(row["probe_gain"]), abs(math.degrees(float(row["probe_phase"])))
    if cause >= 0:
        name = _NAMES[cause]
        bound = Bound(float(row["values"][cause]), limits(record)[name], MONITORS[name].unit)
    elif cause == PROBE_WEAK:
        bound = Bound(float(row["probe_coherence"]), probe.coherence, "-")
    elif cause == PROBE_GAIN:
        below = gain < 1.0
        bound = Bound(gain, 1.0 / probe.gain if below else probe.gain, "-")
    elif cause == PROBE_PHASE:
        bound = Bound(phase, probe.phase, "deg")
    else:
        return None
    beyond = bound.value < bound.limit if below else bound.value > bound.limit
    return bound if beyond and math.isfinite(bound.value) else None


def _probe(statuses: NDArray[Any], mode_hz: float | None) -> ProbeResult | None:
    """The newest known probe, of the device whose response is known least."""
    known = statuses[np.isfinite(statuses["probe_gain"])]
    if not len(known):
        return None
    row, margin = known[-1], math.degrees(float(known[-1]["phase_margin"]))
    delay = margin / 360.0 / mode_hz * 1e3 if mode_hz else math.nan
    figures = (
        row["probe_gain"],
        math.degrees(float(row["probe_phase"])),
        row["probe_coherence"],
        row["added_damping"],
        margin,
        delay,
        row["gain_margin"],
    )
    return ProbeResult(*(float(value) if math.isfinite(value) else None for value in figures))


def history_text(history: SupervisorHistory) -> str:
    """Actions of a supervisor in one line."""
    texts, seen = [], set()
    for change in actions(history):
        texts.append(change_text(change, again=change.state in seen))
        seen.add(change.state)
    if not history.changes:
        texts.append(f"never armed, {STATES[SHADOW]} to the end")
    if len(texts) > MAXIMUM:
        texts[MAXIMUM - 2 : -1] = [f"{len(texts) - MAXIMUM + 1} more changes"]
    return "; ".join(texts)


def actions(history: SupervisorHistory) -> list[StateChange | Refusal]:
    """Changes of state and refusals to arm, by time."""
    return sorted([*history.changes, *history.refusals], key=lambda action: action.time_s)


def change_text(change: StateChange | Refusal, *, again: bool = False) -> str:
    """Text of a change or of a refusal to arm: `tripped at 5.43 s: harm 0.21 1/s, more than 0.03`."""
    why = "" if change.cause in ("", CAUSES[BY_SCHEDULE]) else f": {cause_text(change)}"
    return f"{change.state}{' again' * again} at {change.time_s:.2f} s{why}"


def cause_text(change: StateChange | Refusal) -> str:
    """Text of a cause, with value and limit."""
    cause, value, limit = change.cause, change.value, change.limit
    if value is None or limit is None:
        return f"{cause} is over" if cause in MONITORS and change.state == STATES[ARMED] else cause
    if cause in COUNTED:
        return count_text(cause, value)
    unit = "" if change.unit == "-" else f" {change.unit}"
    for digits in DIGITS:
        shown, bound = (f"{number:.{digits}g}" for number in (value, limit))
        if shown != bound:
            return f"{cause} {shown}{unit}, {'more' if value > limit else 'less'} than {bound}"
    return f"{cause} {value:.3g}{unit}, the limit"


def probe_text(probe: ProbeResult | None) -> str:
    """Text of a probe."""
    if probe is None:
        return "-"
    texts = [f"{probe.gain:.2f} times the model's response, {probe.phase_deg:+.0f} deg"]
    texts.append(f"coherence {probe.coherence:.2f}")
    if probe.added_damping_per_s is not None:
        texts.append(f"adds {probe.added_damping_per_s:.2g} 1/s of damping")
    if probe.phase_margin_deg is not None:
        delay = "" if probe.delay_margin_ms is None else f" ({probe.delay_margin_ms:.0f} ms)"
        texts.append(f"phase margin {probe.phase_margin_deg:.0f} deg{delay}")
    if probe.gain_margin is not None:
        texts.append(f"gain margin {probe.gain_margin:.2g}")
    return "; ".join(texts)


def trips(histories: Sequence[SupervisorHistory]) -> list[tuple[float, str, str]]:
    """Time (s), controller and cause of each trip."""
    return [(change.time_s, controller, change.cause) for controller, change in tripping(histories)]


def tripping(histories: Sequence[SupervisorHistory]) -> list[tuple[str, StateChange]]:
    """Each trip with its controller."""
    changes = [(history.controller, change) for history in histories for change in history.changes]
    return [(controller, change) for controller, change in changes if change.state == STATES[TRIPPED]]


def tripped_texts(histories: Sequence[SupervisorHistory]) -> list[str]:
    """One line per tripped controller, about its last trip."""
    last = dict(tripping(histories))
    return [f"{controller} was {change_text(change)}" for controller, change in last.items()]
