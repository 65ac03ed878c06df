"""Controllers that are called: a user's class, or an FMU, behind a C function; compiled.

The compiled step calls the function by its address, wherever it runs: in a node, in the loop, in a sweep. What the
function is given lies in arrays that are the same at every call; so a call takes some millionths of a second more than
what it calls.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from facts_damping.compiling import inner
from facts_damping.control.inputs import UNSET

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from facts_damping.control.inputs import Held, Inputs

ARGUMENTS = 2  # controller, time of arrival (ns); all are whole numbers of 64 bits, and so is what comes back


class Calls(NamedTuple):
    """What called controllers are given beside their signals; the first axis is the controller."""

    address: NDArray[np.int64]  # (controllers,), of the C function; 0: none
    failed: NDArray[np.bool_]  # (controllers,): it has failed, and is not called again
    taken_ns: NDArray[np.int64]  # (controllers, stations): time of measurement of what it was called with last
    age: NDArray[np.float64]  # (controllers, most signals), s, of the newest frame that a signal is made of
    fresh: NDArray[np.bool_]  # (controllers, most signals): a frame that it is made of is new


def calls(controllers: int, signals: int, stations: int) -> Calls:
    """Those of so many controllers, with no functions yet."""
    return Calls(
        np.zeros(controllers, np.int64),
        np.zeros(controllers, np.bool_),
        np.full((controllers, stations), UNSET, np.int64),
        np.zeros((controllers, signals)),
        np.zeros((controllers, signals), np.bool_),
    )


def _at(_typing: Any, _address: Any, _controller: Any, _now_ns: Any) -> Any:
    """Call the C function at an address."""
    whole = ir.IntType(64)
    function = ir.FunctionType(whole, [whole] * ARGUMENTS)

    def generate(_context: Any, builder: Any, _signature: Any, values: Any) -> Any:
        address, *others = values
        return builder.call(builder.inttoptr(address, function.as_pointer()), others)

    return types.int64(types.int64, types.int64, types.int64), generate


call_at: Any = intrinsic(_at)


@inner
def call(given: Inputs, held: Held, of: Calls, c: int, now_ns: int) -> bool:
    """Have controller c set its setpoints for what it holds at an arrival; False: it has failed."""
    if of.address[c] == 0 or of.failed[c]:
        of.failed[c] = True
        return False
    for i in range(given.signals[c]):
        newest, fresh = UNSET, False
        for s in range(given.weight.shape[2]):
            if given.weight[c, i, s] != 0.0:
                newest = max(newest, held.entry_ns[c, s])
                fresh = fresh or held.entry_ns[c, s] != of.taken_ns[c, s]
        of.age[c, i], of.fresh[c, i] = (now_ns - newest) * 1e-9, fresh
    for s in range(of.taken_ns.shape[1]):
        of.taken_ns[c, s] = held.entry_ns[c, s]
    of.failed[c] = call_at(of.address[c], c, now_ns) != 0
    return not of.failed[c]
