"""Text for the cause of a supervisor's state, or of a refusal to arm."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from facts_damping.monitor_table import (
    MONITORS,
    NOT_PROBED,
    PROBE_GAIN,
    PROBE_HARM,
    PROBE_PHASE,
    PROBE_WEAK,
    cause_name,
)

if TYPE_CHECKING:
    from numpy.typing import NDArray

_NAMES = list(MONITORS)


def reason_of(told: Any, thresholds: NDArray[Any], *, refused: bool = False) -> str:
    """Text for the cause in a SUPERVISION record, or with `refused` for the refusal to arm."""
    code = int(told["refused"] if refused else told["cause"])
    if code >= 0:
        row = MONITORS[_NAMES[code]]
        value, limit = float(told["values"][code]), float(thresholds["limit"][code])
        return f"{_NAMES[code]} ({row.description}): {value:.3g} {row.unit}; allowed: {limit:g}"
    found = {
        NOT_PROBED: "no probe; allowed: after ~/probe",
        PROBE_WEAK: f"probe with coherence {told['probe_coherence']:.2f}: the answer is lost in others' noise",
        PROBE_GAIN: f"probe with {told['probe_gain']:.2f} times the known answer",
        PROBE_HARM: f"probe by which control would take {-told['added_damping']:.3g} 1/s of damping away",
        PROBE_PHASE: f"probe with {math.degrees(told['probe_phase']):.0f} degrees off the known answer",
    }
    return found.get(code, cause_name(code))
