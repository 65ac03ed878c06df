"""PMUs against what the standard asks of their class: the tests of IEEE C37.118.1-2011 as amended in 2014, 5.5.

Both classes at 60 frames/s and 60 Hz, without noise. Signals are balanced phasors; errors are those at the time of the
frame's stamp: the total vector error, of frequency (Hz), of its rate (Hz/s).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from facts_damping.measurement.build import make_pmus
from facts_damping.measurement.pmu_model import FREQUENCY, ROCOF, VA, VM, report, take_sample
from facts_damping.parameters.measurement import Measurement
from facts_damping.signals import CHANNELS, NANOSECONDS, NEVER
from facts_damping_validation.table import Row, ValidationTable, within

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence

    from numpy.typing import NDArray

    Signal = Callable[[float], tuple[float, float]]  # of the time (s): magnitude (p.u.), angle (rad) against f_0

NOMINAL, RATE = 60.0, 60  # Hz, frames/s
TWICE_PI = 2.0 * np.pi
SHIFTS = 10  # places of a step between two frames
STEP_AT = 1.0  # s


class Limits(NamedTuple):
    """What a class has to keep at 60 frames/s, and how far its tests go (tables 3 to 11)."""

    reach: float  # Hz, of the frequency to both sides
    smallest: float  # p.u., of the magnitude
    rfe: float  # Hz/s, at rest
    modulation: float  # Hz
    modulation_fe: float  # Hz
    modulation_rfe: float  # Hz/s
    ramp_rfe: float  # Hz/s
    response: float  # s, of the phasor to a step
    frequency_response: float  # s
    rocof_response: float  # s
    overshoot: float  # of a step
    latency: float  # s


CLASSES = {
    "p_class": Limits(2.0, 0.8, 0.4, 2.0, 0.06, 2.3, 0.4, 2 / NOMINAL, 4.5 / NOMINAL, 6 / NOMINAL, 0.05, 2 / RATE),
    "m_class": Limits(5.0, 0.1, 0.1, 5.0, 0.3, 14.0, 0.2, 7 / RATE, 14 / RATE, 14 / RATE, 0.1, 7 / RATE),
}
TVE, FE = 0.01, 0.005  # fraction, Hz
DYNAMIC_TVE, RAMP_FE = 0.03, 0.01
OUT_OF_BAND_TVE, OUT_OF_BAND_FE = 0.013, 0.01


class Reported(NamedTuple):
    """Frames of one PMU: their stamps (s), phasors (p.u.), frequencies (Hz), ROCOF (Hz/s), and latency (s)."""

    time: NDArray[np.float64]
    phasor: NDArray[np.complex128]
    frequency: NDArray[np.float64]
    rocof: NDArray[np.float64]
    latency: float


def reported(name: str, signal: Signal, seconds: float) -> Reported:
    """What a PMU of a class reports of a signal."""
    ticks = round(seconds * RATE)
    m, state = make_pmus(Measurement(filter=name), ["S"], NOMINAL, RATE, ticks, 0)  # type: ignore[arg-type]
    frames, stamps = np.zeros((ticks, 1, len(CHANNELS))), np.zeros((ticks, 1), np.int64)
    status, phasors = np.zeros(1, np.int64), np.zeros((1, 2), np.complex128)
    for k in range(ticks):
        for i in range(m.per_frame):
            size, angle = signal((k + i / m.per_frame) / RATE)
            phasors[0] = size * np.exp(1j * angle)
            if i == 0:
                report(m, state, k, phasors, frames[k], stamps[k], status)
            else:
                take_sample(state, phasors)
    there = stamps[:, 0] != NEVER
    entries = frames[there, 0]
    phasor = entries[:, VM] * np.exp(1j * entries[:, VA])
    latency = float(np.flatnonzero(there)[0]) / RATE
    return Reported(stamps[there, 0] / NANOSECONDS, phasor, entries[:, FREQUENCY], entries[:, ROCOF], latency)


def _worst(
    name: str,
    signals: Iterable[Signal],
    seconds: float | Sequence[float],
    since: float = 0.3,
    true: Sequence[Signal] = (),
) -> NDArray[np.float64]:
    """Largest total vector error, frequency error (Hz) and error of ROCOF (Hz/s) of all signals after `since` (s).

    `seconds`: length of all signals, or of each; `true`: what the PMU should report of each, if that is not the signal.
    """
    listed = list(signals)
    lengths = seconds if not isinstance(seconds, float) else [seconds] * len(listed)
    errors = []
    for signal, right, length in zip(listed, true or listed, lengths, strict=True):
        frames = reported(name, signal, length)
        inside = (frames.time >= since) & (frames.time <= length)
        errors.append([float(error[inside].max()) for error in _differences(frames, right)])
    return np.asarray(np.max(errors, axis=0))


def _within(text: str, errors: NDArray[np.float64], tve: float, fe: float, rfe: float) -> list[Row]:
    """Rows of the three errors and their limits."""
    return [
        within(f"{text}, total vector error", "%", 100 * errors[0], 100 * tve),
        within(f"{text}, frequency", "Hz", errors[1], fe),
        within(f"{text}, ROCOF", "Hz/s", errors[2], rfe),
    ]


def _tone(deviation: float, magnitude: float = 1.0, angle: float = 0.0) -> Signal:
    """A steady phasor whose frequency deviates from the nominal one (Hz)."""
    return lambda t: (magnitude, angle + TWICE_PI * deviation * t)


def _modulated(f: float, kx: float, ka: float) -> Signal:
    """A phasor whose magnitude and angle (rad) are modulated at a frequency (Hz)."""
    return lambda t: (1.0 + kx * np.cos(TWICE_PI * f * t), ka * np.cos(TWICE_PI * f * t - np.pi))


def _swept(start: float, slope: float) -> Signal:
    """A phasor whose frequency begins at a deviation (Hz) and rises (Hz/s)."""
    return lambda t: (1.0, TWICE_PI * slope * (start * t + t * t / 2.0))


def _stepped(at: float, size: float, angle: float) -> Signal:
    """A phasor that steps at a time (s)."""
    return lambda t: (1.0 + size, angle) if t >= at else (1.0, 0.0)


def _disturbed(deviation: float, other: float) -> Signal:
    """A phasor with a tenth of another frequency; both as deviations (Hz)."""

    def signal(t: float) -> tuple[float, float]:
        both = np.exp(1j * TWICE_PI * deviation * t) + 0.1 * np.exp(1j * TWICE_PI * other * t)
        return float(abs(both)), float(np.angle(both))

    return signal


def _differences(measured: Reported, signal: Signal) -> tuple[NDArray[np.float64], ...]:
    """The three errors of every frame; true frequencies by differences of the angle over 2 h."""
    h = 1e-4  # s
    turns = np.array([[signal(t + d)[1] for d in (-h, 0.0, h)] for t in measured.time]) / TWICE_PI
    true = np.array([size * np.exp(1j * angle) for size, angle in map(signal, measured.time.tolist())])
    frequency = NOMINAL + (turns[:, 2] - turns[:, 0]) / (2 * h)
    rate = (turns[:, 2] - 2 * turns[:, 1] + turns[:, 0]) / h**2
    return (
        np.abs(measured.phasor - true) / np.abs(true),
        np.abs(measured.frequency - frequency),
        np.abs(measured.rocof - rate),
    )


def _steady(name: str, limits: Limits) -> list[Row]:
    """Frequencies off nominal, and magnitudes."""
    tones = map(_tone, np.linspace(-limits.reach, limits.reach, 9).tolist())
    text = f"{name}: {NOMINAL - limits.reach:g} to {NOMINAL + limits.reach:g} Hz"
    still = (_tone(0.0, magnitude, 0.3) for magnitude in (limits.smallest, 1.2))
    tve = _worst(name, still, 0.5, 0.0)[0]
    what = f"{name}: magnitude {limits.smallest:g} to 1.2 p.u., total vector error"
    return [*_within(text, _worst(name, tones, 1.0), TVE, FE, limits.rfe), within(what, "%", 100 * tve, 100 * TVE)]


def _modulation(name: str, limits: Limits) -> list[Row]:
    """A tenth of the magnitude, or a tenth of a radian, modulated up to a frequency."""
    rows, frequencies = [], np.linspace(0.1 * limits.modulation, limits.modulation, 5).tolist()
    for kind, depths in {"magnitude": (0.1, 0.0), "phase": (0.0, 0.1)}.items():
        errors = _worst(name, (_modulated(f, *depths) for f in frequencies), [0.5 + 2.0 / f for f in frequencies])
        text = f"{name}: modulation of the {kind} up to {limits.modulation:g} Hz"
        rows += _within(text, errors, DYNAMIC_TVE, limits.modulation_fe, limits.modulation_rfe)
    return rows


def _ramp(name: str, limits: Limits) -> list[Row]:
    """1 Hz/s up and down, from one end of the frequencies to the other; what its corners concern is left out."""
    errors = _worst(name, (_swept(-limits.reach, slope) for slope in (1.0, -1.0)), 2.0 * limits.reach)
    return _within(f"{name}: ramp of 1 Hz/s over {2 * limits.reach:g} Hz", errors, TVE, RAMP_FE, limits.ramp_rfe)


def _steps(name: str, limits: Limits) -> list[Row]:
    """A step of a tenth of the magnitude or of 10 degrees, at several places between two frames, put side by side."""
    rows = []
    for kind, (size, angle) in {"magnitude": (0.1, 0.0), "phase": (0.0, np.pi / 18)}.items():
        parts: list[list[NDArray[np.float64]]] = [[] for _ in range(5)]
        for shift in range(SHIFTS):
            at = STEP_AT + shift / SHIFTS / RATE
            signal = _stepped(at, size, angle)
            frames = reported(name, signal, 2.0)
            tve = _differences(frames, signal)[0]
            moved = np.abs(frames.phasor) - 1.0 if size else np.angle(frames.phasor)
            columns = frames.time - at, tve, moved / (size or angle), frames.frequency - NOMINAL, frames.rocof
            for part, column in zip(parts, columns, strict=True):
                part.append(column)
        t, tve, moved, fe, rfe = (np.concatenate(part) for part in parts)
        order = np.argsort(t)
        t, tve, moved, fe, rfe = t[order], tve[order], moved[order], np.abs(fe[order]), np.abs(rfe[order])
        text = f"{name}: step of the {kind}"
        rows += [
            within(f"{text}, response time of the phasor", "ms", 1e3 * _beyond(t, tve, TVE), 1e3 * limits.response),
            within(f"{text}, delay", "ms", 1e3 * abs(t[np.argmax(moved >= 0.5)]), 1e3 / (4 * RATE)),
            within(f"{text}, overshoot", "%", 100 * max(moved.max() - 1.0, -moved.min()), 100 * limits.overshoot),
            *(
                within(f"{text}, response time of {what}", "ms", 1e3 * _beyond(t, error, limit), 1e3 * allowed)
                for what, error, limit, allowed in (
                    ("frequency", fe, FE, limits.frequency_response),
                    ("ROCOF", rfe, limits.rfe, limits.rocof_response),
                )
            ),
        ]
    return rows


def _beyond(t: NDArray[np.float64], values: NDArray[np.float64], limit: float) -> float:
    """Time from the first to the last value above a limit, s."""
    above = np.flatnonzero(values > limit)
    return float(t[above[-1]] - t[above[0]]) if len(above) else 0.0


def _out_of_band(name: str, beside: Sequence[float]) -> list[Row]:
    """A tenth of another frequency, beyond half the frame rate from the nominal one."""
    pairs = [(deviation, f - NOMINAL) for f in beside for deviation in (-3.0, 0.0, 3.0)]  # Hz: a tenth of half the rate
    disturbed = (_disturbed(*pair) for pair in pairs)
    errors = _worst(name, disturbed, 1.5, true=[_tone(deviation) for deviation, _ in pairs])
    text = f"{name}: 10 % out-of-band interference, 10 to 30 and 90 to 120 Hz"
    return _within(text, errors, OUT_OF_BAND_TVE, OUT_OF_BAND_FE, 0.0)[:2]


def standard() -> ValidationTable:
    """All tests of both classes."""
    rows = []
    for name, limits in CLASSES.items():
        rows += [*_steady(name, limits), *_modulation(name, limits), *_ramp(name, limits), *_steps(name, limits)]
        if name == "m_class":
            rows += _out_of_band(name, [10.0, 20.0, 30.0, 90.0, 105.0, 120.0])
        latency = reported(name, _tone(0.0), 0.5).latency
        rows.append(within(f"{name}: latency", "ms", 1e3 * latency, 1e3 * limits.latency))
    source = "limits of IEEE C37.118.1-2011 with amendment 1a-2014, at 60 frames/s; filters of annex D of its successor"
    return ValidationTable("PMUs in the tests of the standard", source, "", rows)
