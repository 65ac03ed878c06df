"""The watchdog of every device: which setpoints it takes, and when it lets go."""

from __future__ import annotations

from facts_damping.parameters.base import ParameterModel, quantity


class Watchdog(ParameterModel):
    """What each device checks by itself, whatever controllers and links do (docs/watchdog.md)."""

    timeout: float = quantity(0.2, "s", "longest time without an accepted setpoint", gt=0, le=1e5)
    max_age: float = quantity(1.0, "s", "largest age of the newest measurement of a setpoint", gt=0, le=1e5)
    release_rate: float = quantity(0.2, "p.u./s", "rate at which a released device goes to zero", gt=0, le=1000)
    good: int | None = quantity(
        None, "-", "setpoints accepted in a row that re-arm a device; none: only an operator does", ge=1, le=10**6
    )
