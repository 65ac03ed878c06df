"""What the supervisors of the controllers did: changes of state with what caused them, probes, what was refused."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from facts_damping.analysis.releases import timeout
from facts_damping.monitor_table import (
    ARMED,
    BY_SCHEDULE,
    CAUSES,
    MONITORS,
    NO_CAUSE,
    PROBE_GAIN,
    PROBE_PHASE,
    PROBE_WEAK,
    SHADOW,
    STATES,
    TRIPPED,
    cause_name,
)
from facts_damping.parameters.supervision import Supervision, watches
from facts_damping.signals import NANOSECONDS, group_by

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from numpy.typing import NDArray

    from facts_damping.signals import Record

SILENT = "silent"  # in the place of a state: a supervisor that has failed
DIGITS = range(3, 7)  # of a value and its limit: as few as tell the two apart
MOST = 6  # changes that are told one by one in a table: the first ones, and the last
_NAMES = list(MONITORS)


class Bound(NamedTuple):
    """A value that was beyond its limit."""

    value: float
    limit: float
    unit: str


def supervised(record: Record) -> dict[str, NDArray[Any]]:
    """Rows of SUPERVISION of each controller that has a supervisor, by its name."""
    return {record.controller_names[c]: rows for (c,), rows in group_by(record.supervision, "controller")}


def limits(record: Record) -> dict[str, float]:
    """Limit of each monitor in the run, in its unit; inf: it is not watched."""
    return {name: one.limit for name, one in watches(_given(record)).items()}


def on_ticks(record: Record, rows: NDArray[Any], values: NDArray[Any]) -> NDArray[np.float64]:
    """Values of a supervisor's rows on the grid of the record's ticks; NaN where it said nothing."""
    found = np.full(len(record.time_ns), np.nan)
    place, inside = np.searchsorted(record.ticks, rows["tick"]), np.isin(rows["tick"], record.ticks)
    found[place[inside]] = values[inside]
    return found


def strained(record: Record, rows: NDArray[Any], least: float) -> dict[str, NDArray[np.float64]]:
    """Monitors beside their limits, (ticks,), 1 at the limit: those that came above a share of it once.

    What is not watched is left out; of a limit of zero it is the value itself.
    """
    found = {}
    for (name, limit), values in zip(limits(record).items(), rows["values"].T, strict=True):
        beside = on_ticks(record, rows, values) / (limit or 1.0)
        if math.isfinite(limit) and np.any(beside > least):
            found[name] = beside
    return found


def _given(record: Record) -> Supervision:
    """The run's supervision; the table's where a recording does not hold its run."""
    return Supervision.model_validate(record.configuration.get("supervision") or {})


def supervision(record: Record, mode_hz: float | None = None) -> list[dict[str, Any]]:
    """What each supervisor did, ready for JSON; empty where there is none.

    `controller`; `state`, the last; `shares` of the run's ticks by state, less than 1 in all where it was silent;
    `changes` and `refusals`, lists of `time_s`, `state` or nothing, `cause`, and the cause's `value`, `limit` and
    `unit`, where there is a number to it; `trips`, how many; `probe`, the newest one, or None. `mode_hz`: of the mode,
    by which a margin of phase is one of delay.
    """
    found = []
    for name, rows in supervised(record).items():
        changes = list(_changes(record, rows))
        found.append(
            {
                "controller": name,
                "state": changes[-1]["state"] if changes else STATES[SHADOW],
                "shares": _shares(record, rows),
                "changes": changes,
                "trips": sum(row["state"] == STATES[TRIPPED] for row in changes),
                "refusals": list(_refusals(record, rows)),
                "probe": _probe(rows, mode_hz),
            }
        )
    return found


def _shares(record: Record, rows: NDArray[Any]) -> dict[str, float]:
    """Share of the run's ticks in each state."""
    return {
        name: int(np.count_nonzero(rows["state"] == code)) / len(record.time_ns) for code, name in enumerate(STATES)
    }


