"""Topics that all nodes of a graph share, and where a node finds those of its graph."""

from __future__ import annotations

from typing import TYPE_CHECKING

from facts_damping.errors import InputError

if TYPE_CHECKING:
    from rclpy.node import Node

    from facts_damping.case.names import Address

COMMON = "/diagnostics"  # everybody's topic
STATE = "run/state"  # the plant's
CHANGES = "run/changes"  # of every node of a graph: what was changed in it while it went on
TOPIC = "security/refused"  # of every node of a graph: what it has refused
OF_ALL = (COMMON, CHANGES, TOPIC)  # ends of topics that many nodes publish


def graph_prefix(node: Node, address: Address) -> str:
    """What leads from a node to the graph's own topics: nothing in the graph's namespace, else that namespace.

    Raises `InputError` where the node is not in the namespace that the run gives it.
    """
    own = node.get_namespace()
    if address.namespace and not own.endswith(f"/{address.namespace}"):
        raise InputError(f"namespace: {own} given; allowed: one that ends with /{address.namespace} (-r __ns:=...)")
    return own.removesuffix(address.namespace) if address.namespace else ""
