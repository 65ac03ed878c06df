"""Block-diagram controls of machines; compiled.

A control is a sequence of rows of BLOCK, each of which computes one signal from others. Rows are sorted so that direct
feedthrough uses only signals computed before (`block_controls` makes them).
"""

from __future__ import annotations

import math
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray

from facts_damping.compiling import compiled, entry_point, inlined
from facts_damping.compiling.structs import Array, Float1
from facts_damping.elementary import cos, exp, magnitude, sin
from facts_damping.machine_controls.blocks import SHORTEST

# Input signals of blocks from a machine, p.u. of the rating; the blocks' own signals follow.
SENSED = ("one", "none", "Vt", "omega", "Pe", "Pa", "Vref", "Pref", "Vs", "Ifd", "Vd", "Vq", "Id", "Iq", "Vc", "Vt0")
ONE, NONE, VT, OMEGA, PE, PA, VREF, PREF, VS, IFD, VD, VQ, ID, IQ, VC, VT0 = range(len(SENSED))

ROLES = ("governor", "stabiliser", "exciter")  # in order of evaluation

(SUM, LAG, LEAD_LAG, WASHOUT, RATE, SERVO, FIELD, SECOND_ORDER, PRODUCT, SOURCE, RECTIFIER, INTEGRAL, EXPONENTIAL) = (
    range(13)
)
LIMITER, PI, WINDOW, RELAY, SATURATION, QUOTIENT, CURVE, DEAD_TIME = range(13, 21)
DEAD_BAND, ROOM, AFTER, ANGLE_LAG, STOP, MAGNITUDE, SINE, COSINE = range(21, 29)
# Names of these codes.
KINDS = (
    "sum",
    "lag",
    "lead_lag",
    "washout",
    "rate",
    "servo",
    "field",
    "second_order",
    "product",
    "source",
    "rectifier",
    "integral",
    "exponential",
    "limiter",
    "pi",
    "window",
    "relay",
    "saturation",
    "quotient",
    "curve",
    "dead_time",
    "dead_band",
    "room",
    "after",
    "angle_lag",
    "stop",
    "magnitude",
    "sine",
    "cosine",
)
MAX_INPUTS = 5
POINTS = 10  # of a curve
NO_LIMIT = 1e30  # p.u.; finite, so that its product with zero is a number
STATELESS = -1
OVER = 1e-3  # of what is after something: smooth at rest, where it is 0
TURN = 2.0 * math.pi

BLOCK = np.dtype(
    [
        ("kind", "i8"),
        ("state", "i8"),  # index of its (first) state in the plant's, or STATELESS
        ("inputs", "i8"),
        ("source", "i8", (MAX_INPUTS,)),  # input signals
        ("weight", "f8", (MAX_INPUTS,)),
        ("low", "f8"),
        ("high", "f8"),
        ("low_of", "i8"),  # signals that multiply the limits
        ("high_of", "i8"),
        ("hold", "i8"),  # the signal that holds its states while it is 1
        ("p", "f8", (2 * POINTS,)),  # last, as most rows use the first few alone
    ]
)
# Of a machine: the rows of each control, and its output signal; no rows: no control of this sort.
CONTROLS = np.dtype(
    [
        *((f"{role}_{end}", "i8") for role in ROLES for end in ("first", "end", "gives")),
        ("Vref", "f8"),
        ("Vt0", "f8"),  # p.u., terminal voltage at the start
        ("compensation", "c16"),  # p.u. of the rating; the exciter sees |Vt + compensation It|, the signal Vc
        ("power_offset", "f8"),  # p.u. of the rating, power reference minus the requested power
    ]
)


@compiled
def _limited(b: Any, value: float, s: Float1) -> float:
    return min(max(value, b.low * s[b.low_of]), b.high * s[b.high_of])  # type: ignore[no-any-return]


@compiled
def _total(b: Any, s: Float1) -> float:
    total = 0.0
    for i in range(b.inputs):
        total += b.weight[i] * s[b.source[i]]
    return total


@compiled
def _rectified(voltage: float, current: float) -> float:
    """Output of a rectifier, p.u.: voltage times FEX(KC Ifd / VE) (IEEE Std 421.5, annex D)."""
    if voltage <= 0.0:
        return 0.0
    loading = current / voltage
    if loading <= 0.0:
        return voltage
    if loading <= 0.433:
        return voltage * (1.0 - 0.577 * loading)
    if loading < 0.75:
        return voltage * math.sqrt(0.75 - loading * loading)
    return voltage * max(0.0, 1.732 * (1.0 - loading))


@compiled
def _on_curve(b: Any, u: float) -> float:
    """The line through the points (p[0], p[1]), (p[2], p[3]) and on, at u; its ends go on straight."""
    i = 0
    while i < 2 * (POINTS - 2) and u > b.p[i + 2]:
        i += 2
    return b.p[i + 1] + (u - b.p[i]) * (b.p[i + 3] - b.p[i + 1]) / (b.p[i + 2] - b.p[i])  # type: ignore[no-any-return]


