"""Forms signals of controllers and identifiers from the entries that a link delivers; compiled."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from facts_damping.compiling import compiled
from facts_damping.compiling.structs import Bool2, Float1, Float2, Float3, Int1, Int2, Struct
from facts_damping.control.lead_lag import section
from facts_damping.signals import CHANNELS

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray

    from facts_damping.parameters.plant.pmus import Signal

UNSET = -1
IMPLAUSIBLE = 1e6  # p.u. or rad: a quantity this large or larger counts as not available
TURN = 2.0 * math.pi  # rad
ANGLES = [list(CHANNELS).index(name) for name in ("voltage_angle", "current_angle")]


class Inputs(Struct):
    """Signals of several receivers; the first axis is the receiver."""

    signals: Int1  # (receivers,): number of signals
    channel: Int2  # (receivers, most signals)
    weight: Float3  # (receivers, most signals, PMUs)
    offset: Float2  # (receivers, most signals): subtracted from the weighted sum
    angle: Bool2  # (receivers, most signals): the signal is an angle, wrapped to half a turn
    uses: Bool2  # (receivers, PMUs): a signal uses the PMU
    deviation: Bool2  # (receivers, most signals)
    washout: Float2  # (receivers, most signals), s; 0: none


class LatestSamples(Struct):
    """Newest data of each receiver; the first axis is the receiver."""

    entry: Float3  # (receivers, PMUs, channels): newest entry of each PMU; NaN: none yet
    entry_ns: Int2  # (receivers, PMUs): its time of measurement
    newest_ns: Int1  # (receivers,): newest time of measurement of its PMUs; UNSET: none
    baseline: Float2  # (receivers, most signals): first value of each signal
    washed: Float3  # (receivers, most signals, 2): input and output of each washout
    signal: Float2  # (receivers, most signals): newest signals


def inputs(
    given: Sequence[Sequence[str]], signals: Mapping[str, Signal], pmus: Sequence[str], nominal: float = 60.0
) -> tuple[Inputs, LatestSamples]:
    """Build receivers of signals given by name, without data; `nominal`: frequency, Hz."""
    n, maximum = len(given), max([len(names) for names in given], default=0)
    made = Inputs(
        signals=np.array([len(names) for names in given], np.int64),
        channel=np.zeros((n, maximum), np.int64),
        weight=np.zeros((n, maximum, len(pmus))),
        offset=np.zeros((n, maximum)),
        angle=np.zeros((n, maximum), np.bool_),
        uses=np.zeros((n, len(pmus)), np.bool_),
        deviation=np.zeros((n, maximum), np.bool_),
        washout=np.zeros((n, maximum)),
    )
    for r, names in enumerate(given):
        for i, name in enumerate(names):
            signal = signals[name]
            made.channel[r, i] = list(CHANNELS).index(signal.channel)
            made.deviation[r, i] = signal.deviation
            made.washout[r, i] = signal.washout
            made.angle[r, i] = made.channel[r, i] in ANGLES
            made.weight[r, i] = pmu_weights(signal, pmus, nominal)
            if signal.channel == "frequency":
                made.offset[r, i] = nominal * made.weight[r, i].sum()
        made.uses[r] = (made.weight[r] != 0.0).any(axis=0)
    held = LatestSamples(
        entry=np.full((n, len(pmus), len(CHANNELS)), np.nan),
        entry_ns=np.full((n, len(pmus)), UNSET, np.int64),
        newest_ns=np.full(n, UNSET, np.int64),
        baseline=np.full((n, maximum), np.nan),
        washed=np.zeros((n, maximum, 2)),
        signal=np.full((n, maximum), np.nan),
    )
    return made, held


def pmu_weights(signal: Signal, pmus: Sequence[str], nominal: float) -> Float1:
    """Weights of the PMUs in a signal, (PMUs,); frequencies are converted from Hz to p.u. of `nominal`."""
    weights = np.zeros(len(pmus))
    for pmu, weight in signal.weights.items():
        weights[pmus.index(pmu)] = weight
    return weights / nominal if signal.channel in ("frequency", "rocof") else weights


@compiled
def ingest(held: LatestSamples, r: int, delivered: NDArray[Any], first: int, count: int) -> int:
    """Store all entries of the arrival of entry `first` that are newer; returns the index after the last."""
    i, arrival = first, delivered[first].arrival_ns
    while i < count and delivered[i].arrival_ns == arrival:
        entry = delivered[i]
        if entry.measured_ns > held.entry_ns[r, entry.pmu]:
            held.entry_ns[r, entry.pmu] = entry.measured_ns
            for j in range(held.entry.shape[2]):
                value = entry.values[j]
                held.entry[r, entry.pmu, j] = value if abs(value) < IMPLAUSIBLE else math.nan
        i += 1
    return i


@compiled
def compute_signals(given: Inputs, held: LatestSamples, r: int) -> int:
    """Form the signals if one of their PMUs has a newer frame than all before, and all signals are available.

    Returns the time since the frame before, ns; 0 for the first frame; -1 if nothing is new.
    """
    before = newest = held.newest_ns[r]
    for s in range(held.entry_ns.shape[1]):
        if given.uses[r, s]:
            newest = max(newest, held.entry_ns[r, s])
    if newest <= before or not _sum(given, held, r):
        return -1
    held.newest_ns[r] = newest
    since = 0 if before == UNSET else newest - before
    _wash(given, held, r, since * 1e-9)
    return since


@compiled
def _wash(given: Inputs, held: LatestSamples, r: int, dt: float) -> None:
    """Step the washouts by `dt`, s; `dt` = 0 at the first frame: they start at rest."""
    for i in range(given.signals[r]):
        tau, value = given.washout[r, i], held.signal[r, i]
        if tau > 0.0 and dt <= 0.0:
            held.washed[r, i, 0], held.washed[r, i, 1], held.signal[r, i] = value, 0.0, 0.0
        elif tau > 0.0:
            held.signal[r, i] = section(tau, 0.0, tau, dt, held.washed[r, i], 0, value)


@compiled
def _sum(given: Inputs, held: LatestSamples, r: int) -> bool:
    """Compute the weighted sums of the newest entries; returns whether all are available."""
    complete = True
    for i in range(given.signals[r]):
        total = 0.0
        for s in range(given.weight.shape[2]):
            if given.weight[r, i, s] != 0.0:
                total += given.weight[r, i, s] * held.entry[r, s, given.channel[r, i]]
        total -= given.offset[r, i]
        if given.angle[r, i]:
            total -= TURN * math.floor(total / TURN + 0.5)
        if given.deviation[r, i]:
            if math.isnan(held.baseline[r, i]) and math.isfinite(total):
                held.baseline[r, i] = total
            total -= held.baseline[r, i]
        held.signal[r, i] = total
        complete = complete and math.isfinite(total)
    return complete
