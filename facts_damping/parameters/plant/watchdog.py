"""The watchdog of every device: which setpoints it accepts, and when it releases the device."""

from __future__ import annotations

from facts_damping.fields import ParameterModel, quantity


class Watchdog(ParameterModel):
    """The [watchdog](supervision.md) of every device, which depends on neither controllers nor links."""

    timeout: float = quantity(
        0.2, "s", "longest time without an accepted setpoint; then the device is released", gt=0, le=1e5
    )
    max_age: float = quantity(
        1.0, "s", "largest age of the newest measurement on which an accepted setpoint is based", gt=0, le=1e5
    )
    release_rate: float = quantity(
        0.2, "p.u./s", "rate at which the setpoint of a released device goes to zero", gt=0, le=1000
    )
    good: int | None = quantity(
        None, "-", "setpoints accepted in a row that re-arm a device; none: only an operator re-arms it", ge=1, le=10**6
    )
