"""The probe: two tones beside the mode, and a fit of the plant's response relative to the known one; compiled.

    z' = lambda z + R u,  y = 2 Re(g z) + e^(sigma t) (a cos omega t + b sin omega t) + c + d t

z is the modal state of the linearised plant, and R the residue from setpoint to signal. Least squares give g: the gain
and phase of the response relative to the known one. a and b model the mode's free swing, c and d the grid's drift. The
coherence is the fraction of the residual sum of squares without z that z explains.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from facts_damping.compiling import compiled
from facts_damping.control.inputs import UNSET
from facts_damping.elementary import cos, exp, exp_complex, magnitude, phase, sin
from facts_damping.signals import NANOSECONDS
from facts_damping.supervision.model import UNKNOWNS

if TYPE_CHECKING:
    from facts_damping.compiling.structs import Float2
    from facts_damping.supervision.model import Supervisors, SupervisorState

PIVOT = 1e-12  # least pivot / squared norm of its column; below it the column depends on others


@compiled
def tones(supervisors: Supervisors, state: SupervisorState, s: int, d: int, at_ns: int) -> float:
    """A probe's setpoint for a device at a time, p.u.; 0 if the device is not being probed."""
    row, settings = state.rows[s], supervisors.settings[s]
    if row.probe_ns == UNSET or d != row.probed:
        return 0.0
    t, w = (at_ns - row.probe_ns) * 1e-9, settings.omega
    both = sin(w * (1.0 - settings.apart) * t) + sin(w * (1.0 + settings.apart) * t)
    return settings.amplitude * supervisors.devices[s, d].limit * both  # type: ignore[no-any-return]


@compiled
def write_regressors(supervisors: Supervisors, state: SupervisorState, s: int, tick: int, u: float) -> None:
    """Advance the modal state z to the next tick's start, with setpoint `u` constant over this tick."""
    row, settings = state.rows[s], supervisors.settings[s]
    size = state.expected.shape[1]
    eigenvalue = complex(settings.sigma, settings.omega)
    step = exp_complex(eigenvalue / settings.frame_rate)
    before = state.expected[s, tick % size]
    held = supervisors.devices[s, row.probed].residue * (step - 1.0) / eigenvalue
    state.expected[s, (tick + 1) % size] = step * before + held * u


@compiled
def update_fit(supervisors: Supervisors, state: SupervisorState, s: int, tick: int) -> None:
    """Add the newest signal to the fit if it was measured during the probe and is recent enough."""
    row, settings, measured = state.rows[s], supervisors.settings[s], state.held.newest_ns[s]
    at = (measured * settings.frame_rate + NANOSECONDS // 2) // NANOSECONDS
    size = state.expected.shape[1]
    if measured < row.probe_ns or at > tick or tick - at >= size - 1:
        return
    z, t = state.expected[s, at % size], (measured - row.probe_ns) * 1e-9
    fading = exp(settings.sigma * t)
    sums = state.sums[s, 0]
    v = sums[UNKNOWNS]  # work space
    v[0], v[1] = 2.0 * z.real, -2.0 * z.imag
    v[2], v[3] = fading * cos(settings.omega * t), fading * sin(settings.omega * t)
    v[4], v[5], v[6] = 1.0, t / settings.probe_s, state.held.signal[s, 0]
    for i in range(UNKNOWNS):
        for j in range(i, UNKNOWNS + 1):
            sums[i, j] += v[i] * v[j]
    row.squares += v[6] * v[6]


@compiled
def fit(sums: Float2, squares: float, work: Float2, first: int) -> float:
    """Solve for the unknowns from `first` on; returns the residual sum of squares.

    The solution goes into the last column of `work`. `sums`: upper triangle of the products of all regressors with each
    other and with the signal. Method: Gauss-Jordan with pivots on the diagonal (the matrix is positive semidefinite); a
    regressor that depends on others is left out.
    """
    n = UNKNOWNS
    for i in range(first, n):
        for j in range(first, n):
            work[i, j] = sums[min(i, j), max(i, j)]
        work[i, n] = sums[i, n]
    for k in range(first, n):
        pivot = work[k, k]
        sound = pivot > PIVOT * sums[k, k]
        for j in range(first, n + 1):
            work[k, j] = work[k, j] / pivot if sound else 0.0
        for i in range(first, n):
            if i != k:
                factor = work[i, k]
                for j in range(first, n + 1):
                    work[i, j] -= factor * work[k, j]
    left = squares
    for i in range(first, n):
        left -= sums[i, n] * work[i, n]
    return left


@compiled
def store_result(supervisors: Supervisors, state: SupervisorState, s: int) -> None:
    """Store the result of a device's probe, and reset the fit for the next device."""
    row, d = state.rows[s], state.rows[s].probed
    sums, work, probed = state.sums[s, 0], state.sums[s, 1], state.commanded[s, d]
    without = fit(sums, row.squares, work, 2)
    left = fit(sums, row.squares, work, 0)
    g = complex(work[0, UNKNOWNS], work[1, UNKNOWNS])
    probed.gain, probed.phase = magnitude(g), phase(g)
    probed.coherence = max(0.0, 1.0 - left / without) if without > 0.0 else 0.0
    probed.added = supervisors.devices[s, d].residue * g * gain_of(supervisors, state, s, d)
    reset_fit(state, s)
    row.probed += 1


@compiled
def reset_fit(state: SupervisorState, s: int) -> None:
    """Clear the sums and the modal state of the fit."""
    state.sums[s], state.expected[s], state.rows[s].squares = 0.0, 0.0, 0.0


@compiled
def gain_of(supervisors: Supervisors, state: SupervisorState, s: int, d: int) -> complex:
    """Phasor of output d / phasor of the first signal, at the mode and at the same time; 0 without a signal.

    The signal's phasor is advanced by omega from its time of measurement to now.
    """
    y = complex(state.phasors[s, 0, 1], state.phasors[s, 0, 2])
    if not magnitude(y) > 0.0:
        return 0j
    since = (state.rows[s].now_ns - state.held.newest_ns[s]) * 1e-9
    y *= exp_complex(complex(0.0, supervisors.settings[s].omega * since))
    return complex(state.phasors[s, 1 + d, 1], state.phasors[s, 1 + d, 2]) / y
