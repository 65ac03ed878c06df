"""PMUs: frames computed from phasor samples, and their errors; compiled.

Samples are taken `per_frame` times a frame. A frame measures the instant in the middle of its samples, and is available
a whole number of frames later.
"""

from __future__ import annotations

import math
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray

from facts_damping.compiling import compiled
from facts_damping.compiling.structs import (
    Array,
    Bool2,
    Complex1,
    Complex2,
    Complex3,
    Float1,
    Float2,
    Float3,
    Int1,
    Int2,
    Struct,
)
from facts_damping.elementary import cos, magnitude, phase, sin
from facts_damping.signals import CHANNELS, NANOSECONDS, NEVER

# Columns of a frame.
VM, VA, SPEED, P, Q, FREQUENCY, ROCOF, IM, IA = range(len(CHANNELS))

# Errors of a PMU's PMU.
ERRORS = np.dtype(
    [
        *((name, "f8") for name in ("magnitude", "angle", "frequency", "rocof")),  # standard deviations of noise
        ("offset", "f8"),  # s, error of its clock
        ("drift", "f8"),  # s/s, after loss of synchronisation
        ("lost_ns", "i8"),  # when its clock loses synchronisation; NEVER: never
    ]
)
NORMALS = 6  # draws per frame: |V|, theta, |I|, phi, frequency, ROCOF

# Bad data during an interval.
STUCK, SPIKE, WRONG_SIGN, SWAPPED_PHASES, INVALID = range(5)
BAD = np.dtype([("kind", "i8"), ("from_ns", "i8"), ("until_ns", "i8"), ("probability", "f8"), ("size", "f8")])

# Bits of a frame's status, as in the STAT word of C37.118.2.
DATA_ERROR, UNSYNCHRONISED = 32768, 8192

# Steps of the 16-bit integers of C37.118.2 for angle, frequency and ROCOF; largest integers.
STEP_ANGLE, STEP_FREQUENCY, STEP_ROCOF = 1e-4, 1e-3, 1e-2  # rad, Hz, Hz/s
MAX_UNSIGNED, MAX_SIGNED = 65535.0, 32767.0


class Pmus(Struct):
    """Constant parameters of all PMUs of a run."""

    filtered: bool
    exact: bool  # no errors
    p_class: bool
    nominal: float  # Hz
    frame_rate: int
    weights: Float1  # filter weights, from the middle outwards
    per_frame: int  # samples per frame
    delay: int  # frames
    errors: Annotated[NDArray[Any], Array(ERRORS, 1)]  # ERRORS, (PMUs,)
    bad: Annotated[NDArray[Any], Array(BAD, 1)]  # BAD
    channel_mask: Bool2  # (bad, PMUs)
    normal: Float3  # (draws, PMUs, NORMALS)
    uniform: Float3  # (draws, bad, PMUs)
    voltage_step: float  # p.u., step of 16-bit integers; 0: not quantised
    current_step: float  # p.u., likewise


class PmuState(Struct):
    """State of all PMUs of a run."""

    samples: Complex3  # (PMUs, 2, twice the capacity): voltage and current, each sample twice
    taken: Int1  # (1,): number of samples taken
    stuck: Float3  # (bad, PMUs, channels)
    stuck_since: Int2  # (bad, PMUs): tick at which values became stuck; -1: not stuck


@compiled
def take_sample(state: PmuState, phasors: Complex2) -> None:
    """Store a sample of all PMUs' phasors, (PMUs, 2), p.u.; the first sample also fills the past.

    Each sample is stored twice, a capacity apart, so that the newest samples are always contiguous.
    """
    capacity = state.samples.shape[2] // 2
    place = state.taken[0] % capacity
    for s in range(phasors.shape[0]):
        for j in range(2):
            if state.taken[0] == 0:
                state.samples[s, j] = phasors[s, j]
            state.samples[s, j, place] = phasors[s, j]
            state.samples[s, j, place + capacity] = phasors[s, j]
    state.taken[0] += 1