@compiled
def _of_inverters(b: Any, u: float, x: Float1, s: Float1) -> float:
    """The signal of a block of the kinds from DEAD_BAND on; see `outputs`."""
    if b.kind == DEAD_BAND:
        return u - min(max(u, b.p[0]), b.p[1])  # type: ignore[no-any-return]
    if b.kind == ROOM:
        return math.sqrt(max(0.0, b.p[0] * b.p[0] - u * u))
    if b.kind == MAGNITUDE:
        return magnitude(complex(b.weight[0] * s[b.source[0]], b.weight[1] * s[b.source[1]]))
    if b.kind == SINE:
        return sin(u)  # type: ignore[no-any-return]
    if b.kind == COSINE:
        return cos(u)  # type: ignore[no-any-return]
    return 1.0 if u > 0.5 or (b.state >= 0 and x[b.state] > OVER) else 0.0  # after


@inlined
def output(b: Any, x: Float1, s: Float1) -> float:
    """The signal of a row for states `x` and signals `s`.

    lag, servo, field, exponential, integral: x within its limits; lead_lag: K (x + T1/T2 (u - x)); washout, rate:
    K (u - x), K/T (u - x); second_order: numerator over denominator in the companion form; product of two; source:
    |KP Vt + j (KI + KP XL) It|; sum, and blocks with zero time constant: K u. limiter: a sum whose limits belong to its
    function, so that they hold at the start, too; pi: K u + x, limited; window: its second input while the first is
    between two constants, else the third; relay: x; saturation: K u + B (u - A)^2 above A; quotient of two; dead_time:
    the sum of its states; dead_band: u beyond two constants, 0 between them; room: sqrt(K^2 - u^2), 0 beyond K; after:
    1 while u is 1 and for a time after it; angle_lag: x, an angle in rad that never jumps; magnitude of the vector of
    two; sine, cosine of u in rad; stop: x.
    """
    if b.state >= 0 and b.kind in (LAG, SERVO, FIELD, INTEGRAL, EXPONENTIAL, RELAY, ANGLE_LAG, STOP):
        return _limited(b, x[b.state], s)  # within a step the state may exceed its limit
    u = _total(b, s)
    if b.kind == PRODUCT:
        return s[b.source[0]] * s[b.source[1]]  # type: ignore[no-any-return]
    if b.kind == SOURCE:
        voltage, current = complex(s[b.source[0]], s[b.source[1]]), complex(s[b.source[2]], s[b.source[3]])
        return magnitude(complex(b.p[0], b.p[1]) * voltage + complex(b.p[2], b.p[3]) * current)
    if b.kind == RECTIFIER:
        return _rectified(s[b.source[0]], b.p[0] * s[b.source[1]])
    if b.kind == WINDOW:
        passed = 1 if b.p[0] <= s[b.source[0]] <= b.p[1] else 2
        return b.weight[passed] * s[b.source[passed]]  # type: ignore[no-any-return]
    if b.kind == SATURATION:
        beyond = max(0.0, u - b.p[1])
        return b.p[0] * u + b.p[2] * beyond * beyond  # type: ignore[no-any-return]
    if b.kind == QUOTIENT:
        return _limited(b, s[b.source[0]] / s[b.source[1]], s)
    if b.kind == CURVE:
        return _on_curve(b, u)
    if b.kind >= DEAD_BAND:
        return _of_inverters(b, u, x, s)
    if b.state < 0:
        return _limited(b, b.p[0] * u, s)
    if b.kind == LEAD_LAG:
        state = x[b.state]
        return _limited(b, b.p[0] * (state + b.p[1] * (u - state)), s)
    if b.kind == PI:
        return _limited(b, b.p[0] * u + x[b.state], s)
    if b.kind in (WASHOUT, RATE):
        return b.p[0] * (u - x[b.state])  # type: ignore[no-any-return]
    if b.kind == SECOND_ORDER:
        return x[b.state] + b.p[0] * x[b.state + 1] + b.p[1] * _acceleration(b, u, x)  # type: ignore[no-any-return]
    y = 0.0  # of a dead time
    for i in range(int(b.p[1])):
        y += x[b.state + i]
    return y


@compiled
def outputs(blocks: NDArray[Any], first: int, end: int, at: int, x: Float1, s: Float1) -> None:
    """Write the signals of rows `first` to `end` into `s`, from index `at` on, for states `x`."""
    for k in range(first, end):
        s[at + k - first] = output(blocks[k], x, s)


@compiled
def _acceleration(b: Any, u: float, x: Float1) -> float:
    """Second derivative in a companion form with denominator coefficients p[2] (first) and p[3] (second)."""
    return (u - x[b.state] - b.p[2] * x[b.state + 1]) / b.p[3]  # type: ignore[no-any-return]


