"""Block-diagram controls built from their parameters: rows in order of evaluation."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from facts_damping.elementary import rect
from facts_damping.errors import InputError
from facts_damping.machine_controls.block_models import INPUTS, MODELS, active_blocks
from facts_damping.machine_controls.blocks import SHORTEST, Block, number, terms
from facts_damping.plant.machines import blocks as kernel

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from numpy.typing import NDArray

GIVES = {"governor": "Pm", "stabiliser": "Vs", "exciter": "Efd"}
# Kinds with direct feedthrough.
FEEDTHROUGH = {"sum", "lead_lag", "washout", "rate", "second_order", "product", "source", "rectifier", "curve", "after"}
FILTER_ORDER = 20  # of a ramp-tracking filter, of which the library allows 8
ORDER = 10  # of a dead time's approximation, right to 1e-4 at a lag of 10 rad; of a short one less: a state for 4 ms


class Control(NamedTuple):
    """A control as rows of BLOCK, the signals of the rows in their order, and the names of its states."""

    rows: NDArray[Any]
    gives: list[str]
    states: list[str]
    first: int = 0  # number of the first rows, which follow from states and what is always known


class Signals(NamedTuple):
    """What the blocks of a control may use: signals that are always known, and those that are measured.

    `stand_ins`: signals that no control may give, and what then stands for them.
    """

    known: Sequence[str]
    measured: Sequence[str] = ()
    stand_ins: Mapping[str, str] = {}


MACHINE = Signals(kernel.SENSED)


def owner(data: Any) -> str:
    """The name of the machine or inverter whose control it is."""
    return str(getattr(data, "machine", None) or getattr(data, "inverter", None) or data.name)


def control(*models: Any, signals: Signals = MACHINE) -> Control:
    """The rows of a control of one or several models, with their parameters; state indices count from 0.

    A block may have the name of a signal, which it then replaces. Raises `InputError` if blocks form an algebraic loop,
    two of them have one name, no control gives a signal that they use, or a gain is infinite.
    """
    blocks = list[_Plain]()
    for data in models:
        try:
            blocks += [_plain(block, data) for block in _spread(active_blocks(data), data)]
        except ZeroDivisionError as error:
            text = "an infinite gain given; allowed: finite gains"
            raise InputError(f"{data.model} of {owner(data)}: {text}") from error
    named = [block.name for block in blocks]
    if doubled := sorted({name for name in named if named.count(name) > 1}):
        text = f"two signals {', '.join(doubled)} given; allowed: one control of each sort"
        raise InputError(f"{' and '.join(data.model for data in models)} of {owner(models[0])}: {text}")
    rename = {name: other for name, other in signals.stand_ins.items() if name not in named}
    blocks = [b._replace(inputs=[(rename.get(name, name), weight) for name, weight in b.inputs]) for b in blocks]
    label = f"{models[0].model} of {owner(models[0])}"
    used = {name for b in blocks for name in (*dict(b.inputs), b.low_of, b.high_of, b.hold)}
    if missing := sorted(used - {*named, *signals.known, *signals.measured}):
        giving = [name for name, row in MODELS.items() if any(block.name in missing for block in row.blocks)]
        text = f"no {', '.join(missing)} given; allowed: with one of {', '.join(giving)}"
        raise InputError(f"{label}: {text}")
    first = _in_order(blocks, set(signals.known) - set(named))
    rest = [block for block in blocks if block not in first]
    known = {*signals.known, *signals.measured}.difference(named).union(block.name for block in first)
    later = _in_order(rest, known)
    if left := [block.name for block in rest if block not in later]:
        text = f"an algebraic loop: {', '.join(left)}; allowed: a time constant above 0"
        raise InputError(f"{label}: {text}")
    blocks = first + later
    at = {name: i for i, name in enumerate([*signals.known, *signals.measured, *(block.name for block in blocks)])}
    rows, states = np.zeros(len(blocks), kernel.BLOCK), list[str]()
    for row, block in zip(rows, blocks, strict=True):
        _fill(row, block, at, states)
    return Control(rows, [block.name for block in blocks], states, len(first))


def with_states_from(assembled: Control, offset: int) -> NDArray[Any]:
    """The rows of a control whose states begin at an index of the plant's."""
    rows: NDArray[Any] = assembled.rows.copy()
    rows["state"][rows["state"] >= 0] += offset
    return rows