@compiled
def _filtered(weights: Float1, samples: Complex1, middle: int) -> complex:
    """The filter centred on sample m: sum_k w_|k| x_(m + k)."""
    real, imag = weights[0] * samples[middle].real, weights[0] * samples[middle].imag
    for k in range(1, weights.size):
        both = samples[middle - k] + samples[middle + k]
        real += weights[k] * both.real
        imag += weights[k] * both.imag
    return complex(real, imag)


@compiled
def _estimate(m: Pmus, state: PmuState, s: int, frame: Float1) -> None:
    """Compute the frame of PMU s for the instant `delay` frames ago.

    Frequency f_0 + (theta_+1 - theta_-1) / (4 pi T), ROCOF (theta_+1 - 2 theta_0 + theta_-1) / (2 pi T^2), T: sample
    interval (D.4). P class: magnitudes are divided by sin(pi (f_0 + 1.625 (f - f_0)) / (2 f_0)), the filter's
    attenuation off nominal frequency (D.6).
    """
    capacity = state.samples.shape[2] // 2
    middle = (state.taken[0] - 1) % capacity + capacity - m.delay * m.per_frame
    step = 1.0 / (m.per_frame * m.frame_rate)
    voltages, currents = state.samples[s, 0], state.samples[s, 1]
    before = _filtered(m.weights, voltages, middle - 1)
    voltage = _filtered(m.weights, voltages, middle)
    after = _filtered(m.weights, voltages, middle + 1)
    current = _filtered(m.weights, currents, middle)
    forward, backward = phase(after * voltage.conjugate()), phase(voltage * before.conjugate())
    frame[FREQUENCY] = m.nominal + (forward + backward) / (4.0 * math.pi * step)
    frame[ROCOF] = (forward - backward) / (2.0 * math.pi * step * step)
    lift = 1.0
    if m.p_class:
        lift = sin(math.pi * (m.nominal + 1.625 * (frame[FREQUENCY] - m.nominal)) / (2.0 * m.nominal))
    frame[VM], frame[VA] = magnitude(voltage) / lift, phase(voltage)
    frame[IM], frame[IA] = magnitude(current) / lift, phase(current)
    frame[SPEED] = math.nan


@compiled
def _wrapped(angle: float) -> float:
    """An angle wrapped to -pi to pi."""
    return float(angle - 2.0 * math.pi * np.floor(angle / (2.0 * math.pi) + 0.5))


@compiled
def _rounded(value: float, step: float, low: float, high: float) -> float:
    """A value rounded to whole steps, within the range of the integers; NaN stays NaN."""
    return step * min(max(np.floor(value / step + 0.5), low), high) if math.isfinite(value) else value


@compiled
def _spoil(m: Pmus, tick: int, at_ns: int, s: int, error_s: float, frame: Float1) -> None:
    """Apply noise, clock error, bad data and rounding to the frame of PMU s, measured at `at_ns`."""
    errors, draw = m.errors[s], m.normal[tick % m.normal.shape[0], s]
    frame[VM] *= 1.0 + errors.magnitude * draw[0]
    frame[IM] *= 1.0 + errors.magnitude * draw[2]
    turned = -2.0 * math.pi * m.nominal * error_s
    frame[VA] = _wrapped(frame[VA] + errors.angle * draw[1] + turned)
    frame[IA] = _wrapped(frame[IA] + errors.angle * draw[3] + turned)
    if at_ns >= errors.lost_ns:
        frame[FREQUENCY] /= 1.0 + errors.drift
    frame[FREQUENCY] += errors.frequency * draw[4]
    frame[SPEED] += errors.frequency * draw[4] / m.nominal
    frame[ROCOF] += errors.rocof * draw[5]
    for b in range(m.bad.size):
        row = m.bad[b]
        if not m.channel_mask[b, s] or at_ns < row.from_ns or at_ns >= row.until_ns:
            continue
        if row.kind == SPIKE and m.uniform[tick % m.uniform.shape[0], b, s] < row.probability:
            for j in (VM, IM, SPEED, ROCOF):
                frame[j] *= 1.0 + row.size
        elif row.kind == WRONG_SIGN:
            frame[IA] = _wrapped(frame[IA] + math.pi)
        elif row.kind == SWAPPED_PHASES:
            frame[VM] = 0.0
    if m.voltage_step > 0.0:
        frame[VM] = _rounded(frame[VM], m.voltage_step, 0.0, MAX_UNSIGNED)
        frame[IM] = _rounded(frame[IM], m.current_step, 0.0, MAX_UNSIGNED)
        frame[VA] = _rounded(frame[VA], STEP_ANGLE, -MAX_SIGNED, MAX_SIGNED)
        frame[IA] = _rounded(frame[IA], STEP_ANGLE, -MAX_SIGNED, MAX_SIGNED)
        frame[FREQUENCY] = m.nominal + _rounded(frame[FREQUENCY] - m.nominal, STEP_FREQUENCY, -MAX_SIGNED, MAX_SIGNED)
        frame[ROCOF] = _rounded(frame[ROCOF], STEP_ROCOF, -MAX_SIGNED, MAX_SIGNED)


