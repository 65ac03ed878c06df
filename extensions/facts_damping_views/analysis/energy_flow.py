"""Dissipating energy flow: which way the energy of an oscillation goes where voltage and current are measured.

With P and Q in the direction of the current, theta and V of the voltage, the deviations at the oscillation's frequency
f carry the energy

    W(t) = integral dP d(theta) + dQ d(ln V)        p.u. rad

A place that W grows out of feeds the oscillation, one that it flows into damps it. The slope of W over whole periods is

    dW/dt = Re(P* j 2 pi f theta) / 2 + Re(Q* j 2 pi f L) / 2        p.u. rad/s

with the phasors P, Q, theta and L = ln V of the oscillation. A fit of a sine and a parabola under a Hann window gives
them, window by window: it passes a band of two widths 1 / window on each side of f, leaves out missing frames, and
takes drift, and the rotation of angles at another frequency than the nominal, with the parabola.

Source: S. Maslennikov, B. Wang, E. Litvinov, Dissipating energy flow method for locating the source of sustained
oscillations, Electrical Power and Energy Systems 88, 2017. The energy is conserved by lossless lines and by loads of
constant active power whose reactive power depends on the voltage: L. Chen, Y. Min, W. Hu, An energy-based method for
location of power system oscillation source, IEEE Trans. Power Systems 28, 2013. Others are sources or sinks themselves.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from facts_damping.errors import InputError
from facts_damping.signals import CHANNELS, NANOSECONDS, NEVER

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from facts_damping.compiling.structs import Complex1, Complex2, Complex3, Float1, Float2

BAND = (0.1, 5.0)  # Hz, in which a frequency is sought
FLOOR = 15  # lines of the spectrum, whose median is what an oscillation stands out of
STANDS_OUT = 5.0  # factor of an oscillation's line on that median, at one place
SMALL = 1e-6  # p.u., amplitude of power that is round-off
CYCLES = 4  # least number of periods in a window
SPANS = 4  # number of windows, side by side, in a long record; they overlap by half
FEWEST = 3  # windows
PRESENT = 0.8  # least fraction of a window's frames at a place
BAD = 32768 | 16384  # bits of a PMU's status: data error, test mode


class Phasors(NamedTuple):
    """Voltages and currents at places over time, p.u., (frames, places); NaN: missing. `time_s`: of each of them."""

    time_s: Float2
    voltage: Complex2
    current: Complex2


class EnergyFlow(NamedTuple):
    """The energy of an oscillation: its frequency, Hz; start and end of each window, s; p.u. rad/s there.

    `flow` (windows, places): out of a machine, or of a bus into the measured branches; NaN: too few frames.
    `amplitude` (places,): of the active power, p.u. `phasor` (windows, places, 4): of P, Q, theta, ln V, in the middle
    of each window. `power` (places,): mean apparent power, p.u.
    """

    frequency: float
    windows: Float2
    flow: Float2
    amplitude: Float1
    phasor: Complex3
    power: Float1


def phasors(frames: NDArray[np.float64], measured_ns: NDArray[np.int64], status: NDArray[np.int64]) -> Phasors:
    """Phasors of a record's frames (ticks, PMUs, CHANNELS): each once, at its time of measurement; bad ones are NaN."""
    column = {name: frames[:, :, i] for i, name in enumerate(CHANNELS)}
    again = np.zeros(measured_ns.shape, bool)
    again[1:] = measured_ns[1:] == measured_ns[:-1]
    missing = (measured_ns == NEVER) | ((status & BAD) != 0) | again
    time_s = np.where(measured_ns == NEVER, np.nan, measured_ns / NANOSECONDS)
    voltage, current = (
        column[f"{name}_magnitude"] * np.exp(1j * column[f"{name}_angle"]) for name in ("voltage", "current")
    )
    return Phasors(time_s, np.where(missing, np.nan, voltage), np.where(missing, np.nan, current))


def between(measured: Phasors, since: float, until: float) -> Phasors:
    """The frames measured from `since` to `until`, s."""
    outside = ~((measured.time_s >= since) & (measured.time_s <= until))
    rows = ~outside.all(axis=1)
    beyond = outside[rows]
    return Phasors(
        measured.time_s[rows], *(np.where(beyond, np.nan, of[rows]) for of in (measured.voltage, measured.current))
    )


