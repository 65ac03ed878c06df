"""Topics that all nodes of a graph share, and the prefix under which a node finds its graph's topics."""

from __future__ import annotations

from typing import TYPE_CHECKING

from facts_damping.errors import InputError

if TYPE_CHECKING:
    from rclpy.node import Node

    from facts_damping.case.names import Address

FRAMES = "pmu/frames"
PLANT_STATE = "plant/state"  # its publisher is the plant
DIAGNOSTICS = "/diagnostics"  # global topic
RUN_STATE = "run/state"  # published by the plant
CHANGES = "run/changes"  # published by every node of a graph: its changes during the run
REFUSALS = "security/refused"  # published by every node of a graph
SHARED = (DIAGNOSTICS, CHANGES, REFUSALS)  # name endings of topics with many publishers


def graph_prefix(node: Node, address: Address) -> str:
    """Prefix of the graph's own topics as seen from a node: empty in the graph's namespace, else that namespace.

    Raises `InputError` if the node is not in the namespace that the run assigns to it.
    """
    space = node.get_namespace()
    if address.namespace and not space.endswith(f"/{address.namespace}"):
        raise InputError(f"namespace: {space} given; allowed: one that ends with /{address.namespace} (-r __ns:=...)")
    return space.removesuffix(address.namespace) if address.namespace else ""
