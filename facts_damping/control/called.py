"""Called controllers: a user's class or an FMU behind a C function; compiled.

The compiled step calls the function by its address, in a node, the loop or a sweep. Its inputs are in arrays that stay
the same at every call.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from facts_damping.compiling import call_address, compiled
from facts_damping.compiling.structs import Bool1, Int1, Struct
from facts_damping.control.sensing import Sensed, look, sensed

if TYPE_CHECKING:
    from facts_damping.control.inputs import Inputs, LatestSamples


class Calls(Struct):
    """Called controllers; the first axis is the controller."""

    address: Int1  # (controllers,), of the C function; 0: none
    failed: Bool1  # (controllers,): has failed, and is not called again
    once: Bool1  # (controllers,): called at most once a tick
    sensed: Sensed


def calls(controllers: int, signals: int, pmus: int) -> Calls:
    """Calls of `controllers` controllers, without functions."""
    made = sensed(controllers, signals, pmus)
    failed, once = np.zeros((2, controllers), np.bool_)
    return Calls(np.zeros(controllers, np.int64), failed, once, made)


@compiled
def call(given: Inputs, held: LatestSamples, of: Calls, c: int, now_ns: int) -> bool:
    """Call controller c to compute setpoints at an arrival; returns False if it has failed."""
    if of.address[c] == 0 or of.failed[c]:
        of.failed[c] = True
        return False
    look(given, held, of.sensed, c, now_ns)
    of.failed[c] = call_address(of.address[c], c, now_ns) != 0
    return not of.failed[c]
