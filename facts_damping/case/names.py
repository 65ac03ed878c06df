"""Names and namespaces of a case's controllers, identifiers, supervisors and links as ROS nodes, and their topics."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from facts_damping.parameters.files import is_path
from facts_damping.parameters.run import Run

if TYPE_CHECKING:
    from facts_damping.case.model import Case

SUPERVISED = "supervised"  # topic of a supervisor's setpoints: passed on or its own


def controller_names(case: Case) -> list[str]:
    """Node names of the controllers: index in the run and kind, `controller_0_LLC`."""
    return [f"controller_{c}_{ros_name(controller.name)}" for c, controller in enumerate(case.run.controllers)]


def identifier_names(case: Case) -> dict[int, str]:
    """Node names of the identifiers by the index of their controller: `identifier_0_ANFTSI`."""
    return {
        c: f"identifier_{c}_{controller.parameters['identifier']}"
        for c, controller in enumerate(case.controllers)
        if controller.scheme == "indirect"
    }


def supervisor_names(case: Case) -> dict[int, str]:
    """Node names of the supervisors by the index of their controller: `supervisor_0_LLC`."""
    if case.supervision is None:
        return {}
    rows = enumerate(case.run.controllers)
    return {c: f"supervisor_{c}_{ros_name(row.name)}" for c, row in rows if row.fallback_of is None}


class Address(NamedTuple):
    """A node's address: namespace relative to the graph's (empty: the graph's own), and name."""

    namespace: str
    name: str

    def __str__(self) -> str:
        """Namespace and name, relative to the graph's namespace."""
        return self.topic(self.name)

    def topic(self, name: str) -> str:
        """A topic in this namespace, relative to the graph's."""
        return f"{self.namespace}/{name}" if self.namespace else name


def controller_addresses(case: Case) -> list[Address]:
    """Addresses of the controllers: `area_1/controller_0_LLC`; without a namespace `controller_0_LLC`."""
    names = controller_names(case)
    return [Address(c.namespace or "", name) for c, name in zip(case.run.controllers, names, strict=True)]


def identifier_addresses(case: Case) -> dict[int, Address]:
    """Addresses of the identifiers, in the namespaces of their controllers."""
    controllers = controller_addresses(case)
    return {c: Address(controllers[c].namespace, name) for c, name in identifier_names(case).items()}


def supervisor_addresses(case: Case) -> dict[int, Address]:
    """Addresses of the supervisors, in the namespaces of their controllers."""
    controllers = controller_addresses(case)
    return {c: Address(controllers[c].namespace, name) for c, name in supervisor_names(case).items()}


class SetpointSender(NamedTuple):
    """The node whose setpoints act for a controller: the controller itself or its supervisor."""

    name: str  # node name as in messages
    place: str  # node address relative to the graph's namespace
    topic: str


def setpoint_senders(case: Case) -> dict[int, SetpointSender]:
    """By the index of the controller. Fallbacks are left out: they send setpoints only to a supervisor."""
    names, places, supervisors = controller_names(case), controller_addresses(case), supervisor_addresses(case)
    return {
        c: SetpointSender(supervisors[c].name, str(supervisors[c]), f"{supervisors[c]}/{SUPERVISED}")
        if c in supervisors
        else SetpointSender(names[c], str(places[c]), f"{places[c]}/setpoints")
        for c, controller in enumerate(case.run.controllers)
        if controller.fallback_of is None
    }


def acting(case: Case, c: int) -> int:
    """Index of the controller under whose name the setpoints of controller c act; differs for a fallback."""
    primary = case.run.controllers[c].fallback_of
    return c if primary is None else primary


def link_addresses(case: Case) -> list[Address]:
    """Addresses of the links: the run's in the graph's namespace, a controller's own in a namespace of its own.

    That is the controller's namespace, or one named after the controller if the namespace is shared or empty.
    """
    controllers = controller_addresses(case)
    crowd = Counter(address.namespace for address in controllers)
    with_own_link = [c for c, controller in enumerate(case.run.controllers) if controller.link is not None]
    places = [""] if len(case.links) > len(with_own_link) else []
    for c in with_own_link:
        alone = controllers[c].namespace and crowd[controllers[c].namespace] == 1
        places.append(controllers[c].namespace if alone else str(controllers[c]))
    return [Address(place, "wan_link") for place in places]


def replaceable(case: Case) -> list[str]:
    """Nodes of a graph that another may replace while it runs: links, controllers, identifiers, supervisors."""
    several = (link_addresses(case), controller_addresses(case))
    addresses = (identifier_addresses(case).values(), supervisor_addresses(case).values())
    return [str(address) for group in (*several, *addresses) for address in group]


def recorded_topic(topic: str) -> str:
    """Topic of the recorded setpoints in a replay."""
    return f"recorded/{topic}"


def ros_name(kind: str) -> str:
    """A kind's name with letters, digits and underscores only, as ROS names require; without a tuned law's file."""
    return "".join(letter if letter.isalnum() else "_" for letter in kind.partition("@")[0])


def served(case: Case, link: int) -> list[int]:
    """Controllers that receive from a link; fallbacks among them send nothing back over it."""
    return [c for c, used in enumerate(case.used_links) if used == link]


def setpoint_topics(case: Case) -> dict[str, tuple[str, list[int]]]:
    """Sender and controllers of the setpoints on each topic; the sender is empty on topics of links."""
    topics = {
        f"{address}/setpoints": (name, [c])
        for c, (name, address) in enumerate(zip(controller_names(case), controller_addresses(case), strict=True))
    }
    topics |= {f"{address}/{SUPERVISED}": (address.name, [c]) for c, address in supervisor_addresses(case).items()}
    links = enumerate(link_addresses(case))
    return topics | {link.topic("setpoints/delivered"): ("", served(case, i)) for i, link in links}


def listeners(case: Case, link: int) -> int:
    """Number of nodes that receive a link's deliveries: controllers, their identifiers and supervisors."""
    controllers = served(case, link)
    return len(controllers) + sum(c in controllers for c in [*identifier_names(case), *supervisor_names(case)])


def asked_label(asked: dict[str, Any]) -> str:
    """Label of a run by its `asked` fields, which may be partial."""
    return label(Run.model_validate(asked).model_dump())


def label(run: dict[str, Any]) -> str:
    """Short name of a run: system, scenario, controllers, links, and the measurement if not ideal."""
    links = [run["link"] if c.get("link") is None else c["link"] for c in run["controllers"]] or [run["link"]]
    parts = [
        [run["system"]],
        [run["scenario"]],
        [c["name"] for c in run["controllers"]] or ["none"],
        links if any(c.get("link") is not None for c in run["controllers"]) else links[:1],
    ]
    if run.get("measurement", "ideal") != "ideal":
        parts.append([run["measurement"]])
    return "-".join("+".join(map(_short, part)) for part in parts).replace("/", "_")


def _short(choice: Any) -> str:
    """A name, the end of a path, an inline item's `name`, the kinds of events."""
    if isinstance(choice, list):
        return "+".join(dict.fromkeys(event["kind"] for event in choice)) or "steady"
    if isinstance(choice, str):
        if not is_path(choice):
            return choice
        parts = [part for part in Path(choice).parts if part.strip("./")]
        return "_".join(parts[-2:]).removesuffix(".yaml").removesuffix(".yml")
    return choice.get("name") or "custom"
