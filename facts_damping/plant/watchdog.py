"""The watchdog of a device: which setpoints act, and when it lets go; compiled.

It stands at the device and trusts nobody: neither controllers nor links nor their clocks. A setpoint is accepted where
it is finite, within the device's limit, fresh and newer than those before it. Without one for as long as `timeout` the
device is released: its reference goes to zero at `release_rate` and stays there, until it is re-armed.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from facts_damping.compiling import compiled
from facts_damping.signals import NANOSECONDS, to_ns

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from facts_damping.parameters.plant.watchdog import Watchdog

NEVER = -1  # ns, of what has not happened yet

# What a watchdog is set to; all times in ns.
WATCHDOG = np.dtype(
    [
        ("on", "i8"),
        ("timeout_ns", "i8"),
        ("max_age_ns", "i8"),
        ("tick_ns", "i8"),  # how far ahead of the device's time a stamp may be
        ("good", "i8"),  # fresh setpoints that re-arm; 0: none does
        ("release_rate", "f8"),  # p.u./s
    ]
)

# What the watchdog of a device knows.
WATCH = np.dtype(
    [
        ("accepted_ns", "i8"),  # when a setpoint was last accepted, or the device re-armed
        ("issued_ns", "i8"),  # when the newest accepted one was issued
        ("measured_ns", "i8"),  # and the newest measurement that it rests on
        ("released", "i8"),
        ("good", "i8"),  # fresh setpoints in a row since the release
        ("refused_value", "i8"),  # setpoints refused so far: not finite or beyond the limit,
        ("refused_stamp", "i8"),  # too old or from the future,
        ("refused_order", "i8"),  # not newer than one that was accepted
    ]
)

# When a watchdog last accepted a setpoint by the wall clock.
LAST_ACCEPTED = np.dtype([("accepted_ns", "i8"), ("at_s", "f8")])


def settings(given: Watchdog | None, frame_rate: int) -> NDArray[Any]:
    """A watchdog's row; none given: off."""
    row = np.zeros((), WATCHDOG)
    if given is None:
        return row
    row["on"] = 1
    row["timeout_ns"], row["max_age_ns"] = to_ns(given.timeout), to_ns(given.max_age)
    row["tick_ns"] = -(-NANOSECONDS // frame_rate)
    row["good"], row["release_rate"] = given.good or 0, given.release_rate
    return row


def initial_watch(devices: int) -> NDArray[Any]:
    """The watchdogs of so many devices at the start."""
    watch = np.zeros(devices, WATCH)
    watch["accepted_ns"] = watch["issued_ns"] = watch["measured_ns"] = NEVER
    return watch


def initial_clock_state(devices: int) -> NDArray[Any]:
    """What `late_by_clock` knows of so many devices at the start."""
    heard = np.zeros(devices, LAST_ACCEPTED)
    heard["accepted_ns"] = NEVER
    return heard


@compiled
def accepts(own: Any, watch: Any, setpoint: Any, setpoint_max: float, now: int) -> bool:
    """Whether a setpoint may act; what the watchdog knows is brought up to date.

    `own` is a row of WATCHDOG, `watch` one of WATCH, `setpoint` one of SETPOINT, `setpoint_max`, p.u., the device's
    limit. A watchdog that is off refuses only what is not finite: others are limited.
    """
    if own.on == 0:
        return math.isfinite(setpoint.value)
    age = now - setpoint.measured_ns
    again = setpoint.issued_ns == watch.issued_ns and setpoint.measured_ns <= watch.measured_ns
    if not abs(setpoint.value) <= setpoint_max:
        watch.refused_value += 1
    elif age > own.max_age_ns or age < -own.tick_ns or setpoint.issued_ns > now + own.tick_ns:
        watch.refused_stamp += 1
    elif again or setpoint.issued_ns < watch.issued_ns:
        watch.refused_order += 1
    else:
        late = watch.accepted_ns != NEVER and now - watch.accepted_ns >= own.timeout_ns
        watch.good = 0 if late else watch.good
        watch.accepted_ns, watch.issued_ns, watch.measured_ns = now, setpoint.issued_ns, setpoint.measured_ns
        if watch.released == 1:
            watch.good += 1
            if watch.good == own.good:
                watch.released = watch.good = 0
        return bool(watch.released == 0)
    watch.good = 0
    return False


@compiled
def due_ns(own: Any, watch: Any) -> int:
    """When a device is released if no setpoint comes; -1: not at all, since it is released or has had none yet."""
    if own.on == 0 or watch.released == 1 or watch.accepted_ns == NEVER:
        return NEVER
    return int(watch.accepted_ns + own.timeout_ns)


@compiled
def release(watch: Any) -> None:
    """Let go, until re-armed."""
    watch.released, watch.good = 1, 0


def late_by_clock(watch: NDArray[Any], heard: NDArray[Any], now_s: float, timeout_s: float) -> list[int]:
    """The devices to be released: their watchdogs have accepted nothing for a time-out by the wall clock, too.

    `heard`: a row of HEARD a device, brought up to date; `now_s`: wall time, s. Called once a tick, in real time.
    """
    heard["at_s"][watch["accepted_ns"] != heard["accepted_ns"]] = now_s
    heard["accepted_ns"] = watch["accepted_ns"]
    late = (heard["accepted_ns"] != NEVER) & (now_s - heard["at_s"] > timeout_s) & (watch["released"] == 0)
    return [int(device) for device in np.flatnonzero(late)]


def let_go(watch: NDArray[Any], device: int) -> None:
    """Release one of several devices, if it has had a setpoint; as before the first, so after a reset it has not."""
    if watch["accepted_ns"][device] != NEVER:
        watch["released"][device], watch["good"][device] = 1, 0


def rearm(watch: NDArray[Any], now: int) -> None:
    """Have released devices take setpoints again; their time-out begins anew."""
    those = watch["released"] == 1
    watch["released"][those] = watch["good"][those] = 0
    watch["accepted_ns"][those] = now
