"""User programs: the age and freshness of their signals, and controllers behind a C function; compiled.

The compiled step calls a user's class or an FMU by its address, in a node, the loop or a sweep. Its inputs are in
arrays that stay the same at every call.
"""

from __future__ import annotations

import numpy as np

from facts_damping.compiling import call_address, compiled, entry_point
from facts_damping.compiling.structs import Bool1, Bool2, Float2, Int1, Int2, Struct
from facts_damping.control.inputs import UNSET, Inputs, LatestSamples, compute_signals, ingest
from facts_damping.signals import Deliveries


class Sensed(Struct):
    """Age and freshness of several receivers' signals; the first axis is the receiver."""

    taken_ns: Int2  # (receivers, PMUs): time of measurement at the previous call of `look`
    age: Float2  # (receivers, most signals), s, of a signal's newest frame
    fresh: Bool2  # (receivers, most signals): a frame of the signal is new


def sensed(receivers: int, signals: int, pmus: int) -> Sensed:
    """Allocate for `receivers` receivers, without data."""
    return Sensed(
        np.full((receivers, pmus), UNSET, np.int64),
        np.zeros((receivers, signals)),
        np.zeros((receivers, signals), np.bool_),
    )


@compiled
def _newest(receivers: Inputs, held: LatestSamples, stamps: Int2, r: int, i: int) -> int:
    """Newest time of measurement of the PMUs of signal i; `stamps`: (receivers, PMUs)."""
    newest = UNSET
    for s in range(receivers.weight.shape[2]):
        if receivers.weight[r, i, s] != 0.0:
            newest = max(newest, stamps[r, held.source[r, i, s]])
    return newest


@compiled
def look(receivers: Inputs, held: LatestSamples, of: Sensed, r: int, now_ns: int) -> None:
    """Update the age of receiver r's signals at a time, and which are new since the previous call."""
    for i in range(receivers.signals[r]):
        of.age[r, i], of.fresh[r, i] = (now_ns - _newest(receivers, held, held.entry_ns, r, i)) * 1e-9, False
        for s in range(receivers.weight.shape[2]):
            source = held.source[r, i, s]
            if receivers.weight[r, i, s] != 0.0 and held.entry_ns[r, source] != of.taken_ns[r, source]:
                of.fresh[r, i] = True
    for s in range(of.taken_ns.shape[1]):
        of.taken_ns[r, s] = held.entry_ns[r, s]


@entry_point
def sense(
    receivers: Inputs, held: LatestSamples, of: Sensed, r: int, delivered: Deliveries, count: int, end_ns: int
) -> bool:
    """Process the entries of a tick for receiver r, as a controller does; returns whether a controller would act.

    Ages are those at the last arrival at which it would act; else at the tick's end, with no signal new.
    """
    i, last = 0, UNSET
    while i < count:
        arrival = delivered[i].arrival_ns
        i = ingest(receivers, held, r, delivered, i, count)
        if compute_signals(receivers, held, r) >= 0:
            last = arrival
    if last != UNSET:
        look(receivers, held, of, r, last)
    elif held.newest_ns[r] != UNSET:
        for j in range(receivers.signals[r]):
            of.age[r, j], of.fresh[r, j] = (end_ns - _newest(receivers, held, of.taken_ns, r, j)) * 1e-9, False
    return last != UNSET


class Calls(Struct):
    """Called controllers; the first axis is the controller."""

    address: Int1  # (controllers,), of the C function; 0: none
    failed: Bool1  # (controllers,): has failed, and is not called again
    once: Bool1  # (controllers,): called at most once a tick
    sensed: Sensed


def calls(controllers: int, signals: int, pmus: int) -> Calls:
    """Calls of `controllers` controllers, without functions."""
    state = sensed(controllers, signals, pmus)
    failed, once = np.zeros((2, controllers), np.bool_)
    return Calls(np.zeros(controllers, np.int64), failed, once, state)


@compiled
def call(receivers: Inputs, held: LatestSamples, of: Calls, c: int, now_ns: int) -> bool:
    """Call controller c to compute setpoints at an arrival; returns False if it has failed."""
    if of.address[c] == 0 or of.failed[c]:
        of.failed[c] = True
        return False
    look(receivers, held, of.sensed, c, now_ns)
    of.failed[c] = call_address(of.address[c], c, now_ns) != 0
    return not of.failed[c]
