"""Adaptation: gradient descent with momentum, fixed or Lyapunov learning rates, and guards; compiled.

    f(k+1) = f(k) + sum_p eta_p ec_p du_p/df + momentum (f(k) - f(k-1))                        (4.2), (6.20)

with ec_p the adaptation error of output p. Momentum is for consequents only (4.2.1).
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from facts_damping.compiling import compiled, entry_point
from facts_damping.compiling.structs import Float1, Float2, Float3, Int1, Int2, Struct
from facts_damping.neurofuzzy.consequent import dot
from facts_damping.neurofuzzy.network import Network, Pass, Passes, backward, forward, network, shapes
from facts_damping.neurofuzzy.start import groups, slots
from facts_damping.signals import Learnings

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

FIXED, LYAPUNOV, LYAPUNOV_GROUPS = 0, 1, 2
RATES = ("fixed", "lyapunov", "lyapunov-groups")  # by their codes
REGULAR = 1e-6  # added to the denominators of Lyapunov rates: a vanishing gradient gives no jump


class Rule(NamedTuple):
    """How a network adapts; the guards are off at zero."""

    rate: float  # code of RATES
    eta: float  # learning rate; with Lyapunov rates its share of the best one, stable below 2
    momentum: float
    leakage: float  # share of the way back to the start that parameters go at each step (sigma modification)
    clip: float  # longest step, as norm over all parameters
    projection: float  # 1: parameters stay within their bounds


class Learner(Struct):
    """A network with all that changes as it learns."""

    theta: Float1  # (parameters,)
    change: Float1  # (parameters,), the last step
    start: Float1  # (parameters,), where leakage leads to
    low: Float1  # (parameters,)
    high: Float1  # (parameters,)
    group: Int1  # (parameters,), index of each parameter's group
    squares: Float2  # (outputs, groups), squared norms of the gradients
    rate: Float2  # (outputs, groups), learning rates of the last step
    moved: Float1  # (outputs,), what the last step changes the outputs by, to first order
    x: Float1  # (inputs,)
    passed: Pass


class Learners(Struct, each=Learner):
    """Several of them side by side, in arrays that hold the largest."""

    theta: Float2
    change: Float2
    start: Float2
    low: Float2
    high: Float2
    group: Int2
    squares: Float3
    rate: Float3
    moved: Float2
    x: Float2
    passed: Passes
    shape: Int2  # (networks, fields of Network)

    def _row(self, i: int) -> Learner:
        """The i-th one, as views of its size."""
        net = Network(*self.shape[i].tolist())
        own = [value[i] for value in self if isinstance(value, np.ndarray)]
        sized = [value[: net.size] for value in own[:6]]
        values = (*sized, *own[6:9], own[9][: net.inputs], Pass(*(value[i] for value in self.passed)))
        return Learner(**dict(zip(Learner._fields, values, strict=True)))


def learners(nets: Sequence[Network], starts: Sequence[NDArray[np.float64]]) -> Learners:
    """Learners of several networks, side by side in arrays that hold the largest."""
    sized = list(nets) or [network("gaussian", "singleton", 1, 1, 1)]  # without any the arrays are empty

    def room(shape: Sequence[tuple[int, ...]]) -> NDArray[np.float64]:
        return np.zeros((len(nets), *(max(sizes) for sizes in zip(*shape, strict=True))))

    sizes = [(net.size,) for net in sized]
    kinds = [(net.outputs, len(groups(net))) for net in sized]
    made = Learners(
        theta=room(sizes),
        change=room(sizes),
        start=room(sizes),
        low=room(sizes),
        high=room(sizes),
        group=room(sizes).astype(np.int64),
        squares=room(kinds),
        rate=room(kinds),
        moved=room([(net.outputs,) for net in sized]),
        x=room([(net.inputs,) for net in sized]),
        passed=Passes(*(room(shape) for shape in zip(*(shapes(net) for net in sized), strict=True))),
        shape=np.array(nets, np.int64).reshape(len(nets), len(Network._fields)),
    )
    for i, (net, start) in enumerate(zip(nets, starts, strict=True)):
        own, names = slots(net), groups(net)
        made.theta[i, : net.size] = made.start[i, : net.size] = start
        made.low[i, : net.size] = [slot.low for slot in own]
        made.high[i, : net.size] = [slot.high for slot in own]
        made.group[i, : net.size] = [names.index(slot.group) for slot in own]
    return made


@compiled
def infer(net: Network, own: Learner) -> None:
    """Output and its gradients by the parameters at the inputs `own.x`, into `own.passed`."""
    forward(net, own.theta, own.x, own.passed)
    backward(net, own.passed)


@compiled
def _rates(net: Network, own: Learner, rule: Rule, curvature: NDArray[np.float64]) -> None:
    """Learning rates of each output and group, into `own.rate`.

    Lyapunov: eta / (curvature_p |du_p/df|^2), half of the bound below which |e| falls, (4.36), (4.39), (5.27); with
    several outputs on shared parameters eta / (sum_p sqrt(curvature_p) |du_p/df|)^2. `lyapunov-groups` takes the
    norm of each group by itself, as the thesis prints it; with G groups the error's factor is then 1 - G eta.
    """
    if rule.rate == FIXED:
        own.rate[:] = rule.eta
        return
    own.squares[:] = 0.0
    antecedents = net.inputs * net.rules * net.stored
    for o in range(net.outputs):
        if rule.rate == LYAPUNOV_GROUPS:
            for f in range(own.theta.size):
                own.squares[o, own.group[f]] += own.passed.by_theta[o, f] ** 2
            continue
        total = _square(0.0, own.passed.by_theta[o], 0, antecedents)
        for j in range(net.rules):
            at = antecedents + (j * net.outputs + o) * net.width
            total = _square(total, own.passed.by_theta[o], at, at + net.width)
        own.squares[o, 0] = total
    for g in range(own.rate.shape[1]):
        root = 0.0
        for o in range(net.outputs):
            root += math.sqrt(curvature[o] * own.squares[o, g if rule.rate == LYAPUNOV_GROUPS else 0])
        for o in range(net.outputs):
            own.rate[o, g] = rule.eta / (root * root + REGULAR)


@entry_point
def learn(
    net: Network,
    own: Learner,
    rule: Rule,
    error: Float1,
    curvature: Float1,
) -> None:
    """One step of adaptation by the gradients of the last pass.

    `error`: (outputs,), ec_p; `curvature`: (outputs,), sum_q J_qp^2 + hbar_p of the Lyapunov rates.
    """
    _rates(net, own, rule, curvature)
    antecedents = net.inputs * net.rules * net.stored
    for f in range(antecedents):
        own.change[f] = 0.0
        for o in range(net.outputs):
            own.change[f] += own.rate[o, own.group[f]] * error[o] * own.passed.by_theta[o, f]
    for j in range(net.rules):
        for o in range(net.outputs):
            at = antecedents + (j * net.outputs + o) * net.width
            change, slope = own.change[at : at + net.width], own.passed.by_theta[o, at : at + net.width]
            if rule.rate == LYAPUNOV_GROUPS:
                for f in range(net.width):
                    change[f] = own.rate[o, own.group[at + f]] * error[o] * slope[f] + rule.momentum * change[f]
                continue
            by = own.rate[o, 0] * error[o]  # one rate for all
            for f in range(net.width):
                change[f] = by * slope[f] + rule.momentum * change[f]
    total = _square(0.0, own.change, 0, own.change.size)
    share = 1.0
    if rule.clip > 0.0 and total > rule.clip * rule.clip:
        share = rule.clip / math.sqrt(total)
    _move(own, rule, share)
    for o in range(net.outputs):
        own.moved[o] = dot(0.0, own.passed.by_theta[o, :antecedents], own.change[:antecedents])
        for j in range(net.rules):
            at = antecedents + (j * net.outputs + o) * net.width
            end = at + net.width
            own.moved[o] = dot(own.moved[o], own.passed.by_theta[o, at:end], own.change[at:end])


@compiled
def _square(start: float, a: NDArray[np.float64], first: int, end: int) -> float:
    """`start` and the squared norm of a part."""
    return dot(start, a[first:end], a[first:end])


@compiled
def _move(own: Learner, rule: Rule, share: float) -> None:
    """Move the parameters by a share of `own.change`, and write there by how much they did."""
    for f in range(own.theta.size):
        before = own.theta[f]
        after = before + share * own.change[f] - rule.leakage * (before - own.start[f])
        if rule.projection > 0.0:
            after = min(max(after, own.low[f]), own.high[f])
        own.theta[f] = after
        own.change[f] = after - before


@entry_point
def write_learning(
    net: Network,
    own: Learner,
    lyapunov: Float1,
    tick: int,
    controller: int,
    identifier: int,
    out: Learnings,
    first: int,
) -> int:
    """Rows of LEARNING into `out` from `first` on; the index after the last. `lyapunov`: the function and its fall."""
    groups = own.group[own.group.size - 1] + 1  # they are numbered as they appear: the last one's last
    for o in range(net.outputs):
        for g in range(groups):
            row = out[first]
            row.tick, row.controller, row.identifier = tick, controller, identifier
            row.output, row.group, row.rate = o, g, own.rate[o, g]
            row.lyapunov, row.fall = lyapunov[0], lyapunov[1]
            first += 1
    return first
