"""Adaptation: gradient descent with momentum, fixed or Lyapunov learning rates, and safety measures; compiled.

    f(k+1) = f(k) + sum_p eta_p ec_p du_p/df + momentum (f(k) - f(k-1))                        (4.2), (6.20)

with ec_p the adaptation error of output p. Momentum applies to consequents only (4.2.1).
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from facts_damping.compiling import compiled, entry_point
from facts_damping.compiling.structs import Float1, Float2, Int1, Int2, Struct
from facts_damping.neurofuzzy.consequent import dot
from facts_damping.neurofuzzy.network import Network, Pass, Passes, backward, forward, network, shapes
from facts_damping.neurofuzzy.start import groups, slots
from facts_damping.signals import Learnings

if TYPE_CHECKING:
    from collections.abc import Sequence


FIXED, LYAPUNOV, LYAPUNOV_GROUPS = 0, 1, 2
RATES = ("fixed", "lyapunov", "lyapunov-groups")  # in order of their codes
REGULAR = 1e-6  # added to denominators of Lyapunov rates: keeps steps bounded if a gradient vanishes


class Rule(NamedTuple):
    """How a network adapts; leakage, clip and projection are off at zero."""

    rate: float  # code of RATES
    eta: float  # learning rate; for Lyapunov rates a factor of the best rate, stable below 2
    momentum: float
    leakage: float  # fraction of the distance to `start` that each step removes (sigma modification)
    clip: float  # longest step, norm over all parameters
    projection: float  # 1: parameters stay within their bounds


class Learner(Struct):
    """Parameters and learning state of a network."""

    theta: Float1  # (parameters,)
    change: Float1  # (parameters,), the last step
    start: Float1  # (parameters,), initial values, target of leakage
    low: Float1  # (parameters,), lower bounds
    high: Float1  # (parameters,), upper bounds
    group: Int1  # (parameters,), index of each parameter's group
    squares: Float2  # (outputs, groups), squared norms of the gradients
    rate: Float2  # (outputs, groups), learning rates of the last step
    moved: Float1  # (outputs,), change of the outputs by the last step, to first order
    x: Float1  # (inputs,)
    passed: Pass


class Learners(Learner, each=Learner):
    """Several learners in arrays sized for the largest."""

    passed: Passes
    shape: Int2  # (networks, fields of Network)

    def _row(self, i: int) -> Learner:
        net = Network(*self.shape[i].tolist())
        fields = [value[i] for value in self if isinstance(value, np.ndarray)]
        sized = [value[: net.size] for value in fields[:6]]
        values = (*sized, *fields[6:9], fields[9][: net.inputs], self.passed.each[i])
        return Learner(**dict(zip(Learner._fields, values, strict=True)))


def learners(nets: Sequence[Network], starts: Sequence[Float1]) -> Learners:
    """Build the learners of several networks, in arrays sized for the largest."""
    sized = list(nets) or [network("gaussian", "singleton", 1, 1, 1)]  # the arrays are empty if there are no networks

    def room(shape: Sequence[tuple[int, ...]]) -> Float1:
        return np.zeros((len(nets), *(max(sizes) for sizes in zip(*shape, strict=True))))

    sizes = [(net.size,) for net in sized]
    kinds = [(net.outputs, len(groups(net))) for net in sized]
    stacked = Learners(
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
        parameter_slots, names = slots(net), groups(net)
        stacked.theta[i, : net.size] = stacked.start[i, : net.size] = start
        stacked.low[i, : net.size] = [slot.low for slot in parameter_slots]
        stacked.high[i, : net.size] = [slot.high for slot in parameter_slots]
        stacked.group[i, : net.size] = [names.index(slot.group) for slot in parameter_slots]
    return stacked


@compiled
def infer(net: Network, learner: Learner) -> None:
    """Compute output and gradients with respect to parameters at `learner.x`; result in `learner.passed`."""
    forward(net, learner.theta, learner.x, learner.passed)
    backward(net, learner.passed)


@compiled
def _rates(net: Network, learner: Learner, rule: Rule, curvature: Float1) -> None:
    """Compute the learning rates of each output and group in `learner.rate`.

    Lyapunov: eta / (curvature_p |du_p/df|^2), half of the stability bound of |e|, (4.36), (4.39), (5.27); with
    several outputs on shared parameters eta / (sum_p sqrt(curvature_p) |du_p/df|)^2. `lyapunov-groups` uses the norm
    of each group separately, as in the thesis; with G groups a step then multiplies the error by 1 - G eta.
    """
    if rule.rate == FIXED:
        learner.rate[:] = rule.eta
        return
    learner.squares[:] = 0.0
    antecedents = net.inputs * net.rules * net.stored
    for o in range(net.outputs):
        if rule.rate == LYAPUNOV_GROUPS:
            for f in range(learner.theta.size):
                learner.squares[o, learner.group[f]] += learner.passed.by_theta[o, f] ** 2
            continue
        slopes = learner.passed.by_theta[o]
        total = dot(0.0, slopes[:antecedents], slopes[:antecedents])
        for j in range(net.rules):
            at = antecedents + (j * net.outputs + o) * net.width
            total = dot(total, slopes[at : at + net.width], slopes[at : at + net.width])
        learner.squares[o, 0] = total
    for g in range(learner.rate.shape[1]):
        root = 0.0
        for o in range(net.outputs):
            root += math.sqrt(curvature[o] * learner.squares[o, g if rule.rate == LYAPUNOV_GROUPS else 0])
        for o in range(net.outputs):
            learner.rate[o, g] = rule.eta / (root * root + REGULAR)


@entry_point
def learn(net: Network, learner: Learner, rule: Rule, error: Float1, curvature: Float1) -> None:
    """Run one step of adaptation with the gradients of the last pass.

    `error`: (outputs,), ec_p; `curvature`: (outputs,), sum_q J_qp^2 + hbar_p, for Lyapunov rates.
    """
    _rates(net, learner, rule, curvature)
    antecedents = net.inputs * net.rules * net.stored
    for f in range(antecedents):
        learner.change[f] = 0.0
        for o in range(net.outputs):
            learner.change[f] += learner.rate[o, learner.group[f]] * error[o] * learner.passed.by_theta[o, f]
    for j in range(net.rules):
        for o in range(net.outputs):
            at = antecedents + (j * net.outputs + o) * net.width
            change, slope = learner.change[at : at + net.width], learner.passed.by_theta[o, at : at + net.width]
            if rule.rate == LYAPUNOV_GROUPS:
                for f in range(net.width):
                    change[f] = learner.rate[o, learner.group[at + f]] * error[o] * slope[f] + rule.momentum * change[f]
                continue
            by = learner.rate[o, 0] * error[o]  # one rate for all groups
            for f in range(net.width):
                change[f] = by * slope[f] + rule.momentum * change[f]
    total = dot(0.0, learner.change, learner.change)
    fraction = 1.0
    if rule.clip > 0.0 and total > rule.clip * rule.clip:
        fraction = rule.clip / math.sqrt(total)
    _move(learner, rule, fraction)
    for o in range(net.outputs):
        learner.moved[o] = dot(0.0, learner.passed.by_theta[o, :antecedents], learner.change[:antecedents])
        for j in range(net.rules):
            at = antecedents + (j * net.outputs + o) * net.width
            end = at + net.width
            learner.moved[o] = dot(learner.moved[o], learner.passed.by_theta[o, at:end], learner.change[at:end])


@compiled
def _move(learner: Learner, rule: Rule, fraction: float) -> None:
    """Move the parameters by a fraction of `learner.change`, and store the actual change there."""
    for f in range(learner.theta.size):
        before = learner.theta[f]
        after = before + fraction * learner.change[f] - rule.leakage * (before - learner.start[f])
        if rule.projection > 0.0:
            after = min(max(after, learner.low[f]), learner.high[f])
        learner.theta[f] = after
        learner.change[f] = after - before


@entry_point
def write_learning(
    net: Network,
    learner: Learner,
    lyapunov: Float1,
    tick: int,
    controller: int,
    identifier: int,
    out: Learnings,
    first: int,
) -> int:
    """Write LEARNING rows to `out` from `first` on; returns the index after the last. `lyapunov`: V, its decrease."""
    groups = (
        learner.group[learner.group.size - 1] + 1
    )  # groups are numbered in order of appearance: the last has the highest number
    for o in range(net.outputs):
        for g in range(groups):
            row = out[first]
            row.tick, row.controller, row.identifier = tick, controller, identifier
            row.output, row.group, row.rate = o, g, learner.rate[o, g]
            row.lyapunov, row.fall = lyapunov[0], lyapunov[1]
            first += 1
    return first