@compiled
def _copy(values: Float1, into: Float1) -> None:
    for j in range(values.size):
        into[j] = values[j]


@compiled
def _hold(m: Pmus, state: PmuState, tick: int, at_ns: int, s: int, frame: Float1) -> None:
    """Apply stuck and invalid data: stuck values repeat, invalid ones are NaN."""
    for b in range(m.bad.size):
        row = m.bad[b]
        concerned = m.channel_mask[b, s] and at_ns >= row.from_ns and at_ns < row.until_ns
        if row.kind == STUCK and not concerned:
            state.stuck_since[b, s] = -1
        elif row.kind == STUCK and state.stuck_since[b, s] < 0:
            state.stuck_since[b, s] = tick
            _copy(frame, state.stuck[b, s])
        elif row.kind == STUCK:
            _copy(state.stuck[b, s], frame)
        elif row.kind == INVALID and concerned:
            frame[:] = math.nan


@compiled
def report(
    m: Pmus, state: PmuState, tick: int, phasors: Complex2, frame: Float2, measured_ns: Int1, status: Int1
) -> None:
    """Compute the frame of a tick. `frame`, (PMUs, channels): in, exact values at its start; out, PMU values.

    `phasors`: sample of voltages and currents at the tick's start, (PMUs, 2), p.u.; `measured_ns`: time stamp of
    each PMU's entry, NEVER if there is none yet; `status`: bits as in C37.118.2.
    """
    if m.filtered:
        take_sample(state, phasors)
    reported = tick - m.delay
    at_ns = reported * NANOSECONDS // m.frame_rate
    for s in range(frame.shape[0]):
        row = frame[s]
        measured_ns[s], status[s] = at_ns, 0
        if reported < 0:
            row[:] = math.nan
            measured_ns[s] = NEVER
            continue
        if m.filtered:
            _estimate(m, state, s, row)
        if not m.exact:
            error = m.errors[s].offset
            if at_ns >= m.errors[s].lost_ns:
                error += m.errors[s].drift * (at_ns - m.errors[s].lost_ns) * 1e-9
                status[s] = UNSYNCHRONISED
            _spoil(m, reported, at_ns, s, error, row)
            measured_ns[s] += math.floor(error * 1e9 + 0.5)
            if measured_ns[s] < 0:  # like frames before the start
                row[:] = math.nan
                measured_ns[s] = NEVER
                continue
        if m.filtered or not m.exact:
            size, angle = row[VM] * row[IM], row[VA] - row[IA]  # P + j Q = V I* of the reported phasors
            row[P], row[Q] = size * cos(angle), size * sin(angle)
        if not m.exact:
            _hold(m, state, reported, at_ns, s, row)
        if not (math.isfinite(row[VM]) and math.isfinite(row[IM])):
            status[s] |= DATA_ERROR
