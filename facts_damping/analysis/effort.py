"""Control effort: roughness of setpoints, saturation, injected voltage."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from facts_damping.analysis.measures import device_limits

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from facts_damping.record import Record


def roughness(setpoints: NDArray[np.float64], dt: float = 1.0) -> float:
    """Control-effort roughness `sqrt(1/N sum_k ((u_k+1 - 2 u_k + u_k-1) / dt^2)^2)`; smaller is smoother.

    `setpoints`: (ticks,) or (ticks, devices), p.u., those in force at each frame; N: number of differences of all
    devices; `dt`: frame length, s, gives p.u./s^2; 1 gives the plain second difference, p.u. 0 for fewer than three
    frames. Source: (5.34).
    """
    if len(setpoints) < 3 or setpoints.size == 0:
        return 0.0
    return float(np.sqrt(np.mean((np.diff(setpoints, 2, axis=0) / dt**2) ** 2)))


def record_roughness(record: Record) -> dict[str, float]:
    """Both forms of (5.34) for a record: `per_second` (over dt^2, p.u./s^2) and `per_frame` (plain, p.u.).

    dt is the median time step, because a lost frame lengthens only a single step.
    """
    dt = float(np.median(np.diff(record.time_s))) if len(record.time_ns) > 1 else 1.0
    setpoints = record.devices["setpoint"]
    return {"per_second": roughness(setpoints, dt), "per_frame": roughness(setpoints)}


def saturation_duty(record: Record, since: float = 0.0, until: float = np.inf) -> dict[str, float]:
    """Fraction of the frames at which a device's setpoint is at its limit, 0 to 1, by device; `since`, `until`: s.

    Only for devices whose limit is in the configuration (`device_limits`).
    """
    limits, t = device_limits(record.configuration), record.time_s
    inside = (t >= since) & (t <= until)
    return {
        name: float(np.mean(np.abs(record.devices["setpoint"][inside, i]) >= limits[name] * (1 - 1e-9)))
        for i, name in enumerate(record.device_names)
        if name in limits
    }


def max_injected_voltage(record: Record) -> float | None:
    """Largest magnitude of injected series voltage at any frame, p.u.; None without a series device."""
    voltage = np.abs(record.devices["injected_voltage"])
    finite = voltage[np.isfinite(voltage)]
    return float(finite.max()) if finite.size else None
