"""The parts of a case: plant, links, controllers and identifiers, built; their names as nodes; its events."""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from facts_damping.control.bank import Bank, BankState, bank, settings
from facts_damping.control.identifier import Identified, Identifiers, IdentifierState, identifiers
from facts_damping.errors import InputError
from facts_damping.link.transfer import Links, links
from facts_damping.parameters.run import Weights
from facts_damping.plant.build import Built, build
from facts_damping.plant.events import timeline
from facts_damping.sensitivity import Sensitivity, sensitivities

if TYPE_CHECKING:
    from facts_damping.configuration import Case


def commands(case: Case) -> int:
    """Number of setpoints that all controllers of a case give at one arrival."""
    return sum(len(controller.devices) for controller in case.controllers)


def derivatives(case: Case) -> int:
    """Number of derivatives that all identifiers of a case estimate."""
    return sum(len(c.devices) * len(c.signals) for c in case.controllers if c.scheme == "indirect")


def build_plant(case: Case) -> Built:
    """The plant of a case, at its equilibrium."""
    return build(case.system, case.run.devices, case.scenario.events)


def build_links(case: Case) -> Links:
    """The links of a case, with nothing under way."""
    stations, devices = len(case.system.stations), len(case.run.devices)
    return links(case.links, case.used_links, stations, devices, commands(case), case.run.frame_rate)


def build_control(
    case: Case, known: dict[tuple[str, str], Sensitivity] | None = None
) -> tuple[Bank, BankState, Identifiers, IdentifierState]:
    """Controllers and identifiers of a case; `known`: its sensitivities, where they are at hand.

    Raises `InputError` where the sign of a neuro-fuzzy controller's sensitivity is not the plant's.
    """
    devices = [next(d for d in case.system.devices if d.name == name) for name in case.run.devices]
    limits = {d.name: (d.v_max, d.rate_max) for d in devices}
    stations = [station.name for station in case.system.stations]
    if known is None and any(c.scheme for c in case.controllers):
        start = build(case.system, case.run.devices, [])
        known = sensitivities(start, case.system, case.run.devices, case.run.frame_rate)
    known = known or {}
    signs = _signs(case, known)
    rate = case.run.frame_rate
    made, state = bank(case.controllers, case.system.signals, stations, limits, rate, signs)
    rows = [
        Identified(
            i,
            settings(c),
            str(c.parameters["identifier"]),
            c.signals,
            [case.run.devices.index(device) for device in c.devices],
            [limits[device][0] for device in c.devices],
            np.array([[known[s, d].sign * abs(known[s, d].frame) for d in c.devices] for s in c.signals]),
            np.array(c.weights.identifier) if isinstance(c.weights, Weights) and c.weights.identifier else None,
        )
        for i, c in enumerate(case.controllers)
        if c.scheme == "indirect"
    ]
    return made, state, *identifiers(rows, case.system.signals, stations, rate)


def _signs(case: Case, known: dict[tuple[str, str], Sensitivity]) -> dict[tuple[str, str], float]:
    """Signs of dy/du for all signals and devices of neuro-fuzzy controllers."""
    signs = {}
    for i, c in enumerate(case.controllers):
        for signal in c.signals if c.scheme else ():
            for device in c.devices:
                here = f"controllers.{i}.parameters.sensitivity"
                if (signal, device) not in known:
                    raise InputError(f"{here}: the plant has no swing mode; allowed: a controller without adaptation")
                plant, given = known[signal, device], float(c.parameters["sensitivity"])
                why = (
                    f"the residue from {device} to {signal} at the least damped mode ({plant.frequency_hz:.2f} Hz) "
                    f"has an angle of {plant.angle_deg:.0f} degrees"
                )
                if plant.sign == 0.0:
                    raise InputError(f"{here}: none fits; {why}, near neither 0 nor 180; allowed: another signal")
                if given not in (0.0, plant.sign):
                    raise InputError(f"{here}: {given:g} given; allowed: {plant.sign:g} (or 0, to take it): {why}")
                signs[signal, device] = plant.sign
    return signs


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


def re_name(kind: str) -> str:
    """A kind's name as a ROS name: letters, digits and underscores."""
    return "".join(letter if letter.isalnum() else "_" for letter in kind)


def grid_events(case: Case) -> list[dict[str, Any]]:
    """All changes of the grid in order of time, as they are published: time_ns, kind, element, value, location."""
    found = []
    for change in timeline(case.scenario.events):
        row = change.event.model_dump()
        element = next(row[key] for key in ("line", "bus", "load", "machine") if row.get(key) is not None)
        on_line = row["kind"] == "fault" and row.get("line") is not None
        found.append(
            {
                "time_ns": change.time_ns,
                "kind": row["kind"],
                "element": element,
                "value": row.get("change", float("nan")),
                "location": row["location"] if on_line else float("nan"),
            }
        )
    return found
