"""Actions of the devices' watchdogs: releases, re-arming, refused setpoints; and nodes that joined during the run."""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING, Any

import numpy as np

from facts_damping.parameters.plant.watchdog import Watchdog
from facts_damping.signals import REFUSED

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping, Sequence

    from facts_damping.record import Record


def releases(record: Record) -> list[dict[str, Any]]:
    """Releases by time: device, time of release and of re-arming (if any), s, and the timeout."""
    found: list[dict[str, Any]] = []
    silent = timeout(record)
    for d, device in enumerate(record.device_names):
        released = record.devices["released"][:, d] == 1.0
        edges = np.flatnonzero(np.diff(np.concatenate([[False], released, [False]]).astype(int)))
        for first, after in zip(edges[::2], edges[1::2], strict=True):
            again = float(record.time_s[after]) if after < len(released) else None
            start = float(record.time_s[first])
            found.append({"device": device, "time_s": start, "rearmed_s": again, "timeout_s": silent})
    return sorted(found, key=lambda row: row["time_s"])


def refused_setpoints(record: Record) -> dict[str, dict[str, int]]:
    """Number of setpoints that each device's watchdog refused, by cause; devices without any are left out."""
    found = {}
    for d, device in enumerate(record.device_names):
        columns = {field.removeprefix("refused_"): record.devices[field][:, d] for field in REFUSED}
        known = {cause: column[np.isfinite(column)] for cause, column in columns.items()}
        counts = {cause: int(column[-1]) if len(column) else 0 for cause, column in known.items()}
        if any(counts.values()):
            found[device] = counts
    return found


def timeout(record: Record) -> float:
    """Timeout of a run's watchdogs, s."""
    return float((record.configuration.get("watchdog") or {}).get("timeout", Watchdog().timeout))


def rows(summaries: Sequence[Mapping[str, Any]]) -> list[tuple[str, list[str]]]:
    """Rows of a table of runs: releases and refused setpoints by device, and nodes that joined."""
    found = _rows(summaries, "releases", "device", "released", released_text)
    for device in dict.fromkeys(name for s in summaries for name in s.get("refused_setpoints") or {}):
        cells = [refused_text((s.get("refused_setpoints") or {}).get(device)) for s in summaries]
        found.append((f"{device} refused setpoints", cells))
    return found + _rows(summaries, "joined", "node", "joined", joined_text)


def _rows(
    summaries: Sequence[Mapping[str, Any]], key: str, name: str, label: str, text: Callable[[dict[str, Any]], str]
) -> list[tuple[str, list[str]]]:
    """Rows of the lists under a key of the summaries, by name, as texts."""
    lists = [s.get(key) or [] for s in summaries]
    return [
        (f"{one} {label}", ["; ".join(text(row) for row in rows if row[name] == one) or "-" for rows in lists])
        for one in dict.fromkeys(row[name] for rows in lists for row in rows)
    ]


def released_text(row: dict[str, Any]) -> str:
    """Text of a release."""
    ended = "" if row["rearmed_s"] is None else f", re-armed at {row['rearmed_s']:.2f} s"
    return f"at {row['time_s']:.2f} s: no setpoint for {row['timeout_s']:g} s{ended}"


def joined_text(row: Mapping[str, Any]) -> str:
    """Text of a node that joined during the run."""
    armed = "disarmed" if row["armed_s"] is None else f"armed at {row['armed_s']:.2f} s"
    return f"at {row['time_s']:.2f} s, {armed}"


def refused_text(counts: dict[str, int] | None) -> str:
    """Text of refused setpoints: number and causes."""
    if not counts:
        return "-"
    return ", ".join(f"{number} by {cause}" for cause, number in counts.items() if number)


def refused_messages(rows: Iterable[Mapping[str, Any]]) -> str:
    """Text of messages that nodes refused: totals by cause; empty if there are none.

    Those on `/diagnostics` do not count: other programs may publish there.
    """
    counts: Counter[str] = Counter()
    for row in rows:
        counts[row["cause"]] += row["count"] * (row["topic"] != "/diagnostics")
    return refused_text(counts) if counts.total() else ""
