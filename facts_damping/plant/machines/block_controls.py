"""Block-diagram controls built from their parameters: rows in order of evaluation, and initial states."""

from __future__ import annotations

import math
import re
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from facts_damping.elementary import rect
from facts_damping.errors import InputError
from facts_damping.machine_controls.block_models import INPUTS, MODELS
from facts_damping.machine_controls.blocks import SHORTEST, TABLES, Block
from facts_damping.numerics.matrices import least_squares
from facts_damping.plant.machines import blocks as kernel

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from numpy.typing import NDArray

    from facts_damping.compiling.structs import Float1

GIVES = {"governor": "Pm", "stabiliser": "Vs", "exciter": "Efd"}
# Kinds with direct feedthrough.
FEEDTHROUGH = {"sum", "lead_lag", "washout", "rate", "second_order", "product", "source", "rectifier", "curve"}
FILTER_ORDER = 20  # of a ramp-tracking filter, of which the library allows 8
ORDER = 10  # of a dead time's approximation, right to 1e-4 at a lag of 10 rad; of a short one less: a state for 4 ms
TOLERANCE = 1e-10  # p.u., 1/s, residual of the steady state
STEPS = 50  # largest number of iterations from one starting point
STARTS = (1.0, 3.0, 10.0)  # starting points of all states, times the output: of a rectifier they are far above it


class Control(NamedTuple):
    """A control as rows of BLOCK, the signals of the rows in their order, and the names of its states."""

    rows: NDArray[Any]
    gives: list[str]
    states: list[str]


def control(data: Any) -> Control:
    """The rows of a control with its parameters (`parameters.plant.machines`); state indices count from 0.

    Raises `InputError` if blocks form an algebraic loop, or a gain is infinite.
    """
    try:
        return _control(data)
    except ZeroDivisionError as error:
        raise InputError(f"{data.model} of {data.machine}: an infinite gain given; allowed: finite gains") from error


def _control(data: Any) -> Control:
    blocks = _in_order([_plain(block, data) for block in _spread(MODELS[data.model].blocks, data)], data)
    signals = {name: i for i, name in enumerate([*kernel.SENSED, *(block.name for block in blocks)])}
    signals |= {"input": signals[_sensed(data, "IC", 1)], "input_2": signals[_sensed(data, "IC2", 0)]}
    rows, states = np.zeros(len(blocks), kernel.BLOCK), list[str]()
    for row, block in zip(rows, blocks, strict=True):
        row["kind"], row["state"] = kernel.KINDS.index(block.kind), kernel.STATELESS
        for i, (name, weight) in enumerate(_inputs(block.inputs, data)):
            row["source"][i], row["weight"][i] = signals[name], weight
            row["inputs"] = i + 1
        row["p"][: len(block.p)] = block.p
        row["low"] = -kernel.NO_LIMIT if block.low is None else block.low
        row["high"] = kernel.NO_LIMIT if block.high is None else block.high
        row["low_of"], row["high_of"] = signals[block.low_of], signals[block.high_of]
        if block.states:
            row["state"] = len(states)
            ends = ["", "_rate"] if block.kind != "dead_time" else [f"_{i}" for i in range(block.states)]
            states += [f"{block.name}{end}" for end in ends[: block.states]]
    return Control(rows, [block.name for block in blocks], states)


def _sensed(data: Any, field: str, usual: int) -> str:
    """The signal that stands for a code of the library. Raises `InputError` if there is none."""
    code = int(getattr(data, field, usual))
    if code not in INPUTS:
        allowed = ", ".join(map(str, INPUTS))
        raise InputError(f"{data.model} of {data.machine}: {field}: {code} given; allowed: {allowed}")
    return INPUTS[code]


class _Plain(NamedTuple):
    """A block with numbers instead of parameter names."""

    name: str
    kind: str
    inputs: str
    p: tuple[float, ...]
    states: int
    low: float | None
    high: float | None
    low_of: str
    high_of: str
    hold: str


def _number(constant: Any, data: Any) -> float:
    """A constant of a block: a number, a parameter, or a value derived from parameters."""
    if isinstance(constant, str):
        return float(getattr(data, constant))
    return float(constant(data) if callable(constant) else constant)