def _changes(record: Record, rows: NDArray[Any]) -> Iterator[dict[str, Any]]:
    """Every change from one tick to the next, and where it fell silent for longer than devices wait for a setpoint.

    It begins in shadow.
    """
    longest = timeout(record) * record.frame_rate
    ends = np.append(rows["tick"] + 1, record.ticks[-1] + 1)  # from when on it is silent
    silent = np.append(rows["tick"], record.ticks[-1] + 1)[1:] - ends[:-1] > longest
    changed = np.diff(rows["state"], prepend=SHADOW) != 0
    changed[1:] |= silent[:-1]
    for i in np.flatnonzero(changed | silent):
        cause = int(rows["cause"][i])
        if changed[i]:
            bound = _bound(record, rows[i], cause)
            yield {"state": STATES[rows["state"][i]], **_told(record, rows["tick"][i], cause_name(cause), bound)}
        if silent[i]:
            yield {"state": SILENT, **_told(record, ends[i], "", None)}


def _refusals(record: Record, rows: NDArray[Any]) -> Iterator[dict[str, Any]]:
    """Why a controller was not armed; it was judged by what was known a tick before."""
    for i in np.flatnonzero(np.diff(rows["refused"], prepend=NO_CAUSE)):
        cause = int(rows["refused"][i])
        if cause != NO_CAUSE:
            bound = _bound(record, rows[max(i - 1, 0)], cause)
            yield _told(record, rows["tick"][i], cause_name(cause), bound)


def _told(record: Record, tick: int, cause: str, bound: Bound | None) -> dict[str, Any]:
    """What happened at a tick and why, with the value that was beyond its limit."""
    value, limit, unit = bound or (None, None, None)
    time_s = int(tick) * NANOSECONDS // record.frame_rate / NANOSECONDS
    return {"time_s": time_s, "cause": cause, "value": value, "limit": limit, "unit": unit}


def _bound(record: Record, row: Any, cause: int) -> Bound | None:
    """Value and limit of a cause; none where there is no number to it, or what was told is within the limit.

    So it is of a return to normal, and of a probe, where another device's answer is told than that which failed.
    """
    probe, below = _given(record).probe, cause == PROBE_WEAK
    gain, phase = float(row["probe_gain"]), abs(math.degrees(float(row["probe_phase"])))
    if cause >= 0:
        name = _NAMES[cause]
        found = Bound(float(row["values"][cause]), limits(record)[name], MONITORS[name].unit)
    elif cause == PROBE_WEAK:
        found = Bound(float(row["probe_coherence"]), probe.coherence, "-")
    elif cause == PROBE_GAIN:
        below = gain < 1.0
        found = Bound(gain, 1.0 / probe.gain if below else probe.gain, "-")
    elif cause == PROBE_PHASE:
        found = Bound(phase, probe.phase, "deg")
    else:
        return None
    beyond = found.value < found.limit if below else found.value > found.limit
    return found if beyond and math.isfinite(found.value) else None


def _probe(rows: NDArray[Any], mode_hz: float | None) -> dict[str, Any] | None:
    """The newest probe that is known: of the device whose answer is least as known."""
    known = rows[np.isfinite(rows["probe_gain"])]
    if not len(known):
        return None
    row, margin = known[-1], math.degrees(float(known[-1]["phase_margin"]))
    delay = margin / 360.0 / mode_hz * 1e3 if mode_hz else math.nan
    told = {
        "gain": row["probe_gain"],
        "phase_deg": math.degrees(float(row["probe_phase"])),
        "coherence": row["probe_coherence"],
        "added_damping_per_s": row["added_damping"],
        "phase_margin_deg": margin,
        "delay_margin_ms": delay,
        "gain_margin": row["gain_margin"],
    }
    return {name: float(value) if math.isfinite(value) else None for name, value in told.items()}


