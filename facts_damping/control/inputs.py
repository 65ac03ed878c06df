"""Forms signals of controllers and identifiers from the entries that a link delivers; compiled.

A PMU of a signal may have backups. While its data are good they count: they are available and fresh, they change, and
their status is in order (`_good`). When they are not, the first that is good of the PMU and its backups takes over, and
stays until its own data are bad. This is done at both ends of a difference, so the best pair is selected.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from facts_damping.compiling import compiled
from facts_damping.compiling.structs import Bool2, Float1, Float2, Float3, Int1, Int2, Int3, Int4, Struct
from facts_damping.control.lead_lag import section
from facts_damping.monitor_table import BAD
from facts_damping.signals import CHANNELS

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray

    from facts_damping.parameters.plant.pmus import Signal

UNSET = -1
IMPLAUSIBLE = 1e6  # p.u. or rad: a quantity this large or larger counts as not available
TURN = 2.0 * math.pi  # rad
ANGLES = [list(CHANNELS).index(name) for name in ("voltage_angle", "current_angle")]
FREQUENCY = list(CHANNELS).index("frequency")
STILL_HZ = 5e-4  # Hz: this close to the nominal frequency the values of a PMU may repeat
AGED_NS = 100_000_000  # a PMU with backups whose newest frame is this much older than that of another is bad: 6 frames
BEGIN_NS = 1_000_000_000  # for so long PMUs that have not been available yet are waited for, as their filters fill
REPEATED_NS = 100_000_000  # one that has repeated its values for longer is bad


class Inputs(Struct):
    """Signals of several receivers; the first axis is the receiver."""

    signals: Int1  # (receivers,): number of signals
    channel: Int2  # (receivers, most signals)
    weight: Float3  # (receivers, most signals, PMUs)
    offset: Float2  # (receivers, most signals): subtracted from the weighted sum
    angle: Bool2  # (receivers, most signals): the signal is an angle, wrapped to half a turn
    backup: Int4  # (receivers, most signals, PMUs, most backups): PMUs that may take the place of one; UNSET: none
    deviation: Bool2  # (receivers, most signals)
    washout: Float2  # (receivers, most signals), s; 0: none
    nominal: float  # Hz


class LatestSamples(Struct):
    """Newest data of each receiver; the first axis is the receiver."""

    entry: Float3  # (receivers, PMUs, channels): newest entry of each PMU; NaN: none yet
    entry_ns: Int2  # (receivers, PMUs): its time of measurement
    same_ns: Int2  # (receivers, PMUs): first measurement of the values that repeat now
    status: Int2  # (receivers, PMUs): bits of PmuFrame.msg
    source: Int3  # (receivers, most signals, PMUs): the PMU itself, or the backup that has taken its place
    uses: Bool2  # (receivers, PMUs): a signal uses the PMU's data
    begun_ns: Int1  # (receivers,): time of measurement of the first entry; UNSET: none yet
    newest_ns: Int1  # (receivers,): newest time of measurement of its PMUs; UNSET: none
    baseline: Float2  # (receivers, most signals): first value of each signal
    washed: Float3  # (receivers, most signals, 2): input and output of each washout
    signal: Float2  # (receivers, most signals): newest signals


class Wiring(NamedTuple):
    """What controllers, identifiers and supervisors of a run are connected to."""

    signals: Mapping[str, Signal]
    pmus: Sequence[str]
    limits: Mapping[str, tuple[float, float]]  # magnitude, p.u., and rate, p.u./s, of all installed devices in order
    frame_rate: int
    nominal: float = 60.0  # frequency, Hz


def inputs(
    wanted: Sequence[Sequence[str]], signals: Mapping[str, Signal], pmus: Sequence[str], nominal: float = 60.0
) -> tuple[Inputs, LatestSamples]:
    """Build receivers of signals given by name, without data; `nominal`: frequency, Hz."""
    n, maximum = len(wanted), max([len(names) for names in wanted], default=0)
    backups = [len(others) for names in wanted for name in names for others in signals[name].backups.values()]
    receivers = Inputs(
        signals=np.array([len(names) for names in wanted], np.int64),
        channel=np.zeros((n, maximum), np.int64),
        weight=np.zeros((n, maximum, len(pmus))),
        offset=np.zeros((n, maximum)),
        angle=np.zeros((n, maximum), np.bool_),
        backup=np.full((n, maximum, len(pmus), max(backups, default=0)), UNSET, np.int64),
        deviation=np.zeros((n, maximum), np.bool_),
        washout=np.zeros((n, maximum)),
        nominal=nominal,
    )
    for r, names in enumerate(wanted):
        for i, name in enumerate(names):
            signal = signals[name]
            receivers.channel[r, i] = list(CHANNELS).index(signal.channel)
            receivers.deviation[r, i] = signal.deviation
            receivers.washout[r, i] = signal.washout
            receivers.angle[r, i] = receivers.channel[r, i] in ANGLES
            receivers.weight[r, i] = pmu_weights(signal, pmus, nominal)
            if signal.channel == "frequency":
                receivers.offset[r, i] = nominal * receivers.weight[r, i].sum()
            for pmu, others in signal.backups.items():
                receivers.backup[r, i, pmus.index(pmu), : len(others)] = [pmus.index(other) for other in others]
    held = LatestSamples(
        entry=np.full((n, len(pmus), len(CHANNELS)), np.nan),
        entry_ns=np.full((n, len(pmus)), UNSET, np.int64),
        same_ns=np.full((n, len(pmus)), UNSET, np.int64),
        status=np.zeros((n, len(pmus)), np.int64),
        source=np.tile(np.arange(len(pmus)), (n, maximum, 1)),
        uses=(receivers.weight != 0.0).any(axis=1),
        begun_ns=np.full(n, UNSET, np.int64),
        newest_ns=np.full(n, UNSET, np.int64),
        baseline=np.full((n, maximum), np.nan),
        washed=np.zeros((n, maximum, 2)),
        signal=np.full((n, maximum), np.nan),
    )
    return receivers, held


def pmu_weights(signal: Signal, pmus: Sequence[str], nominal: float) -> Float1:
    """Weights of the PMUs in a signal, (PMUs,); frequencies are converted from Hz to p.u. of `nominal`."""
    weights = np.zeros(len(pmus))
    for pmu, weight in signal.weights.items():
        weights[pmus.index(pmu)] = weight
    return weights / nominal if signal.channel in ("frequency", "rocof") else weights


class Candidates(NamedTuple):
    """Each PMU of a receiver's signals, one signal after the other, and who may take its place."""

    signal: Int1
    pmu: Int1
    candidates: Int2  # (rows, 1 + most backups): the PMU itself, its backups; UNSET: none


