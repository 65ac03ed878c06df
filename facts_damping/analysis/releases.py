"""Actions of the devices' watchdogs: releases, re-arming, refused setpoints; and nodes that joined during the run."""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from facts_damping.parameters.plant.watchdog import Watchdog
from facts_damping.signals import REFUSED

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from facts_damping.record import NodeJoined, Record, RefusedMessages


class Release(NamedTuple):
    """A device that let go: times of release and of re-arming (None: never), and its watchdog's timeout, s."""

    device: str
    time_s: float
    rearmed_s: float | None
    timeout_s: float


class WatchdogActions(NamedTuple):
    """Releases by time, and number of refused setpoints by device and cause."""

    releases: list[Release]
    refused_setpoints: dict[str, dict[str, int]]


def releases(record: Record) -> list[Release]:
    """Releases by time."""
    release_rows = []
    silent = timeout(record)
    for d, device in enumerate(record.device_names):
        released = record.devices["released"][:, d] == 1.0
        edges = np.flatnonzero(np.diff(np.concatenate([[False], released, [False]]).astype(int)))
        for first, after in zip(edges[::2], edges[1::2], strict=True):
            again = float(record.time_s[after]) if after < len(released) else None
            start = float(record.time_s[first])
            release_rows.append(Release(device, start, again, silent))
    return sorted(release_rows, key=lambda release: release.time_s)


def refused_setpoints(record: Record) -> dict[str, dict[str, int]]:
    """Number of setpoints that each device's watchdog refused, by cause; devices without any are left out."""
    refused = {}
    for d, device in enumerate(record.device_names):
        columns = {field.removeprefix("refused_"): record.devices[field][:, d] for field in REFUSED}
        known = {cause: column[np.isfinite(column)] for cause, column in columns.items()}
        counts = {cause: int(column[-1]) if len(column) else 0 for cause, column in known.items()}
        if any(counts.values()):
            refused[device] = counts
    return refused


def timeout(record: Record) -> float:
    """Timeout of a run's watchdogs, s."""
    return float((record.configuration.get("watchdog") or {}).get("timeout", Watchdog().timeout))


def rows(runs: Sequence[WatchdogActions]) -> list[tuple[str, list[str]]]:
    """Rows of a table of runs: releases and refused setpoints by device."""
    texts = [[(release.device, released_text(release)) for release in run.releases] for run in runs]
    devices = dict.fromkeys(device for run in runs for device in run.refused_setpoints)
    refused = [[refused_text(run.refused_setpoints.get(device)) for run in runs] for device in devices]
    return [
        *by_name("released", texts),
        *zip((f"{device} refused setpoints" for device in devices), refused, strict=True),
    ]


def by_name(label: str, runs: Sequence[Sequence[tuple[str, str]]]) -> list[tuple[str, list[str]]]:
    """Rows of texts of each run (name, text): one for each name."""
    return [
        (f"{name} {label}", ["; ".join(text for whose, text in texts if whose == name) or "-" for texts in runs])
        for name in dict.fromkeys(name for texts in runs for name, _ in texts)
    ]


def released_text(release: Release) -> str:
    """Text of a release."""
    ended = "" if release.rearmed_s is None else f", re-armed at {release.rearmed_s:.2f} s"
    return f"at {release.time_s:.2f} s: no setpoint for {release.timeout_s:g} s{ended}"


def joined_text(joined: NodeJoined) -> str:
    """Text of a node that joined during the run."""
    armed = "disarmed" if joined.armed_s is None else f"armed at {joined.armed_s:.2f} s"
    return f"at {joined.time_s:.2f} s, {armed}"


def refused_text(counts: Mapping[str, int] | None) -> str:
    """Text of refused setpoints: number and causes."""
    if not counts:
        return "-"
    return ", ".join(f"{number} by {cause}" for cause, number in counts.items() if number)


def refused_messages(refusals: Iterable[RefusedMessages]) -> str:
    """Text of messages that nodes refused: totals by cause; empty if there are none.

    Those on `/diagnostics` do not count: other programs may publish there.
    """
    counts: Counter[str] = Counter()
    for refused in refusals:
        counts[refused.cause] += refused.count * (refused.topic != "/diagnostics")
    return refused_text(counts) if counts.total() else ""
