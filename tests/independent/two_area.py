"""Independent reference model of the two-area, four-machine systems: scenarios, modes and integration.

Written from the equations alone (docs/plant.md) and by other means than the
package: full complex bus admittance matrix without reduction (:mod:`.network`), stator and network as one
dense real linear system at every evaluation, the SSSC's current by Newton iteration on its port equation,
rotors of the standard machine as magnetic circuits (:mod:`.dynamics`), power flow by
``scipy.optimize.root``, integration by SciPy's Radau between events.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
from scipy.integrate import solve_ivp

from .dynamics import U_MAX, System
from .network import HEALTHY, KUNDUR_12_6, TWO_AREA, Array, Case, Config, power_flow

if TYPE_CHECKING:
    from collections.abc import Sequence

__all__ = [
    "HEALTHY",
    "KUNDUR_12_6",
    "TWO_AREA",
    "Case",
    "Config",
    "Event",
    "Mode",
    "Run",
    "System",
    "build",
    "bus_fault",
    "large",
    "linearise",
    "modes",
    "multiple",
    "power_flow",
    "radau",
    "ramp",
    "small",
]

RAMP = 5.0  # p.u./s, the SSSC's rate limit (docs/plant.md)

Event = tuple[float, Config]


def small(factor: float = 0.9) -> list[Event]:
    """Load of bus 9 (not its capacitor) multiplied at 1 s."""
    return [(1.0, Config(load_factor=(("9", factor),)))]


def large(cycles: float = 8.0, line: str = "4", fraction: float = 0.9) -> list[Event]:
    """Bolted, self-clearing three-phase fault on a line at 1 s."""
    return [(1.0, Config(fault=(line, fraction))), (1.0 + cycles / 60.0, HEALTHY)]


def multiple(reclose: float = 6.0) -> list[Event]:
    """Line 2 out at 1 s, in again; mechanical power of G1 up by 10 % at 10 s."""
    out, step = Config(lines_out=frozenset({"2"})), Config(Pm_factor=(1.1, 1.0, 1.0, 1.0))
    return [(1.0, out), (reclose, HEALTHY), (10.0, step)]


def bus_fault(bus: str = "w", start: float = 1.0, stop: float = 1.1, z: complex = 0.0j) -> list[Event]:
    """Fault at a bus ("w" and "e" are one node to within the bypass when no device is installed)."""
    return [(start, Config(fault=(bus, None), fault_z=z)), (stop, HEALTHY)]


def linearise(system: System, step: float = 1e-5) -> tuple[Array, Array]:
    """Central differences of the right-hand side at the start: A (n, n) and the SSSC's input vector b (n)."""
    x0 = system.x0
    steps = step * np.eye(len(x0))
    columns = [(system.rhs(0.0, x0 + d) - system.rhs(0.0, x0 - d)) / (2 * step) for d in steps]
    return np.array(columns).T, (system.rhs(0.0, x0, step) - system.rhs(0.0, x0, -step)) / (2 * step)


@dataclass(frozen=True)
class Mode:
    """Eigenvalue with frequency [Hz], damping ratio and residue from v_q to ``weights @ dw``."""

    eigenvalue: complex
    hertz: float
    damping: float
    residue: complex


def modes(system: System, weights: Sequence[float] = (1.0, 0.0, -1.0, 0.0), low: float = 0.3) -> list[Mode]:
    """Oscillatory modes between ``low`` and 2 Hz by rising frequency: interarea, then the two local ones."""
    A, b = linearise(system)
    values, right = np.linalg.eig(A)
    left = np.linalg.inv(right)
    found = []
    for k in np.flatnonzero((values.imag > 2 * np.pi * low) & (values.imag < 4 * np.pi)):
        residue = complex((np.array(weights) @ right[4:8, k]) * (left[k] @ b))
        value = complex(values[k])
        found.append(Mode(value, value.imag / (2 * np.pi), -value.real / abs(value), residue))
    return sorted(found, key=lambda mode: mode.hertz)