def candidates(receivers: Inputs, r: int) -> Candidates:
    """PMUs of receiver r's signals and their backups."""
    signal, pmu = np.nonzero(receivers.weight[r])
    return Candidates(signal, pmu, np.column_stack([pmu, receivers.backup[r, signal, pmu]]))


def sources(of: Candidates, held: LatestSamples, r: int) -> Int1:
    """Whose data count for each row of `of`: 0: those of the PMU itself, 1: of its first backup, and so on."""
    used_pmu = held.source[r, of.signal, of.pmu]
    return np.asarray((of.candidates == used_pmu[:, None]).argmax(axis=1))


@compiled
def clear(receivers: Inputs, held: LatestSamples, r: int) -> None:
    """Forget all data of receiver r; each PMU of its signals is its own source."""
    held.entry[r], held.entry_ns[r], held.begun_ns[r], held.newest_ns[r] = math.nan, UNSET, UNSET, UNSET
    held.same_ns[r], held.status[r], held.uses[r] = UNSET, 0, False
    held.baseline[r], held.washed[r], held.signal[r] = math.nan, 0.0, math.nan
    for i in range(receivers.signals[r]):
        for s in range(receivers.weight.shape[2]):
            held.source[r, i, s] = s
            if receivers.weight[r, i, s] != 0.0:
                held.uses[r, s] = True


@compiled
def ingest(receivers: Inputs, held: LatestSamples, r: int, delivered: NDArray[Any], first: int, count: int) -> int:
    """Store all entries of the arrival of entry `first` that are newer; returns the index after the last."""
    i, arrival = first, delivered[first].arrival_ns
    while i < count and delivered[i].arrival_ns == arrival:
        if delivered[i].measured_ns > held.entry_ns[r, delivered[i].pmu]:
            _store(receivers, held, r, delivered[i])
        i += 1
    return i


