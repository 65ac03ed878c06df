"""Acceptance of setpoints by a device: its watchdog, and the queue of its dead time; compiled.

The watchdog is local to the device and relies on no controller, link or remote clock. It accepts a setpoint that is
finite, within the device's limit, fresh, and newer than those before it. Without one for `timeout` the device is
released: its reference goes to zero at `release_rate` and stays there until re-armed.

An accepted setpoint acts exactly `dead_time` (whole ns) later, independent of frames and integration steps. Each that
does not act yet is a row of UNDER_WAY, the oldest first. A half-full queue, as after a flood of messages, is thinned: a
setpoint replaces the one before if that is too close to its own predecessor. So no setpoint acts early, the last one
acts on time, and the queue never overflows.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from facts_damping.compiling import compiled
from facts_damping.signals import NANOSECONDS, NOT_YET, to_ns

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from facts_damping.compiling.structs import Float1, Int1
    from facts_damping.parameters.plant.watchdog import Watchdog


# Settings of a watchdog; all times in ns.
WATCHDOG = np.dtype(
    [
        ("on", "i8"),
        ("timeout_ns", "i8"),
        ("max_age_ns", "i8"),
        ("tick_ns", "i8"),  # largest lead of a time stamp over the device's time
        ("good", "i8"),  # number of fresh setpoints that re-arm; 0: never
        ("release_rate", "f8"),  # p.u./s
    ]
)

# State of a device's watchdog.
WATCH = np.dtype(
    [
        ("accepted_ns", "i8"),  # last acceptance of a setpoint, or re-arming of the device
        ("issued_ns", "i8"),  # issue time of the newest accepted setpoint
        ("measured_ns", "i8"),  # its newest measurement
        ("released", "i8"),
        ("good", "i8"),  # fresh setpoints in a row since the release
        ("refused_value", "i8"),  # number of setpoints refused: not finite or beyond the limit,
        ("refused_stamp", "i8"),  # too old or from the future,
        ("refused_order", "i8"),  # not newer than an accepted one
    ]
)

# Wall-clock time of the last acceptance by a watchdog.
LAST_ACCEPTED = np.dtype([("accepted_ns", "i8"), ("at_s", "f8")])


def settings(watchdog: Watchdog | None, frame_rate: int) -> NDArray[Any]:
    """A watchdog's row; None: off."""
    row = np.zeros((), WATCHDOG)
    if watchdog is None:
        return row
    row["on"] = 1
    row["timeout_ns"], row["max_age_ns"] = to_ns(watchdog.timeout), to_ns(watchdog.max_age)
    row["tick_ns"] = -(-NANOSECONDS // frame_rate)
    row["good"], row["release_rate"] = watchdog.good or 0, watchdog.release_rate
    return row


def initial_watch(devices: int) -> NDArray[Any]:
    """Initial state of the watchdogs of a number of devices."""
    watch = np.zeros(devices, WATCH)
    watch["accepted_ns"] = watch["issued_ns"] = watch["measured_ns"] = NOT_YET
    return watch


def initial_clock_state(devices: int) -> NDArray[Any]:
    """Initial state of `late_by_clock` for a number of devices."""
    last = np.zeros(devices, LAST_ACCEPTED)
    last["accepted_ns"] = NOT_YET
    return last


@compiled
def accepts(limits: Any, watch: Any, setpoint: Any, setpoint_max: float, now: int) -> bool:
    """Whether a setpoint may act; updates the state of the watchdog.

    `limits` is a row of WATCHDOG, `watch` one of WATCH, `setpoint` one of SETPOINT, `setpoint_max` the device's
    limit, p.u. A watchdog that is off refuses only non-finite values; others are limited.
    """
    if limits.on == 0:
        return math.isfinite(setpoint.value)
    age = now - setpoint.measured_ns
    again = setpoint.issued_ns == watch.issued_ns and setpoint.measured_ns <= watch.measured_ns
    if not abs(setpoint.value) <= setpoint_max:
        watch.refused_value += 1
    elif age > limits.max_age_ns or age < -limits.tick_ns or setpoint.issued_ns > now + limits.tick_ns:
        watch.refused_stamp += 1
    elif again or setpoint.issued_ns < watch.issued_ns:
        watch.refused_order += 1
    else:
        late = watch.accepted_ns != NOT_YET and now - watch.accepted_ns >= limits.timeout_ns
        watch.good = 0 if late else watch.good
        watch.accepted_ns, watch.issued_ns, watch.measured_ns = now, setpoint.issued_ns, setpoint.measured_ns
        if watch.released == 1:
            watch.good += 1
            if watch.good == limits.good:
                watch.released = watch.good = 0
        return bool(watch.released == 0)
    watch.good = 0
    return False


@compiled
def due_ns(limits: Any, watch: Any) -> int:
    """Time of the release if no setpoint comes; -1: none, as it is released already or has had no setpoint."""
    if limits.on == 0 or watch.released == 1 or watch.accepted_ns == NOT_YET:
        return NOT_YET
    return int(watch.accepted_ns + limits.timeout_ns)


@compiled
def release(watch: Any) -> None:
    """Release until re-armed."""
    watch.released, watch.good = 1, 0


def late_by_clock(watch: NDArray[Any], last: NDArray[Any], now_s: float, timeout_s: float) -> list[int]:
    """The devices to be released: their watchdogs have accepted nothing for a time-out of the wall clock as well.

    `last`: one row per device, updated; `now_s`: wall time, s. Called once per tick, in real time.
    """
    last["at_s"][watch["accepted_ns"] != last["accepted_ns"]] = now_s
    last["accepted_ns"] = watch["accepted_ns"]
    late = (last["accepted_ns"] != NOT_YET) & (now_s - last["at_s"] > timeout_s) & (watch["released"] == 0)
    return [int(device) for device in np.flatnonzero(late)]


def let_go(watch: NDArray[Any], device: int) -> None:
    """Release one of several devices if it has accepted a setpoint since the start or a reset."""
    if watch["accepted_ns"][device] != NOT_YET:
        watch["released"][device], watch["good"][device] = 1, 0


def rearm(watch: NDArray[Any], now: int) -> None:
    """Re-arm released devices; their time-out begins anew."""
    those = watch["released"] == 1
    watch["released"][those] = watch["good"][those] = 0
    watch["accepted_ns"][those] = now


DENSEST = 10_000  # setpoints/s, largest density of a thinned queue
CLOSE = NANOSECONDS // DENSEST  # ns

# A queued setpoint: its time of action, and its limited value, p.u.
UNDER_WAY = np.dtype([("due_ns", "i8"), ("value", "f8")])


def line(dead_times: Sequence[float]) -> tuple[NDArray[Any], Int1]:
    """Empty queues for devices with these dead times (s): (devices, room) of UNDER_WAY, and the length of each."""
    longest = max(dead_times, default=0.0)
    room = 2 * (2 + math.ceil(longest * DENSEST)) if longest > 0.0 else 0
    return np.zeros((len(dead_times), room), UNDER_WAY), np.zeros(len(dead_times), np.int64)


@compiled
def send(under_way: NDArray[Any], waiting: Int1, d: int, acts_ns: int, value: float) -> None:
    """Queue a setpoint of device d, due no earlier than those in the queue."""
    n, room = waiting[d], under_way.shape[1]
    if 2 * n >= room and (n == room or under_way[d, n - 1].due_ns - under_way[d, n - 2].due_ns < CLOSE):
        n -= 1
    under_way[d, n].due_ns, under_way[d, n].value = acts_ns, value
    waiting[d] = n + 1


@compiled
def arrive(under_way: NDArray[Any], waiting: Int1, target: Float1, end: int, now: int) -> int:
    """Apply the setpoints due by `now`; return the time of the next one, or `end`."""
    for d in range(waiting.size):
        due = 0
        while due < waiting[d] and under_way[d, due].due_ns <= now:
            target[d] = under_way[d, due].value
            due += 1
        if due > 0:
            waiting[d] -= due
            for i in range(waiting[d]):
                under_way[d, i] = under_way[d, due + i]
        if waiting[d] > 0:
            end = min(end, under_way[d, 0].due_ns)
    return end
