"""Warnings about a run's controllers, one line each: not armed, without effect, late, at their limits."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from facts_damping.analysis.supervision import cause_text
from facts_damping.monitor_table import ARMED, STATES

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from facts_damping.signals import Record

LATE_S = 2.0  # s; a longer mean latency suggests a mistake of units
MOSTLY = 0.5  # fraction of the frames


def odd_findings(
    record: Record, supervision: Sequence[Mapping[str, Any]], latency: Mapping[str, Any], duty: Mapping[str, float]
) -> list[str]:
    """Warnings that readers of the figures must know; empty if the controllers could act as intended.

    `supervision`, `latency`, `duty`: as in `analysis.summary`.
    """
    mean = latency.get("mean")
    late = (
        [] if mean is None or mean < 1e3 * LATE_S else [f"latency {mean / 1e3:.1f} s on average, more than {LATE_S:g}"]
    )
    limited = [
        f"{device} was at its limit {100 * fraction:.0f} % of the time"
        for device, fraction in duty.items()
        if fraction > MOSTLY
    ]
    return [*_not_armed(record, supervision), *_not_heard(record), *late, *limited]


def _not_armed(record: Record, supervision: Sequence[Mapping[str, Any]]) -> Iterator[str]:
    """Controllers that `arm_at` should have armed but that never were."""
    for one in supervision:
        if record.configuration.get("arm_at") is not None and one["fractions"][STATES[ARMED]] == 0.0:
            why = f" ({cause_text(one['refusals'][-1])})" if one["refusals"] else ""
            yield f"{one['controller']} was never armed{why}: it controlled nothing"


def _not_heard(record: Record) -> Iterator[str]:
    """Controllers without any setpoint that reached a device."""
    rows = record.configuration.get("controllers") or []
    fallbacks = {i for i, row in enumerate(rows) if row.get("fallback_of") is not None}
    for c, name in enumerate(record.controller_names):
        if c not in fallbacks and not (record.applied["controller"] == c).any():
            link = (rows[c].get("link") if c < len(rows) else None) or record.configuration.get("link") or {}
            delay = _delay(link) if isinstance(link, dict) else 0.0
            why = f": its link delays by {delay:g} s" if delay > LATE_S else ""
            yield f"no setpoint of {name} came to a device in {record.time_s[-1]:.3g} s{why}"


def _delay(link: Mapping[str, Any]) -> float:
    """Sum of a link's constant delays, both ways, s."""
    return sum(float(row.get("delay") or 0.0) for way in ("up", "down") for row in link.get(way) or ())
