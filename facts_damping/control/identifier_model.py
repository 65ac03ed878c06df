"""Parameters and state of identifiers as arrays, their networks, and the networks' initial parameters."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from facts_damping.compiling.structs import Array, Complex1, Float1, Float2, Float3, Int1, Int2, Int3, Struct
from facts_damping.control.inputs import Inputs, LatestSamples
from facts_damping.control.table import SETTINGS
from facts_damping.elementary import exp, phase, rect
from facts_damping.neurofuzzy.learning import Learners
from facts_damping.neurofuzzy.network import Network, network
from facts_damping.neurofuzzy.start import Start, initial, slots
from facts_damping.neurofuzzy.table import IDENTIFIERS, MIMO_FORM
from facts_damping.numerics.phasors import over, power, times

if TYPE_CHECKING:
    from collections.abc import Sequence

    from facts_damping.control.neuro_fuzzy import PlantPrior

WIDTH = 1.0  # initial width s of the memberships
SPREAD = 0.5  # initial centres -0.5 and 0.5 if the consequents hold the linear plant
DILATION = 5.0  # initial dilation nu of the wavelets
FLAT = 1e-9  # fraction of phasors' largest extent: a smaller extent in the other direction is round-off


class Identified(NamedTuple):
    """The controller of an identifier: index, settings, signals, devices and their limits."""

    controller: int
    settings: NDArray[Any]  # (signals or devices,) of SETTINGS
    kind: str  # a row of IDENTIFIERS
    signals: Sequence[str]
    devices: Sequence[int]
    limits: Sequence[float]  # p.u.
    known: PlantPrior
    weights: NDArray[np.float64] | None  # initial parameters; None: symmetric rules
    predicts: bool = False  # the controller uses predicted signals


class Identifiers(Struct):
    """Constant parameters of all identifiers of a run; the first axis is the identifier."""

    controller: Int1
    settings: Annotated[NDArray[Any], Array(SETTINGS, 2)]  # (identifiers, most signals or devices) of SETTINGS
    shape: Int2  # (identifiers, fields of Network)
    inputs: Inputs
    device: Int2  # (identifiers, most devices); UNSET: unused
    limit: Float2  # (identifiers, most devices), p.u.
    loop_delay_ns: Int1
    horizon: Int1  # frames
    order: Int1  # number of past values of each signal as inputs
    span: Int1  # frames between these values
    ahead_ns: Int1  # time ahead of a prediction; UNSET: no prediction
    period_ns: Int1


class IdentifierState(Struct):
    """State of all identifiers; the first axis is the identifier."""

    held: LatestSamples
    learner: Learners
    past: Float3  # (identifiers, kept, most signals), p.u., ring of the newest frames
    past_ns: Int2  # (identifiers, kept): their times
    newest: Int1  # (identifiers,): index of the newest frame
    given_ns: Int3  # (identifiers, most devices, kept): measurement times of setpoints, a ring
    given: Float3  # same shape: the setpoints, p.u.
    at: Int2  # (identifiers, most devices): index of the newest setpoint
    deviation: Float2  # (identifiers, most signals): measurement minus prediction, normalised
    curvature: Float2  # (identifiers, most signals): ones
    lyapunov: Float2  # (identifiers, 2): half the squared error of the newest step, and its decrease
    prediction: Float2  # (identifiers, most signals), p.u.; NaN: none yet
    error: Float2  # (identifiers, most signals), prediction minus measurement, p.u.; NaN: none yet
    peak: Float2  # (identifiers, most signals), p.u., largest measured value
    path: Float3  # (identifiers, frames, most signals), p.u., past and predicted
    change: Float2  # (identifiers, most signals), p.u., predicted; NaN: none
    jacobian: Float3  # (identifiers, most signals, most devices), p.u./p.u.


def past_values(span: Any) -> int:
    """Number of past values of each signal as inputs: 2 with a span (frames), 1 if it is 0."""
    return 2 if span else 1


def predictor_network(kind: str, signals: int, devices: int, order: int = 1) -> Network:
    """The network of an identifier: inputs are past signals and setpoints, outputs the signals.

    With several outputs the consequents are affine (6.9).
    """
    antecedent, consequent = IDENTIFIERS[kind]
    form = MIMO_FORM.get(consequent, consequent) if signals * devices * order > 1 else consequent
    return network(antecedent, form, signals * order + devices, 2, signals)


def start(net: Network, row: Identified) -> Float1:
    """Initial parameters with y_I near y(k-h) + J u for small y and u; J: Jacobian of the linear plant.

    Affine consequents hold J exactly, and instead of y(k-h) the evolution of past values in the least damped mode.
    Gaussian rules at -h and h give weight tanh(2 sum_i h_i x_i / s^2); two mirrored wavelets give slopes of
    weight (cos 5q)' about q = 0.
    """
    scale = row.settings["scale"][: len(row.signals)]
    by_u = row.known.jacobian * np.array(row.limits) / scale[:, None]
    order = (net.inputs - len(row.devices)) // net.outputs
    if net.outputs * len(row.devices) * order > 1:
        horizon, span = (int(row.settings[f"identifier_{name}"][0]) for name in ("horizon", "span"))
        now = over(row.known.mode_shape, scale)
        past = np.concatenate([over(now, power(row.known.z_pole, span * j)) for j in range(order)])
        later = times(now, power(row.known.z_pole, horizon))
        return _linear_start(net, np.hstack([_ahead(past, later), by_u]))
    weight, by_u = float(row.settings["identifier_weight"][0]), by_u[0]
    slopes = np.concatenate([np.ones(len(row.signals)), by_u])
    width, dilation = np.full(net.inputs, WIDTH), np.full(net.inputs, DILATION)
    spread, shift = np.zeros(net.inputs), np.zeros(net.inputs)
    if IDENTIFIERS[row.kind][1] == "morlet":
        shift[:] = np.pi * DILATION / 10.0  # where cos 5q crosses zero, falling
        weight = DILATION / 5.0 * exp(0.5 * (math.pi / 10.0) * (math.pi / 10.0))
        shift[len(row.signals) :] = by_u * DILATION**2 / (26.0 * weight)
    else:
        spread[:] = slopes * WIDTH**2 / (2.0 * weight)
    return initial(net, Start([weight], spread, width, shift, dilation))


def _ahead(past: Complex1, later: Complex1) -> Float2:
    """The least-norm real matrix M, (signals, past values), that minimises |M past - later|, for phasors of a mode.

    Both are rotated until real and imaginary part of `past` are orthogonal. Then M is the sum of
    later_i past_i^T / |past_i|^2 over the parts i that are more than round-off.
    """
    turn = rect(1.0, -0.5 * phase(complex(times(past, past).sum())))
    past, later = times(past, turn), times(later, turn)
    prediction = np.zeros((len(later), len(past)))
    for part, to in ((past.real, later.real), (past.imag, later.imag)):
        size = (part * part).sum()
        if size > FLAT**2 * (np.abs(past) ** 2).sum():
            prediction += to[:, None] * part / size
    return prediction


def _linear_start(net: Network, slopes: Float2) -> Float1:
    """Two rules with equal affine consequents: y_I = slopes x for any firing strengths; `slopes`: (outputs, inputs)."""
    many = np.ones(net.inputs)
    members = initial(net, Start(np.zeros(net.outputs), SPREAD * many, WIDTH * many, 0.0 * many, many))
    rule = np.column_stack([np.zeros(net.outputs), slopes]).ravel()
    first = net.size - net.rules * rule.size
    low, high = np.array([(slot.low, slot.high) for slot in slots(net)[first:]]).T
    return np.concatenate([members[:first], np.clip(np.tile(rule, net.rules), low, high)])