def ramp(targets: Sequence[tuple[float, float]], t_end: float) -> tuple[Array, Array]:
    """Corners (t, u) of the setpoint: every target clipped to +-0.1 and approached at 5 p.u./s from zero."""
    t, u = [0.0], [0.0]
    ends = [*[start for start, _ in targets[1:]], t_end]
    for (start, value), end in zip(targets, ends, strict=False):
        goal = min(max(value, -U_MAX), U_MAX)
        arrival = start + abs(goal - u[-1]) / RAMP
        reached = goal if arrival <= end else u[-1] + np.sign(goal - u[-1]) * RAMP * (end - start)
        t += [start, min(arrival, end)]
        u += [u[-1], float(reached)]
    return np.array([*t, max(t_end, t[-1])]), np.array([*u, u[-1]])


@dataclass(frozen=True)
class Run:
    """Result of :func:`radau`: times (n), states (n, states), and the ramped setpoint (n)."""

    t: Array
    x: Array
    u: Array

    @property
    def speeds(self) -> Array:
        """Speed deviations [p.u.], shape (n, 4)."""
        return self.x[:, 4:8]

    def lost_at(self, degrees: float = 180.0) -> float:
        """First time at which two rotors are further apart than ``degrees``; inf when they never are."""
        apart = np.flatnonzero(np.ptp(self.x[:, :4], axis=1) > np.deg2rad(degrees))
        return float(self.t[apart[0]]) if len(apart) else float("inf")


def radau(
    system: System,
    events: Sequence[Event],
    u_of_t: Sequence[tuple[float, float]],
    t_end: float,
    t_eval: Array,
    rtol: float = 1e-9,
    *,
    method: str = "Radau",
    atol: float = 1e-11,
) -> Run:
    """Integrate between events and corners of the ramped setpoint, each a boundary of an integration.

    ``u_of_t`` holds (time, target) of a piecewise-constant setpoint, which the rate limit turns into a ramp.
    The setpoint starts from zero; a ramp is exact. ``method`` may be any of ``solve_ivp``: LSODA agrees to
    1e-10 in speed and is some four times faster.
    """
    corner_t, corner_u = ramp(u_of_t, t_end)
    bounds = np.r_[0.0, [t for t, _ in events], corner_t, t_end]
    bounds = np.unique(bounds[(bounds >= 0.0) & (bounds <= t_end)])
    bounds = bounds[np.r_[True, np.diff(bounds) > 1e-12]]
    x, config = system.x0, HEALTHY
    times, states = [np.empty(0)], [np.empty((0, len(x)))]
    for a, b in pairwise(bounds):
        for when, new in events:
            config = new if when <= a + 1e-12 else config
        slope = float(np.interp(b, corner_t, corner_u) - np.interp(a, corner_t, corner_u)) / (b - a)
        u_a = float(np.interp(a, corner_t, corner_u))

        def fun(t: float, y: Array, line: tuple[float, ...] = (a, u_a, slope), now: Config = config) -> Array:
            return system.rhs(t, y, line[1] + line[2] * (t - line[0]), now)

        inside = t_eval[(t_eval >= a - 1e-12) & (t_eval < b - 1e-12)].clip(a, b)
        wanted = np.r_[inside, b]
        done = solve_ivp(fun, (a, b), x, method=method, rtol=rtol, atol=atol, t_eval=wanted)
        if not done.success:
            raise RuntimeError(f"integration stopped at t = {a} s: {done.message}")
        times.append(inside)
        states.append(done.y.T[: len(inside)])
        x = done.y[:, -1]
    last = t_eval[t_eval >= t_end - 1e-12]
    t = np.concatenate([*times, last])
    return Run(t, np.vstack([*states, np.tile(x, (len(last), 1))]), np.interp(t, corner_t, corner_u))


def build(case: Case, *, device: bool = False, llc: float = 0.0, exciter: str = "") -> System:
    """Build two_area (cascade machines, static exciter) or kundur_12_6 (genrou, constant field)."""
    thesis = case.name == "two_area"
    chosen = exciter or ("static" if thesis else "constant")
    return System(case, "cascade" if thesis else "genrou", chosen, device=device, llc=llc)
