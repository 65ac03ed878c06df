"""Learnt parameters of neuro-fuzzy controllers and their identifiers, to save and start from."""

from __future__ import annotations

from typing import TYPE_CHECKING

from facts_damping.case.names import controller_names
from facts_damping.control.bank import controller_network
from facts_damping.parameters.run import Controller, Weights
from facts_damping.simulation.assembly import identifier_network

if TYPE_CHECKING:
    from facts_damping.case.model import Case
    from facts_damping.control.bank import BankState
    from facts_damping.control.identifier_model import IdentifierState
    from facts_damping.simulation.tick import Loop


def adapted(
    controller: Controller, index: int, state: BankState | None, identifier: tuple[int, IdentifierState] | None
) -> Weights | None:
    """Learnt parameters of controller `index` and its identifier; None if it does not learn."""
    if controller.scheme is None:
        return None
    weights = learnt = None
    if state is not None:
        weights = state.learner.theta[index, : controller_network(controller).size].tolist()
    if identifier is not None:
        n, identifier_state = identifier
        learnt = identifier_state.learner.theta[n, : identifier_network(controller).size].tolist()
    return Weights(name=controller.name, scheme=controller.scheme, controller=weights, identifier=learnt)


def all_adapted(case: Case, loop: Loop) -> dict[str, Weights]:
    """Learnt parameters of all controllers of a loop, by node name."""
    serving = loop.control.identifiers.controller.tolist()
    by_node = {}
    for i, (name, controller) in enumerate(zip(controller_names(case), case.controllers, strict=True)):
        identifier = (serving.index(i), loop.control.identifier_state) if i in serving else None
        weights = adapted(controller, i, loop.control.bank_state, identifier)
        if weights is not None:
            by_node[name] = weights
    return by_node
