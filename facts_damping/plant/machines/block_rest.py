"""The steady state of block-diagram controls: initial states, references, and limits that exclude them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from facts_damping.errors import InputError
from facts_damping.machine_controls.block_models import MODELS, active_blocks
from facts_damping.machine_controls.blocks import TABLES
from facts_damping.numerics.matrices import least_squares
from facts_damping.plant.machines import blocks as kernel
from facts_damping.plant.machines.block_controls import MACHINE, Control, Signals, owner

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from numpy.typing import NDArray

    from facts_damping.compiling.structs import Float1

TOLERANCE = 1e-10  # p.u., 1/s, residual of the steady state
STILL = 0.1  # of the greatest residual, below which a signal is not named
FIRM = 1e-6  # weight of a state that has a start of its own
STEPS = 50  # largest number of iterations from one starting point
STARTS = (1.0, 3.0, 10.0)  # starting points of all states, times the output: of a rectifier they are far above it


class LimitViolation(NamedTuple):
    """A limit that excludes the initial state: the signal, its value, the limits; the parameter and a valid value."""

    control: Any
    name: str
    value: float  # p.u.
    low: float
    high: float
    field: str | None  # None: the limit is no parameter
    wanted: float  # p.u., valid value of the parameter

    @property
    def table(self) -> str:
        """The table of the system with the control; of the models without blocks only HYGOV has such limits."""
        return TABLES[MODELS[self.control.model].role] if self.control.model in MODELS else "governors"

    def __str__(self) -> str:
        """Text for an error message."""
        where = f"{self.table}: {owner(self.control)}: {self.control.model}: {self.name}"
        limits = f"{self.low:.4g} to {self.high:.4g}{f' ({self.field})' if self.field else ''}"
        return f"{where} is {self.value:.4g} p.u. at the start; allowed by its limits: {limits}"


class Rest(NamedTuple):
    """Steady state of a control: its states, references, all its signals, and the limits that exclude it."""

    states: NDArray[np.float64]
    references: list[float]
    signals: Float1  # those that are sensed, then those of its rows
    violations: list[LimitViolation]


def self_excited(block_control: Control, data: Any, field_voltage: float) -> Control:
    """The control with a KE of 0 set so that VR is VRMAX / 10 at the start, as in PSS/E: VRMAX / (10 Efd) - SE(Efd)."""
    rows = block_control.rows.copy()
    for row in rows:
        if row["kind"] == kernel.FIELD and row["p"][0] == 0.0:
            beyond = max(0.0, field_voltage - row["p"][2])
            row["p"][0] = (data.VRMAX / 10.0 - row["p"][3] * beyond * beyond) / field_voltage
    return block_control._replace(rows=rows)


def at_rest(
    block_control: Control,
    models: Sequence[Any],
    sensed: Mapping[str, float],
    gives: Mapping[str, float],
    references: Sequence[str],
    signals: Signals = MACHINE,
) -> Rest:
    """States and values of the signals `references` for which outputs are as `gives` at steady state.

    It is solved by Newton's method without limits, but for stops, which rest at 0, and limiters, if there is one with
    them; what is not determined is as near to the start of the search as can be. Raises `InputError` if there is none.
    """
    names = [*signals.known, *signals.measured]
    s, at = np.zeros(len(names) + len(block_control.rows)), len(names)
    for name, value in {"one": 1.0, **sensed}.items():
        s[names.index(name)] = value
    free = block_control.rows.copy()
    stops = free["kind"] == kernel.STOP
    free["p"][free["kind"] == kernel.SERVO, 1:3] = -kernel.NO_LIMIT, kernel.NO_LIMIT
    free["hold"] = kernel.NONE
    free["p"][stops, 0] = 0.0
    outputs = [at + block_control.gives.index(name) for name in gives]
    places, n = [names.index(name) for name in references], len(block_control.states)

    def moves(z: Float1) -> Float1:
        x, dx = np.ascontiguousarray(z[:n]), np.zeros(n)
        s[places] = z[n:]
        kernel.moved(free, at, x, s, dx)
        return np.append(dx, s[outputs] - list(gives.values()))

    usual = max((abs(value) for value in gives.values()), default=1.0) if signals is MACHINE else 1.0
    active = {block.name: block for data in models for block in active_blocks(data)}
    starts = [active[name].start if name in active else None for name in block_control.states] + [None] * len(places)
    weights = np.array([1.0 if start is None else FIRM for start in starts])
    left = np.zeros(0)
    for freed in ((free["kind"] != kernel.LIMITER) & ~stops, ~stops):
        free["low"][freed], free["high"][freed] = -kernel.NO_LIMIT, kernel.NO_LIMIT
        free["low_of"][freed] = free["high_of"][freed] = kernel.ONE
        for scale in STARTS:
            begin = np.array([scale * usual if start is None else start for start in starts])
            begin[free["state"][stops]] = 0.0
            z = _zero(moves, begin, weights, once_more=signals is not MACHINE)
            left = np.abs(moves(z))
            if left.max(initial=0.0) < TOLERANCE:
                return Rest(z[:n], z[n:].tolist(), s, _violations(block_control, models, s, at))
    names = [*block_control.states, *gives]
    restless = dict.fromkeys(name for name, rest in zip(names, left, strict=True) if not rest < STILL * left.max())
    text = f"no steady state of {', '.join(restless)} at the start; allowed: flags and a power flow with one"
    raise InputError(f"{models[0].model} of {owner(models[0])}: {text}")


def _zero(f: Callable[[Float1], Float1], z: Float1, weights: Float1, *, once_more: bool) -> Float1:
    """Zero of a function by Newton's method from a point on, or where it ends; `once_more`: one step beyond that.

    Of steps that do equally well, it takes that of the least length over the weights.
    """
    for _ in range(STEPS):
        left = f(z)
        if np.abs(left).max(initial=0.0) < TOLERANCE:
            if not once_more:
                break
            once_more = False
        slopes = [(f(z + step) - f(z - step)) / (2.0 * step.max()) for step in 1e-6 * np.eye(len(z))]
        z = z - weights * least_squares(np.array(slopes).T * weights, left)
    return z


def _violations(block_control: Control, models: Sequence[Any], s: Float1, at: int) -> list[LimitViolation]:
    """Limits violated by the signals of a control whose steady state was found without limits."""
    wrong = list[LimitViolation]()
    of_signal = {block.name: (data, block) for data in models for block in active_blocks(data)}
    for row, name, value in zip(block_control.rows, block_control.gives, s[at:], strict=True):
        low, high = row["low"] * s[row["low_of"]], row["high"] * s[row["high_of"]]
        if low - 1e-9 <= value <= high + 1e-9:
            continue
        side, of = ("low", row["low_of"]) if value < low else ("high", row["high_of"])
        data, block = of_signal[name]
        limit = getattr(block, side)
        field = limit if isinstance(limit, str) and s[of] != 0.0 else None
        wanted = float(value / s[of]) if s[of] != 0.0 else float(value)
        wrong.append(LimitViolation(data, name, float(value), float(low), float(high), field, wanted))
    return wrong