def _plain(block: Block, data: Any) -> _Plain:
    """The block in the kernel's numbers; a block with zero time constant has no state."""
    kind, inputs, c = block.kind, block.inputs, [_number(constant, data) for constant in block.constants]
    p: tuple[float, ...] = (1.0, 0.0, 0.0, 0.0)
    states = 0
    if kind == "lag":
        p, states = (c[0], c[1], 0.0, 0.0), int(c[1] > 0.0)
    elif kind == "lead_lag":
        p, states = (c[0], c[1] / c[2] if c[2] > 0.0 else 0.0, c[2], 0.0), int(c[2] > 0.0 and c[1] != c[2])
    elif kind == "washout":
        p, states = (c[0], 0.0, c[1], 0.0), int(c[1] > 0.0)
    elif kind == "rate":
        p, states = (c[0] / c[1] if c[1] > 0.0 else 0.0, 0.0, c[1], 0.0), int(c[1] > 0.0 and c[0] != 0.0)
        kind, inputs = (kind, inputs) if states else ("sum", "none")
    elif kind == "servo":
        p, states = (max(c[0], SHORTEST), c[1], c[2], 0.0), 1
    elif kind in ("field", "exponential"):
        p, states = (c[0], max(c[1], SHORTEST), c[2], c[3]), 1
    elif kind == "integral":
        p, states = (c[0], 0.0, 0.0, 0.0), int(c[0] != 0.0)
        kind, inputs = (kind, inputs) if states else ("sum", "none")
    elif kind == "second_order" and c[3] > 0.0:
        p, states = (c[0], c[1], c[2], c[3]), 2
    elif kind == "second_order":  # first order, or no dynamics
        kind, states = "lead_lag", int(c[2] > 0.0)
        p = (1.0, c[0] / c[2] if c[2] > 0.0 else 0.0, c[2], 0.0)
    elif kind == "source":
        turned = rect(c[0], math.radians(c[1]))
        behind = 1j * (c[2] + turned * c[3])
        p = (turned.real, turned.imag, behind.real, behind.imag)
    elif kind == "rectifier":
        p = (c[0], 0.0, 0.0, 0.0)
    elif kind == "pi":
        p, states = (c[0], c[1], 0.0, 0.0), int(c[1] != 0.0)
    elif kind in ("window", "saturation"):
        p = (c[0], c[1], c[2] if len(c) > 2 else 0.0, 0.0)
    elif kind == "relay" and c[1] < 0.0:  # always on
        inputs = "one"
    elif kind == "relay":
        p, states = (c[0], c[1], c[2], 0.0), 1
    elif kind == "curve":
        p = _points(c)
    elif kind == "dead_time" and c[0] > 0.0:
        states = min(ORDER, max(1, int(c[0] / (2.0 * SHORTEST))))
        p = (c[0], float(states))
    elif kind == "regulator":  # its state is there with a gain of 0, too: it is what the reference asks for
        kind, p, states = "pi", (c[0], c[1]), 1
    elif kind == "dead_band":
        p = (min(c[0], 0.0), max(c[1], 0.0))
    elif kind == "room":
        p = (c[0],)
    elif kind == "after":
        p, states = (c[0], SHORTEST), int(c[0] > 0.0)
    elif kind == "angle_lag":
        p, states = (max(c[0], SHORTEST),), 1
    low, high = (None if limit is None else _number(limit, data) for limit in (block.low, block.high))
    return _Plain(block.name, kind, inputs, p, states, low, high, block.low_of, block.high_of, block.hold)


def _points(constants: Sequence[float]) -> tuple[float, ...]:
    """The points of a curve, without those that are not to the right of all before; fewer than two: a gain of one."""
    points = list[tuple[float, float]]()
    for x, y in zip(constants[::2], constants[1::2], strict=True):
        if not points or x > points[-1][0]:
            points.append((x, y))
    points = points if len(points) > 1 else [(0.0, 0.0), (1.0, 1.0)]
    while len(points) < kernel.POINTS:
        (x, y), (end, at_end) = points[-2:]
        points.append((2.0 * end - x, 2.0 * at_end - y))
    return tuple(value for point in points for value in point)


def _spread(blocks: Sequence[Block], data: Any) -> list[Block]:
    """Expand ramp-tracking filters ((1 + s T8) / (1 + s T9)^M)^N to lead-lags and lags in series.

    Raises `InputError` for a filter of too high an order.
    """
    simple: list[Block] = []
    for block in blocks:
        if block.kind != "ramp_tracking":
            simple.append(block)
            continue
        lead, lag, maximum, times = (_number(constant, data) for constant in block.constants)
        if maximum * times > FILTER_ORDER:
            text = f"M N = {maximum * times:g} given; allowed: at most {FILTER_ORDER}"
            raise InputError(f"{data.model} of {data.machine}: {text}")
        parts = [(1.0, lead, lag) if i % max(1, int(maximum)) == 0 else (1.0, lag) for i in range(int(maximum * times))]
        before = block.inputs
        for i, constants in enumerate(parts):
            name = block.name if i == len(parts) - 1 else f"{block.name}_{i + 1}"
            simple.append(Block(name, "lead_lag" if len(constants) == 3 else "lag", before, constants))
            before = name
        if not parts:
            simple.append(Block(block.name, "sum", block.inputs))
    return simple


