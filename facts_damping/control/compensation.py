"""Delay compensation: signals at the time when the setpoint takes effect, from a mode or a prediction; compiled.

The latency tau is the sum of the uplink's delay (arrival minus measurement of the newest frame, after a first-order
filter) and the set downlink delay, which a controller cannot measure. Two compensators advance a signal by w tau at one
frequency w:

    lead:   two equal sections (1 + s a) / (1 + s / (a w^2)) / (a w), each of phase w tau / 2 and gain 1 at w
    phasor: y = y0 + Re q, with mean y0 and phasor q estimated; gives Re(q exp(j w tau))

Both are retuned to the latency at every frame. The third method adds the change of the signals until then that the
controller's identifier predicts (control/prediction.py).

Sections: P. Kundur, Power System Stability and Control, 1994, 12.5. Phasor: L. Angquist, C. Gama, Damping Algorithm
Based on Phasor Estimation, IEEE PES Winter Meeting 2001. Advance by the latency: N. R. Chaudhuri, S. Ray, R. Majumder,
B. Chaudhuri, A New Approach to Continuous Latency Compensation With Adaptive Phasor Power Oscillation Damping
Controller (POD), IEEE Trans. Power Systems 25(2), 2010.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from facts_damping.compiling import compiled
from facts_damping.compiling.structs import Float1, Float2, Float3, Int1, Struct
from facts_damping.control.inputs import UNSET
from facts_damping.control.lead_lag import section
from facts_damping.elementary import cos, exp, sin, tan

if TYPE_CHECKING:
    from collections.abc import Sequence


NONE, LEAD, PHASOR, PREDICTION = 0, 1, 2, 3
COMPENSATIONS = {"none": NONE, "lead": LEAD, "phasor": PHASOR}  # for any controller
OF_IDENTIFIERS = {"prediction": PREDICTION}  # for controllers with an identifier
HELD_NS = 100_000_000  # ns, largest age of a prediction's frame relative to the newest; older predictions are ignored
MAX_LEAD = math.radians(60.0)  # rad, largest phase lead of a section
SECTIONS = 2


class Compensators(Struct):
    """Constant parameters; the first axis is the controller."""

    code: Int1
    omega: Float1  # (controllers,), rad/s, of the mode


class Compensated(Struct):
    """State of compensation; the first axis is the controller."""

    latency: Float1  # (controllers,), s, of the uplink, filtered
    sections: Float3  # (controllers, most signals, 4): input and output of each section
    phasor: Float3  # (controllers, most signals, 3): mean, real and imaginary part
    change: Float2  # (controllers, most signals), p.u., predicted until the setpoint takes effect; NaN: none
    change_ns: Int1  # (controllers,): newest frame used for the change
    signal: Float2  # (controllers, most signals): compensated signals


def compensators(names: Sequence[str], omega: Sequence[float], signals: int) -> tuple[Compensators, Compensated]:
    """Compensators by name, at rest; `omega`: rad/s of each controller's mode; `signals`: most of a controller."""
    n = len(names)
    codes = COMPENSATIONS | OF_IDENTIFIERS
    constants = Compensators(np.array([codes[name] for name in names], np.int64), np.array(omega, np.float64))
    state = Compensated(
        latency=np.zeros(n),
        sections=np.zeros((n, signals, 2 * SECTIONS)),
        phasor=np.zeros((n, signals, 3)),
        change=np.full((n, signals), np.nan),
        change_ns=np.full(n, UNSET, np.int64),
        signal=np.full((n, signals), np.nan),
    )
    return constants, state


@compiled
def compensate(
    constants: Compensators, state: Compensated, c: int, s: Any, signals: Float1, newest_ns: int, age: float, dt: float
) -> None:
    """Compensate the signals `signals` of controller c at a frame; result in `state.signal[c]`.

    `s`: its settings (latency_filter, down_delay, phasor_rate); `newest_ns`: time of measurement; `age`: s from
    measurement to arrival; `dt`: s since the frame before, 0 at the first. Without a recent prediction, the method
    `prediction` leaves signals as measured.
    """
    for i in range(signals.size):
        state.signal[c, i] = signals[i]
    if constants.code[c] == NONE:
        return
    if constants.code[c] == PREDICTION:
        held = newest_ns - state.change_ns[c] <= HELD_NS
        for i in range(signals.size):
            change = state.change[c, i]
            if held and math.isfinite(change) and change != 0.0:
                state.signal[c, i] += change
        return
    fraction = 1.0 if dt <= 0.0 or s.latency_filter <= 0.0 else 1.0 - exp(-dt / s.latency_filter)
    state.latency[c] += fraction * (age - state.latency[c])
    phase = constants.omega[c] * max(0.0, state.latency[c] + s.down_delay)
    for i in range(signals.size):
        if constants.code[c] == LEAD:
            state.signal[c, i] = lead(constants.omega[c], phase, state.sections[c, i], signals[i], dt)
        else:
            state.signal[c, i] = phasor(constants.omega[c], phase, s.phasor_rate, state.phasor[c, i], signals[i], dt)


@compiled
def lead(omega: float, phase: float, state: Float1, y: float, dt: float) -> float:
    """One step of two sections with total phase `phase`, rad, and gain 1 at `omega`, rad/s.

    a w = sqrt((1 + sin p) / (1 - sin p)), p the phase of one section, at most MAX_LEAD. For the bilinear transform w
    is prewarped: 2 / dt tan(omega dt / 2). The first frame starts from steady state.
    """
    sine = sin(min(phase / SECTIONS, MAX_LEAD))
    ratio = math.sqrt((1.0 + sine) / (1.0 - sine))
    if dt <= 0.0:
        for k in range(SECTIONS):
            state[2 * k] = y
            y = state[2 * k + 1] = y / ratio
        return y
    w = 2.0 / dt * tan(min(omega * dt / 2.0, 1.5))
    for k in range(SECTIONS):
        y = section(1.0 / w, 1.0 / ratio, 1.0 / (ratio * w), dt, state, 2 * k, y)
    return y


@compiled
def phasor(omega: float, phase: float, rate: float, state: Float1, y: float, dt: float) -> float:
    """One step of a signal's mean and phasor; returns the signal without mean, advanced by `phase`, rad.

        q = q exp(j omega dt);  e = y - y0 - Re q;  y0 = y0 + (1 - l) e;  q = q + 2 (1 - l) e;  l = exp(-rate dt)

    For `rate` well below `omega` this is steady-state recursive least squares with forgetting factor l. For larger
    `rate` it stays stable (s^3 + 3 rate s^2 + omega^2 s + rate omega^2) but passes more of other frequencies. `state`:
    y0, Re q, Im q; at the first frame the mean is set to the signal.
    """
    if dt <= 0.0:
        state[0], state[1], state[2] = y, 0.0, 0.0
        return 0.0
    c, s = cos(omega * dt), sin(omega * dt)
    real, imaginary = c * state[1] - s * state[2], s * state[1] + c * state[2]
    gain = 1.0 - exp(-rate * dt)
    error = y - state[0] - real
    state[0] += gain * error
    state[1], state[2] = real + 2.0 * gain * error, imaginary
    return state[1] * cos(phase) - state[2] * sin(phase)  # type: ignore[no-any-return]