def used_signals(rows: NDArray[Any]) -> set[int]:
    """The signals that rows have as inputs."""
    return {int(n) for row in rows for n in row["source"][: row["inputs"]]}


def _fill(row: Any, block: _Plain, at: dict[str, int], states: list[str]) -> None:
    """Write a row of BLOCK, and add the names of its states."""
    row["kind"], row["state"] = kernel.KINDS.index(block.kind), kernel.STATELESS
    for i, (name, weight) in enumerate(block.inputs):
        row["source"][i], row["weight"][i] = at[name], weight
        row["inputs"] = i + 1
    row["p"][: len(block.p)] = block.p
    row["low"] = -kernel.NO_LIMIT if block.low is None else block.low
    row["high"] = kernel.NO_LIMIT if block.high is None else block.high
    row["low_of"], row["high_of"], row["hold"] = at[block.low_of], at[block.high_of], at[block.hold]
    if block.states:
        row["state"] = len(states)
        ends = ["", "_rate"] if block.kind != "dead_time" else [f"_{i}" for i in range(block.states)]
        states += [f"{block.name}{end}" for end in ends[: block.states]]


def _sensed(data: Any, field: str, usual: int) -> str:
    """The signal that stands for a code of the library. Raises `InputError` if there is none."""
    code = int(getattr(data, field, usual))
    if code not in INPUTS:
        allowed = ", ".join(map(str, INPUTS))
        raise InputError(f"{data.model} of {owner(data)}: {field}: {code} given; allowed: {allowed}")
    return INPUTS[code]


class _Plain(NamedTuple):
    """A block with numbers instead of parameter names."""

    name: str
    kind: str
    inputs: list[tuple[str, float]]  # signals with their weights
    p: tuple[float, ...]
    states: int
    low: float | None
    high: float | None
    low_of: str
    high_of: str
    hold: str


def _plain(block: Block, data: Any) -> _Plain:
    """The block in the kernel's numbers; a block with zero time constant has no state."""
    kind, inputs, c = block.kind, block.inputs, [number(constant, data) for constant in block.constants]
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
    elif kind in ("room", "stop"):
        p, states = (c[0],), int(kind == "stop")
    elif kind == "after":
        p, states = (c[0], SHORTEST), int(c[0] > 0.0)
    elif kind == "angle_lag":
        p, states = (max(c[0], SHORTEST),), 1
    low, high = (None if limit is None else number(limit, data) for limit in (block.low, block.high))
    weighted = _inputs(inputs, data)
    return _Plain(block.name, kind, weighted, p, states, low, high, block.low_of, block.high_of, block.hold)


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
        lead, lag, maximum, times = (number(constant, data) for constant in block.constants)
        if maximum * times > FILTER_ORDER:
            text = f"M N = {maximum * times:g} given; allowed: at most {FILTER_ORDER}"
            raise InputError(f"{data.model} of {owner(data)}: {text}")
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
    for sign, factor, name in terms(text):
        weight, signal = 1.0, name
        if name in ("input", "input_2"):
            signal = _sensed(data, "IC", 1) if name == "input" else _sensed(data, "IC2", 0)
        if factor:
            derived = MODELS[data.model].factors
            weight = derived[factor](data) if factor in derived else number(factor, data)
        weighted.append((signal, -weight if sign == "-" else weight))
    return weighted


def _in_order(blocks: Iterable[_Plain], known: set[str]) -> list[_Plain]:
    """Blocks sorted so that each output depends on earlier ones, states and known signals; those for which it can."""
    done, left, known = list[_Plain](), list(blocks), set(known)
    while ready := next((block for block in left if _needs(block) <= known), None):
        left.remove(ready)
        done.append(ready)
        known.add(ready.name)
    return done


def _needs(block: _Plain) -> set[str]:
    """Signals with direct feedthrough to a block's output."""
    limits = {block.low_of, block.high_of}
    at_once = not block.states or block.kind in FEEDTHROUGH or (block.kind == "pi" and block.p[0] != 0.0)
    return limits | {name for name, _ in block.inputs} if at_once else limits
