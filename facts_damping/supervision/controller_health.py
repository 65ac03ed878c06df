"""A controller's health for its supervisor, read from the controller's state; compiled. Nodes get it by messages."""

from __future__ import annotations

import math
from typing import Any

from facts_damping.compiling import compiled, entry_point
from facts_damping.control.bank import Bank, BankState
from facts_damping.control.inputs import UNSET
from facts_damping.neurofuzzy.network import shape_of
from facts_damping.supervision.model import SupervisorRows


@compiled
def read_health(bank: Bank, state: BankState, c: int, found: Any) -> None:
    """Write the health of controller c to `found`: outputs finite, parameter norm, Lyapunov function and its fall."""
    found.finite = 1
    for d in range(bank.device.shape[1]):
        if bank.device[c, d] != UNSET and not math.isfinite(state.unlimited[c, d]):
            found.finite = 0
    net, total = shape_of(bank.shape[c]), 0.0
    size = net.inputs * net.rules * net.stored + net.rules * net.outputs * net.width
    groups = 1 + state.learner.group[c, size - 1] if net.rules > 0 else 0
    for g in range(groups):
        square = 0.0
        for f in range(size):
            if state.learner.group[c, f] == g:
                square += state.learner.theta[c, f] ** 2
        norm = math.sqrt(square)
        total += norm * norm
    found.norm = math.sqrt(total)
    found.lyapunov, found.fall = state.memory.lyapunov[c, 0], state.memory.lyapunov[c, 1]


@entry_point
def controller_health(bank: Bank, state: BankState, c: int, found: SupervisorRows, at: int) -> None:
    """Write the health of controller c into row `at` of SUPERVISOR."""
    read_health(bank, state, c, found[at])
