"""A checked run with the content of all files that it names."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from facts_damping.caching import shared
from facts_damping.measurement.filters import reference_filter
from facts_damping.parameters.files import copied, is_path
from facts_damping.parameters.profile import DEFAULT_PROFILE

if TYPE_CHECKING:
    from facts_damping.measurement.filters import Filter
    from facts_damping.parameters.events import Scenario
    from facts_damping.parameters.link import Link
    from facts_damping.parameters.measurement import Measurement
    from facts_damping.parameters.plant.system import System
    from facts_damping.parameters.run import Controller, Run
    from facts_damping.parameters.supervision import Supervision


_contents: dict[int, tuple[System, dict[str, Any]]] = {}  # by the system's identity


def _content(system: System) -> dict[str, Any]:
    """A system as a file has it; runs of a sweep mostly share one."""
    make = lambda: (system, system.model_dump(by_alias=True))  # noqa: E731
    return copied(shared(_contents, id(system), make, maximum=8)[1])


@dataclass(frozen=True)
class Case:
    """A checked run and the content of the files that it names.

    `controllers`: the run's, with scheme, all parameters, weights and own link filled in. `links`: the run's, if used,
    then each controller's own; `used_links`: index of each controller's link. `model`: the system for controller
    design, if not the plant.
    """

    run: Run
    controllers: list[Controller]
    system: System
    scenario: Scenario
    measurement: Measurement
    link: Link
    links: list[Link]
    used_links: list[int]
    supervision: Supervision | None = None
    model: System | None = None

    @property
    def designed_on(self) -> System:
        """The system on which controllers and supervisors are designed."""
        return self.model or self.system

    @property
    def duration(self) -> float:
        """Simulated time, s."""
        return self.scenario.duration if self.run.duration is None else self.run.duration

    @property
    def filter(self) -> Filter:
        """Filter of the PMUs."""
        return reference_filter(self.measurement, self.system.frequency, self.run.frame_rate)

    @property
    def ticks(self) -> int:
        """Number of PMU frames in the run."""
        return max(1, round(self.duration * self.run.frame_rate))

    def summary(self) -> dict[str, Any]:
        """The run with names instead of files' content, for JSON output."""
        return self.run.asked or {**self.run.model_dump(exclude={"asked"}), "duration": self.duration}

    def document(self) -> dict[str, Any]:
        """The run with the content of all files inline: a self-contained run file."""
        return {
            **self.run.model_dump(),
            "controllers": [controller.model_dump() for controller in self.controllers],
            "asked": self.summary(),
            "tuning": DEFAULT_PROFILE if is_path(self.run.tuning) else self.run.tuning,  # all parameters are there
            "duration": self.duration,
            "system": _content(self.system),
            "model": None if self.model is None else _content(self.model),
            "scenario": [event.model_dump() for event in self.scenario.events],
            "measurement": self.measurement.model_dump(),
            "link": self.link.model_dump(),
            "supervision": None if self.supervision is None else self.supervision.model_dump(),
        }
