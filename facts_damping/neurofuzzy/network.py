"""A network of antecedents and consequents: output, gradients with respect to parameters and inputs; compiled.

    mu_ij = membership(x_i),  F_j = prod_i mu_ij,  u_p = sum_j F_j V_jp zeta_jp / sum_j F_j V_jp

(3.6), (3.8), (3.30), (6.5), with V = 1 except for `sam`. Parameters are in one vector: memberships first (input by
input, rule by rule), then consequents (rule by rule, output by output).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from facts_damping.compiling import branching, compiled, entry_point
from facts_damping.compiling.structs import Float1, Float2, Float3, Int1, Struct
from facts_damping.neurofuzzy.consequent import HARMONICS, fourier, fourier_by_input, fourier_terms, harmonics, sam
from facts_damping.neurofuzzy.table import ANTECEDENTS, CONSEQUENT_FUNCTIONS, CONSEQUENTS, MEMBERSHIP_FUNCTIONS

# Arguments: a code, then those of the functions in the tables.
membership, consequent_of = branching(MEMBERSHIP_FUNCTIONS), branching(CONSEQUENT_FUNCTIONS)
SAM, FOURIER = CONSEQUENT_FUNCTIONS.index(sam), CONSEQUENT_FUNCTIONS.index(fourier)
FLOOR = 1e-12  # least sum of firing strengths; below it no rule fires, and the output is zero


class Network(NamedTuple):
    """Shape of a network: codes of functions, numbers of inputs, rules, outputs and parameters, rows of the tables."""

    antecedent: int
    consequent: int
    inputs: int
    rules: int
    outputs: int
    stored: int
    width: int
    antecedent_row: int  # of ANTECEDENTS
    consequent_row: int  # of CONSEQUENTS

    @property
    def size(self) -> int:
        """Number of stored parameters."""
        return self.inputs * self.rules * self.stored + self.rules * self.outputs * self.width


class Pass(Struct):
    """Results of a forward and backward pass."""

    mu: Float2  # (inputs, rules)
    mu_by_x: Float2  # (inputs, rules)
    mu_by_theta: Float3  # (inputs, rules, stored)
    firing: Float1  # (rules,)
    total: Float1  # (outputs,), sum of F V
    zeta: Float2  # (rules, outputs)
    volume: Float2  # (rules, outputs)
    zeta_by_firing: Float2  # (rules, outputs)
    zeta_by_theta: Float3  # (rules, outputs, width)
    zeta_by_x: Float3  # (rules, outputs, inputs)
    output: Float1  # (outputs,)
    by_theta: Float2  # (outputs, parameters)
    by_input: Float2  # (outputs, inputs)
    harmonics: Float3  # (inputs, 5, 2): sines and cosines of the inputs and their derivatives
    terms: Float1  # (5 ** inputs,), for `fourier`


class Passes(Pass, each=Pass):
    """Results of several networks."""


def network(antecedent: str, consequent: str, inputs: int, rules: int, outputs: int) -> Network:
    """The shape of a network with an antecedent and a consequent of the tables."""
    first, second = ANTECEDENTS[antecedent], CONSEQUENTS[consequent]
    codes = MEMBERSHIP_FUNCTIONS.index(first.function), CONSEQUENT_FUNCTIONS.index(second.function)
    rows = list(ANTECEDENTS).index(antecedent), list(CONSEQUENTS).index(consequent)
    return Network(*codes, inputs, rules, outputs, len(first.slots), len(second.slots(inputs)), *rows)


@compiled
def shape_of(row: Int1) -> Network:
    """A network's shape from its row of integers."""
    return Network(row[0], row[1], row[2], row[3], row[4], row[5], row[6], row[7], row[8])


def counted(antecedent: str, consequent: str, inputs: int, rules: int, outputs: int) -> int:
    """Number of parameters updated in one step, as in Table 3.1."""
    consequent_parameters = len(CONSEQUENTS[consequent].slots(inputs))
    return inputs * rules * ANTECEDENTS[antecedent].active + rules * outputs * consequent_parameters


def shapes(net: Network) -> tuple[tuple[int, ...], ...]:
    """Shapes of the arrays of `Pass`."""
    m, n, k = net.inputs, net.rules, net.outputs
    terms = HARMONICS**m if net.consequent == FOURIER else 1
    return (
        *((m, n), (m, n), (m, n, net.stored), (n,), (k,), (n, k), (n, k), (n, k)),
        *((n, k, net.width), (n, k, m), (k,), (k, net.size), (k, m), (m, HARMONICS, 2), (terms,)),
    )


