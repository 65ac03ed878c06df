"""Names and places of a case's controllers, identifiers and links as ROS nodes, and of their topics."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from facts_damping.parameters.files import is_path
from facts_damping.parameters.run import Run

SUPERVISED = "supervised"  # topic of what a supervisor passes on or says

if TYPE_CHECKING:
    from facts_damping.case.model import Case


def controller_names(case: Case) -> list[str]:
    """Names of the controllers as nodes: their place in the run and their kind, `controller_0_LLC`."""
    return [f"controller_{c}_{re_name(controller.name)}" for c, controller in enumerate(case.run.controllers)]


def identifier_names(case: Case) -> dict[int, str]:
    """Names of the identifiers as nodes, by the index of the controller that each serves: `identifier_0_ANFTSI`."""
    return {
        c: f"identifier_{c}_{controller.parameters['identifier']}"
        for c, controller in enumerate(case.controllers)
        if controller.scheme == "indirect"
    }


def supervisor_names(case: Case) -> dict[int, str]:
    """Names of the supervisors as nodes, by the index of the controller of each: `supervisor_0_LLC`."""
    if case.supervision is None:
        return {}
    rows = enumerate(case.run.controllers)
    return {c: f"supervisor_{c}_{re_name(one.name)}" for c, one in rows if one.fallback_of is None}


class Address(NamedTuple):
    """A node's place: a namespace below that of the graph (empty: the graph's own), and its name."""

    namespace: str
    name: str

    def __str__(self) -> str:
        """Both, as seen from the graph's namespace."""
        return self.topic(self.name)

    def topic(self, name: str) -> str:
        """A topic in its namespace, as seen from the graph's."""
        return f"{self.namespace}/{name}" if self.namespace else name


def controller_addresses(case: Case) -> list[Address]:
    """Places of the controllers: `area_1/controller_0_LLC`, without a namespace `controller_0_LLC`."""
    names = controller_names(case)
    return [Address(c.namespace or "", name) for c, name in zip(case.run.controllers, names, strict=True)]


def identifier_addresses(case: Case) -> dict[int, Address]:
    """Places of the identifiers, beside the controllers that they serve."""
    controllers = controller_addresses(case)
    return {c: Address(controllers[c].namespace, name) for c, name in identifier_names(case).items()}


def supervisor_addresses(case: Case) -> dict[int, Address]:
    """Places of the supervisors, beside the controllers that they supervise."""
    controllers = controller_addresses(case)
    return {c: Address(controllers[c].namespace, name) for c, name in supervisor_names(case).items()}


class Speaker(NamedTuple):
    """Whose setpoints act for a controller: its own, or those of its supervisor."""

    name: str  # as messages have it
    place: str  # of its node, as seen from the graph's namespace
    topic: str


def speakers(case: Case) -> dict[int, Speaker]:
    """By the index of the controller; a fallback speaks to a supervisor alone."""
    names, places, supervisors = controller_names(case), controller_addresses(case), supervisor_addresses(case)
    return {
        c: Speaker(supervisors[c].name, str(supervisors[c]), f"{supervisors[c]}/{SUPERVISED}")
        if c in supervisors
        else Speaker(names[c], str(places[c]), f"{places[c]}/setpoints")
        for c, controller in enumerate(case.run.controllers)
        if controller.fallback_of is None
    }


def acting(case: Case, c: int) -> int:
    """The controller by whose name setpoints act on the devices of controller c: of a fallback another one's."""
    given = case.run.controllers[c].fallback_of
    return c if given is None else given


def link_addresses(case: Case) -> list[Address]:
    """Places of the links: the run's in the graph's namespace, a controller's own in one that no other node shares.

    That is its controller's namespace, or one by its controller's name where others are in that, or there is none.
    """
    controllers = controller_addresses(case)
    crowd = Counter(address.namespace for address in controllers)
    own = [c for c, controller in enumerate(case.run.controllers) if controller.link is not None]
    places = [""] if len(case.links) > len(own) else []
    for c in own:
        alone = controllers[c].namespace and crowd[controllers[c].namespace] == 1
        places.append(controllers[c].namespace if alone else str(controllers[c]))
    return [Address(place, "wan_link") for place in places]


def recorded_topic(topic: str) -> str:
    """The topic, in a replay, of what was recorded of one with setpoints."""
    return f"recorded/{topic}"


def re_name(kind: str) -> str:
    """A kind's name as a ROS name: letters, digits and underscores."""
    return "".join(letter if letter.isalnum() else "_" for letter in kind)


def served(case: Case, link: int) -> list[int]:
    """The controllers that use a link, on the way up: those of them that are a fallback say nothing on the way down."""
    return [c for c, used in enumerate(case.used_links) if used == link]


def listeners(case: Case, link: int) -> int:
    """How many nodes hear what a link delivers: controllers, their identifiers and supervisors."""
    own = served(case, link)
    return len(own) + sum(c in own for c in [*identifier_names(case), *supervisor_names(case)])


def asked_label(asked: dict[str, Any]) -> str:
    """The same of a run as it was asked for, perhaps in part."""
    return label(Run.model_validate(asked).model_dump())


def label(run: dict[str, Any]) -> str:
    """A short name of a run: system, scenario, controllers, links, and how it is measured where that is not ideal."""
    links = [run["link"] if c.get("link") is None else c["link"] for c in run["controllers"]] or [run["link"]]
    parts = [
        [run["system"]],
        [run["scenario"]],
        [c["name"] for c in run["controllers"]] or ["none"],
        links if any(c.get("link") is not None for c in run["controllers"]) else links[:1],
    ]
    if run.get("measurement", "ideal") != "ideal":
        parts.append([run["measurement"]])
    return "-".join("+".join(map(_word, part)) for part in parts).replace("/", "_")


def _word(given: Any) -> str:
    """What was given by name, of a path its end; what stands inline by its own name, events by their kinds."""
    if isinstance(given, list):
        return "+".join(dict.fromkeys(event["kind"] for event in given)) or "steady"
    if isinstance(given, str):
        if not is_path(given):
            return given
        parts = [part for part in Path(given).parts if part.strip("./")]
        return "_".join(parts[-2:]).removesuffix(".yaml").removesuffix(".yml")
    return given.get("name") or "custom"