@compiled
def _store(receivers: Inputs, held: LatestSamples, r: int, entry: Any) -> None:
    """Store a PMU's newer entry, and since when it repeats its values."""
    before_ns, latest = held.entry_ns[r, entry.pmu], held.entry[r, entry.pmu]
    same = before_ns != UNSET and abs(entry.values[FREQUENCY] - receivers.nominal) > STILL_HZ
    for j in range(latest.size):
        value = entry.values[j] if abs(entry.values[j]) < IMPLAUSIBLE else math.nan
        same = same and (value == latest[j] or (math.isnan(value) and math.isnan(latest[j])))
        latest[j] = value
    if held.begun_ns[r] == UNSET:
        held.begun_ns[r] = entry.measured_ns
    if not same:
        held.same_ns[r, entry.pmu] = entry.measured_ns
    held.entry_ns[r, entry.pmu], held.status[r, entry.pmu] = entry.measured_ns, entry.status


@compiled
def _select(receivers: Inputs, held: LatestSamples, r: int) -> None:
    """Select the source of each PMU of the signals: itself or a backup."""
    newest = UNSET
    for s in range(held.entry_ns.shape[1]):
        newest = max(newest, held.entry_ns[r, s])
    if held.newest_ns[r] == UNSET and newest - held.begun_ns[r] <= BEGIN_NS:
        return
    held.uses[r] = False
    for i in range(receivers.signals[r]):
        channel = receivers.channel[r, i]
        for s in range(receivers.weight.shape[2]):
            if receivers.weight[r, i, s] == 0.0:
                continue
            if not _good(held, r, held.source[r, i, s], channel, newest):
                for k in range(-1, receivers.backup.shape[3]):
                    other = s if k < 0 else receivers.backup[r, i, s, k]
                    if other != UNSET and _good(held, r, other, channel, newest):
                        held.source[r, i, s] = other
                        break
            held.uses[r, held.source[r, i, s]] = True


@compiled
def _good(held: LatestSamples, r: int, s: int, channel: int, newest: int) -> bool:
    """Whether the data of PMU s are good; `newest`: time of the newest entry of all PMUs, ns."""
    fresh = held.entry_ns[r, s] != UNSET and newest - held.entry_ns[r, s] <= AGED_NS
    changes = held.entry_ns[r, s] - held.same_ns[r, s] <= REPEATED_NS
    return fresh and changes and not held.status[r, s] & BAD and math.isfinite(held.entry[r, s, channel])


@compiled
def compute_signals(receivers: Inputs, held: LatestSamples, r: int) -> int:
    """Form the signals if one of their PMUs has a newer frame than all before, and all signals are available.

    Returns the time since the frame before, ns; 0 for the first frame; -1 if nothing is new.
    """
    before = newest = held.newest_ns[r]
    if receivers.backup.shape[3] > 0:
        _select(receivers, held, r)
    for s in range(held.entry_ns.shape[1]):
        if held.uses[r, s]:
            newest = max(newest, held.entry_ns[r, s])
    if newest <= before or not _sum(receivers, held, r):
        return -1
    held.newest_ns[r] = newest
    since = 0 if before == UNSET else newest - before
    _wash(receivers, held, r, since * 1e-9)
    return since


@compiled
def _wash(receivers: Inputs, held: LatestSamples, r: int, dt: float) -> None:
    """Step the washouts by `dt`, s; `dt` = 0 at the first frame: they start at rest."""
    for i in range(receivers.signals[r]):
        tau, value = receivers.washout[r, i], held.signal[r, i]
        if tau > 0.0 and dt <= 0.0:
            held.washed[r, i, 0], held.washed[r, i, 1], held.signal[r, i] = value, 0.0, 0.0
        elif tau > 0.0:
            held.signal[r, i] = section(tau, 0.0, tau, dt, held.washed[r, i], 0, value)


@compiled
def _sum(receivers: Inputs, held: LatestSamples, r: int) -> bool:
    """Compute the weighted sums of the newest entries; returns whether all are available."""
    complete = True
    for i in range(receivers.signals[r]):
        total = 0.0
        for s in range(receivers.weight.shape[2]):
            if receivers.weight[r, i, s] != 0.0:
                total += receivers.weight[r, i, s] * held.entry[r, held.source[r, i, s], receivers.channel[r, i]]
        total -= receivers.offset[r, i]
        if receivers.angle[r, i]:
            total -= TURN * math.floor(total / TURN + 0.5)
        if receivers.deviation[r, i]:
            if math.isnan(held.baseline[r, i]) and math.isfinite(total):
                held.baseline[r, i] = total
            total -= held.baseline[r, i]
        held.signal[r, i] = total
        complete = complete and math.isfinite(total)
    return complete