def passes(net: Network) -> Pass:
    """Allocate the arrays of a pass for a network."""
    return Pass(*(np.zeros(shape) for shape in shapes(net)))


@entry_point
def forward(net: Network, theta: Float1, x: Float1, p: Pass) -> None:
    """Compute a network's output at inputs `x` in `p.output`, and intermediate results for gradients in `p`."""
    for j in range(net.rules):
        p.firing[j] = 1.0
        for i in range(net.inputs):
            at = (i * net.rules + j) * net.stored
            parameters = theta[at : at + net.stored]
            p.mu[i, j], p.mu_by_x[i, j] = membership(net.antecedent, parameters, x[i], p.mu_by_theta[i, j])
            p.firing[j] *= p.mu[i, j]
    if net.consequent == FOURIER:
        for i in range(net.inputs):
            harmonics(x[i], p.harmonics[i])
        fourier_terms(p.harmonics[: net.inputs], p.terms[: net.width])
    first = net.inputs * net.rules * net.stored
    for o in range(net.outputs):
        total = weighted = 0.0
        for j in range(net.rules):
            at = first + (j * net.outputs + o) * net.width
            rule = theta[at : at + net.width]
            zeta, volume, by_firing = consequent_of(
                net.consequent, rule, x, p.firing[j], p.terms[: net.width], p.zeta_by_theta[j, o], p.zeta_by_x[j, o]
            )
            p.zeta[j, o], p.volume[j, o], p.zeta_by_firing[j, o] = zeta, volume, by_firing
            total += p.firing[j] * volume
            weighted += p.firing[j] * volume * zeta
        p.total[o] = total
        p.output[o] = weighted / total if total > FLOOR else 0.0


@entry_point
def backward(net: Network, p: Pass) -> None:
    """Gradients of outputs with respect to parameters at the last forward pass, in `p.by_theta`; zero if no rule fires.

    Entries for consequents of other outputs are zero from the start and not written.
    """
    first = net.inputs * net.rules * net.stored
    for o in range(net.outputs):
        p.by_theta[o, :first] = 0.0
        for j in range(net.rules):
            at = first + (j * net.outputs + o) * net.width
            gradient = p.by_theta[o, at : at + net.width]
            if not p.total[o] > FLOOR:  # also if it is NaN
                gradient[:] = 0.0
                continue
            fraction = p.firing[j] * p.volume[j, o] / p.total[o]
            apart = p.zeta[j, o] - p.output[o]
            slopes = p.terms if net.consequent == FOURIER else p.zeta_by_theta[j, o]
            for w in range(gradient.size):
                gradient[w] = fraction * slopes[w]
            if net.consequent == SAM:
                gradient[1] = p.firing[j] * apart / p.total[o]
            by_firing = p.volume[j, o] * apart / p.total[o] + fraction * p.zeta_by_firing[j, o]
            for i in range(net.inputs):
                others = by_firing * _others(net, p, i, j)
                place = (i * net.rules + j) * net.stored
                for s in range(net.stored):
                    p.by_theta[o, place + s] += others * p.mu_by_theta[i, j, s]


@compiled
def _others(net: Network, p: Pass, i: int, j: int) -> float:
    """dF_j / dmu_ij: the product of the rule's other memberships."""
    product = 1.0
    for k in range(net.inputs):
        if k != i:
            product *= p.mu[k, j]
    return product


@entry_point
def by_inputs(net: Network, theta: Float1, p: Pass) -> None:
    """Derivatives of outputs with respect to inputs at the last forward pass, in `p.by_input`; zero if none fires."""
    first = net.inputs * net.rules * net.stored
    p.by_input[:] = 0.0
    for o in range(net.outputs):
        if not p.total[o] > FLOOR:
            continue
        for j in range(net.rules):
            at = first + (j * net.outputs + o) * net.width
            if net.consequent == FOURIER:
                waves = p.harmonics[: net.inputs]
                fourier_by_input(theta[at : at + net.width], waves, p.zeta_by_x[j, o])
            fraction = p.firing[j] * p.volume[j, o] / p.total[o]
            by_firing = p.volume[j, o] * (p.zeta[j, o] - p.output[o]) / p.total[o] + fraction * p.zeta_by_firing[j, o]
            for i in range(net.inputs):
                others = by_firing * _others(net, p, i, j)
                p.by_input[o, i] += others * p.mu_by_x[i, j] + fraction * p.zeta_by_x[j, o, i]