def _inputs(text: str, data: Any) -> list[tuple[str, float]]:
    """Signals and weights of an expression such as "Vref - K1 * VT"."""
    weighted = []
    for sign, factor, name in re.findall(r"([+-]?)\s*(?:(\w+)\s*\*\s*)?(\w+)", text):
        weight = 1.0
        if factor:
            derived = MODELS[data.model].factors
            weight = derived[factor](data) if factor in derived else _number(factor, data)
        weighted.append((name, -weight if sign == "-" else weight))
    return weighted


def _in_order(blocks: Sequence[_Plain], data: Any) -> list[_Plain]:
    """Blocks sorted so that each output depends only on earlier rows and on states."""
    done, left = list[_Plain](), list(blocks)
    known = {*kernel.SENSED, "input", "input_2"}
    while left:
        ready = next((block for block in left if _needs(block, data) <= known), None)
        if ready is None:
            names = ", ".join(block.name for block in left)
            raise InputError(
                f"{data.model} of {data.machine}: an algebraic loop: {names}; allowed: a time constant above 0"
            )
        left.remove(ready)
        done.append(ready)
        known.add(ready.name)
    return done


def _needs(block: _Plain, data: Any) -> set[str]:
    """Signals with direct feedthrough to a block's output."""
    limits = {block.low_of, block.high_of}
    at_once = not block.states or block.kind in FEEDTHROUGH or (block.kind == "pi" and block.p[0] != 0.0)
    return limits | {name for name, _ in _inputs(block.inputs, data)} if at_once else limits


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
        where = f"{self.table}: {self.control.machine}: {self.control.model}: {self.name}"
        limits = f"{self.low:.4g} to {self.high:.4g}"
        return f"{where} is {self.value:.4g} p.u. at the start; allowed by its limits: {limits}"


class Rest(NamedTuple):
    """Steady state of a control: its states, the reference, what it gives, and the limits that exclude it."""

    states: NDArray[np.float64]
    reference: float
    gives: float
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
    block_control: Control, data: Any, sensed: Mapping[str, float], gives: float | None, reference: str | None
) -> Rest:
    """States and the value of the signal `reference` for which a control's output is `gives` at steady state.

    It is solved by Newton's method without limits. Raises `InputError` if there is no steady state.
    """
    s = np.zeros(len(kernel.SENSED) + len(block_control.rows))
    for name, value in {"one": 1.0, **sensed}.items():
        s[kernel.SENSED.index(name)] = value
    free = block_control.rows.copy()
    freed = free["kind"] != kernel.LIMITER
    free["low"][freed], free["high"][freed] = -kernel.NO_LIMIT, kernel.NO_LIMIT
    free["low_of"][freed] = free["high_of"][freed] = kernel.ONE
    output = block_control.gives.index(GIVES[MODELS[data.model].role])
    n, at = len(block_control.states), len(kernel.SENSED)

    def moves(z: Float1) -> Float1:
        x, dx = np.ascontiguousarray(z[:n]), np.zeros(n)
        if reference is not None:
            s[kernel.SENSED.index(reference)] = z[n]
        kernel.moved(free, at, x, s, dx)
        return np.append(dx, s[at + output] - gives) if reference is not None and gives is not None else dx

    for scale in STARTS:
        z = _zero(moves, np.full(n + (reference is not None), scale * (1.0 if gives is None else gives)))
        if z is not None:
            break
    else:
        raise InputError(f"{data.model} of {data.machine}: no steady state found at the start")
    solved = float(z[n]) if reference is not None else 0.0
    return Rest(z[:n], solved, float(s[at + output]), _violations(block_control, data, s))


def _zero(f: Callable[[Float1], Float1], z: Float1) -> Float1 | None:
    """Zero of a function by Newton's method from a point on; None: it does not converge."""
    for _ in range(STEPS):
        left = f(z)
        if np.abs(left).max(initial=0.0) < TOLERANCE:
            return z
        slopes = [(f(z + step) - f(z - step)) / (2.0 * step.max()) for step in 1e-6 * np.eye(len(z))]
        z = z - least_squares(np.array(slopes).T, left)
    return None


def _violations(block_control: Control, data: Any, s: Float1) -> list[LimitViolation]:
    """Limits violated by the signals of a control whose steady state was found without limits."""
    wrong, fields = list[LimitViolation](), {block.name: block for block in MODELS[data.model].blocks}
    for row, name, value in zip(block_control.rows, block_control.gives, s[len(kernel.SENSED) :], strict=True):
        low, high = row["low"] * s[row["low_of"]], row["high"] * s[row["high_of"]]
        if low - 1e-9 <= value <= high + 1e-9:
            continue
        side, of = ("low", row["low_of"]) if value < low else ("high", row["high_of"])
        limit = getattr(fields[name], side)
        field = limit if isinstance(limit, str) else None
        wrong.append(LimitViolation(data, name, float(value), float(low), float(high), field, float(value / s[of])))
    return wrong