def rows(summaries: Sequence[Mapping[str, Any]]) -> list[tuple[str, list[str]]]:
    """Rows of a table of runs: what became of each supervised controller, and its probe."""
    each = [{one["controller"]: one for one in s.get("supervision") or ()} for s in summaries]
    found = []
    for name in dict.fromkeys(name for own in each for name in own):
        told = [own.get(name) for own in each]
        found.append((name, ["-" if one is None else history_text(one) for one in told]))
        if any(one and one["probe"] for one in told):
            found.append((f"{name} probe", [probe_text(one["probe"] if one else None) for one in told]))
    return found


def history_text(told: Mapping[str, Any]) -> str:
    """What a supervisor did, in a line."""
    parts = sorted([*told["changes"], *told["refusals"]], key=lambda row: float(row["time_s"]))
    texts, seen = [], set()
    for row in parts:
        state = row.get("state", "not armed")
        texts.append(change_text(row, again=state in seen))
        seen.add(state)
    if not told["changes"]:
        texts.append(f"{STATES[SHADOW]} to the end")
    if len(texts) > MOST:
        texts[MOST - 2 : -1] = [f"{len(texts) - MOST + 1} more changes"]
    return "; ".join(texts)


def change_text(row: Mapping[str, Any], *, again: bool = False) -> str:
    """A change, or a refusal to arm, for people: `tripped at 5.43 s: harm 0.21 1/s, more than 0.03`."""
    why = "" if row["cause"] in ("", CAUSES[BY_SCHEDULE]) else f": {cause_text(row)}"
    return f"{row.get('state', 'not armed')}{' again' * again} at {row['time_s']:.2f} s{why}"


def cause_text(row: Mapping[str, Any]) -> str:
    """Why, with the value and the limit that it has passed."""
    cause, value, limit = row["cause"], row["value"], row["limit"]
    if value is None:
        return f"{cause} is over" if cause in MONITORS and row.get("state") == STATES[ARMED] else str(cause)
    unit = "" if row["unit"] == "-" else f" {row['unit']}"
    for digits in DIGITS:
        found, bound = (f"{number:.{digits}g}" for number in (value, limit))
        if found != bound:
            return f"{cause} {found}{unit}, {'more' if value > limit else 'less'} than {bound}"
    return f"{cause} {value:.3g}{unit}, the limit"


def probe_text(probe: Mapping[str, Any] | None) -> str:
    """A probe, for people."""
    if probe is None:
        return "-"
    texts = [f"{probe['gain']:.2f} times the known answer, {probe['phase_deg']:+.0f} deg"]
    texts.append(f"coherence {probe['coherence']:.2f}")
    if probe["added_damping_per_s"] is not None:
        texts.append(f"adds {probe['added_damping_per_s']:.2g} 1/s of damping")
    if probe["phase_margin_deg"] is not None:
        delay = "" if probe["delay_margin_ms"] is None else f" ({probe['delay_margin_ms']:.0f} ms)"
        texts.append(f"phase margin {probe['phase_margin_deg']:.0f} deg{delay}")
    if probe["gain_margin"] is not None:
        texts.append(f"gain margin {probe['gain_margin']:.2g}")
    return "; ".join(texts)


def trips(told: Sequence[Mapping[str, Any]]) -> list[tuple[float, str, str]]:
    """Time (s), controller and cause of every trip in what supervisors did."""
    return [
        (row["time_s"], one["controller"], row["cause"])
        for one in told
        for row in one["changes"]
        if row["state"] == STATES[TRIPPED]
    ]


def tripped_texts(told: Sequence[Mapping[str, Any]]) -> list[str]:
    """Controllers that were tripped, a line each: the last time."""
    found = []
    for one in told:
        own = [row for row in one["changes"] if row["state"] == STATES[TRIPPED]]
        found += [f"{one['controller']} was {change_text(own[-1])}"] if own else []
    return found