@compiled
def _move_past(b: Any, u: float, x: Float1, dx: Float1) -> None:
    """Write the derivatives of the n = p[1] states of a dead time T = p[0], 1/s.

    x are the coefficients of Legendre polynomials on [0, 1] for the input of the last T seconds, from now backwards:
    T dx[i] / (2 i + 1) = (-1)^i (u - the sum of (-1)^j x[j] for j <= i) - the sum of x[j] for j > i. From input to the
    sum of x this is the Pade approximation of exp(-s T) with a numerator of degree n - 1 and a denominator of degree n.
    """
    n, now, beyond, sign = int(b.p[1]), u, 0.0, 1.0
    for i in range(n):
        beyond += x[b.state + i]
    for i in range(n):
        beyond -= x[b.state + i]
        now -= sign * x[b.state + i]
        dx[b.state + i] = (2 * i + 1) / b.p[0] * (sign * now - beyond)
        sign = -sign


@inlined
def move(b: Any, x: Float1, s: Float1, dx: Float1) -> None:
    """Write the derivatives of the states of a row, 1/s, for the signals from `outputs`.

    lag: T dx = K u - x; lead_lag, washout, rate: T dx = u - x; servo: dx = clip((u - x) / T, rates); field:
    TE dx = u - KE x - SE(x) x; exponential: the same with SE(x) = A exp(B x); integral: dx = K u. States of lag, servo
    and integral stop at their limits. pi: dx = KI u until its output is at a limit; relay: T dx = 1 - x from one
    threshold of u up, -x from the other down, between them to the nearer of both; after: x goes to 1 in no time while u
    is 1, then falls to `OVER` in T s, and is over; angle_lag: T dx = u - x without whole turns; stop: dx = K u, but no
    faster than to its limits within `SHORTEST`, at one of which it rests. What is held stands still.
    """
    u, state = _total(b, s), x[b.state]
    if b.kind == LAG:
        slope = (b.p[0] * u - state) / b.p[1]
    elif b.kind == SERVO:
        slope = min(max((u - state) / b.p[0], b.p[1]), b.p[2])
    elif b.kind == FIELD:
        beyond = max(0.0, state - b.p[2])
        slope = (u - b.p[0] * state - b.p[3] * beyond * beyond) / b.p[1]
    elif b.kind == EXPONENTIAL:
        slope = (u - (b.p[0] + b.p[2] * exp(b.p[3] * state)) * state) / b.p[1]
    elif b.kind == INTEGRAL:
        slope = b.p[0] * u
    elif b.kind == PI:
        slope = b.p[1] * u
    elif b.kind == RELAY:
        on = u >= b.p[1] or (u > b.p[0] and state > 0.5)
        slope = ((1.0 if on else 0.0) - state) / b.p[2]
    elif b.kind == DEAD_TIME:
        _move_past(b, u, x, dx)
        return
    elif b.kind == AFTER:
        slope = (1.0 - state) / b.p[1] if u > 0.5 else (-1.0 / b.p[0] if state > OVER else -state / b.p[1])
    elif b.kind == ANGLE_LAG:
        slope = (u - state - TURN * math.floor((u - state) / TURN + 0.5)) / b.p[0]
    elif b.kind == STOP:
        low, high = b.low * s[b.low_of] - state, b.high * s[b.high_of] - state
        slope = min(max(b.p[0] * u, low / SHORTEST), high / SHORTEST)
    elif b.kind == SECOND_ORDER:
        dx[b.state + 1] = _acceleration(b, u, x)
        slope = x[b.state + 1]
    else:
        slope = (u - state) / b.p[2]
    if b.kind in (LAG, SERVO, INTEGRAL, PI):
        reached = b.p[0] * u + state if b.kind == PI else state
        above, below = reached >= b.high * s[b.high_of], reached <= b.low * s[b.low_of]
        if (above and slope > 0.0) or (below and slope < 0.0):
            slope = 0.0
    dx[b.state] = 0.0 if s[b.hold] > 0.5 else slope


@compiled
def derivatives(blocks: NDArray[Any], first: int, end: int, x: Float1, s: Float1, dx: Float1) -> None:
    """Write the derivatives of the states of rows `first` to `end`, 1/s, for the signals from `outputs`."""
    for k in range(first, end):
        if blocks[k].state >= 0:
            move(blocks[k], x, s, dx)


@entry_point
def moved(blocks: Annotated[NDArray[Any], Array(BLOCK, 1)], at: int, x: Float1, s: Float1, dx: Float1) -> None:
    """Write signals and derivatives of a control alone, for the states `x`: `outputs`, `derivatives`."""
    outputs(blocks, 0, len(blocks), at, x, s)
    derivatives(blocks, 0, len(blocks), x, s, dx)