def strongest(measured: Phasors, rate: float) -> float:
    """Frequency of the oscillation that stands out most, Hz, from the spectra of the active powers under a Hann window.

    What counts is the line's ratio to the median of its neighbours at the place where it is largest: noise of a large
    grid hides no oscillation that is strong at one plant. `rate`: frames per second. Raises `InputError` without any.
    """
    power = (measured.voltage * measured.current.conj()).real
    whole = power[:, np.isfinite(power).mean(axis=0) >= PRESENT]
    n = len(whole)
    if n < FLOOR or not whole.size:
        raise InputError(f"{n} frames given; allowed: more, of at least one place")
    t = np.linspace(-1.0, 1.0, n)
    filled = np.column_stack([np.interp(t, t[ok], x[ok]) for x, ok in zip(whole.T, np.isfinite(whole).T, strict=True)])
    trend = np.polynomial.polynomial.polyfit(t, filled, 2)
    level = filled - np.polynomial.polynomial.polyval(t, trend).T
    lines = np.abs(np.fft.rfft(level * np.hanning(n)[:, None], axis=0)) * 4.0 / n
    frequency = np.fft.rfftfreq(n, 1.0 / rate)
    inside = np.flatnonzero((frequency >= BAND[0]) & (frequency <= min(BAND[1], 0.4 * rate)))
    floor = np.array([np.median(lines[max(0, k - FLOOR) : k + FLOOR + 1], axis=0) for k in inside])
    ratio = np.where(lines[inside] > SMALL, lines[inside] / np.maximum(floor, SMALL * 1e-3), 0.0)
    if not ratio.max(initial=0.0) > STANDS_OUT:
        raise InputError(
            f"no oscillation between {BAND[0]:g} and {BAND[1]:g} Hz stands out of the spectrum; allowed: --frequency HZ"
        )
    at, place = np.unravel_index(np.argmax(ratio), ratio.shape)
    k, size = int(inside[at]), lines[:, place]
    below, here, above = (np.log(size[min(max(i, 0), len(size) - 1)] + 1e-300) for i in (k - 1, k, k + 1))
    bend = below - 2.0 * here + above
    return float(frequency[k] + (0.5 * (below - above) / bend if bend < 0.0 else 0.0) * rate / n)


def windows(start: float, end: float, frequency: float) -> Float2:
    """Start and end of each window, s: of a quarter of the time, at least four periods, half over each other.

    Raises `InputError` if there are fewer than three.
    """
    length = max(CYCLES / frequency, (end - start) / SPANS)
    count = int((end - start - length) / (0.5 * length) + 1e-6) + 1
    if count < FEWEST:
        least = CYCLES * (FEWEST + 1) / 2 / frequency
        raise InputError(f"{end - start:.1f} s given; allowed: at least {least:.1f} s, {CYCLES * (FEWEST + 1) // 2} "
                         f"periods at {frequency:.3g} Hz")  # fmt: skip
    begin = start + 0.5 * length * np.arange(count)
    return np.column_stack([begin, begin + length])


def energy_flow(measured: Phasors, frequency: float, *, whole: bool = False) -> EnergyFlow:
    """Energy flow of an oscillation at each place, window by window, or in one window of the whole time.

    Raises `InputError` if the time is too short.
    """
    start, end = float(np.nanmin(measured.time_s)), float(np.nanmax(measured.time_s))
    spans = np.array([[start, end]]) if whole else windows(start, end, frequency)
    places = measured.voltage.shape[1]
    phasor = np.full((len(spans), places, 4), np.nan + 0j)
    usual = np.isfinite(measured.voltage * measured.current).sum(axis=0).max(initial=0) / max(end - start, 1e-9)
    for w, (begin, stop) in enumerate(spans):
        for place in range(places):
            t, v, i = (of[:, place] for of in measured)
            ok = (t >= begin) & (t <= stop) & np.isfinite(v) & np.isfinite(i) & (np.abs(v) > 0.0)
            if ok.sum() >= PRESENT * usual * (stop - begin):
                phasor[w, place] = _phasors(t[ok], v[ok], i[ok], frequency, (begin, stop))
    p, q, theta, ln_v = np.moveaxis(phasor, 2, 0)
    turn = 2j * np.pi * frequency
    flow = 0.5 * (p.conjugate() * turn * theta).real + 0.5 * (q.conjugate() * turn * ln_v).real
    amplitude = np.abs(p)
    mean = [_mean(values) for values in (amplitude, np.abs(measured.voltage * measured.current))]
    return EnergyFlow(frequency, spans, flow, mean[0], phasor, mean[1])


def _mean(values: Float2) -> Float1:
    """Mean of each column over the rows that are there; NaN: none is."""
    there = np.isfinite(values)
    total = np.where(there, values, 0.0).sum(axis=0)
    return np.asarray(np.where(there.any(axis=0), total / np.maximum(there.sum(axis=0), 1), np.nan))


def _phasors(
    t: Float1, voltage: NDArray[np.complex128], current: NDArray[np.complex128], frequency: float,
    span: tuple[float, float],
) -> Complex1:  # fmt: skip
    """Phasors of P, Q, theta and ln V over a window, in its middle, p.u. and rad."""
    omega, length = 2.0 * np.pi * frequency, span[1] - span[0]
    middle = t - 0.5 * (span[0] + span[1])
    power = voltage * current.conj()
    signals = np.column_stack([power.real, power.imag, np.unwrap(np.angle(voltage)), np.log(np.abs(voltage))])
    tau = 2.0 * middle / length
    columns = np.column_stack([np.cos(omega * middle), np.sin(omega * middle), np.ones_like(tau), tau, tau * tau])
    weight = np.cos(0.5 * np.pi * tau)[:, None]  # its square is Hann's window
    fit, *_ = np.linalg.lstsq(weight * columns, weight * signals, rcond=None)
    return np.asarray(fit[0] - 1j * fit[1])
