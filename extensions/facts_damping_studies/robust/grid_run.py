"""The run of a grid for which a law is designed: its devices, the signals that the law may use, link and profile."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

from facts_damping.case.changes import read_profile
from facts_damping.case.loading import make_case
from facts_damping.errors import InputError, check_known
from facts_damping.parameters.profile import DEFAULT_PROFILE
from facts_damping_studies.design import design

if TYPE_CHECKING:
    from facts_damping.case.model import Case
    from facts_damping.parameters.plant.system import System
    from facts_damping_studies.design.design import Ranking, Task, Tell

MORE_SIGNALS = 4  # of the ranking, for a grid without signals of its own


class GridRun(NamedTuple):
    """Content of a run without controllers, with its system inline, and the signals that a law may use."""

    content: dict[str, Any]
    named: bool  # whether the system is as GRID names it
    signals: list[str]
    ranking: Ranking | None  # if a place or a signal was looked for

    def case(self) -> Case:
        """The run."""
        return make_case(self.content, "design")


def grid_run(task: Task, delay: float | None, jobs: int, tell: Tell) -> GridRun:
    """The run of a task's grid with the named devices or places; none: the grid's devices, or the best place.

    `delay`: of the link, s; none: the profile's link, or the task's delay. Raises `InputError` for unknown names.
    """
    system = design.read(task)
    devices = [device.name for device in system.devices]
    asked = [] if task.place is None else task.place.split(",")
    if (not asked and devices) or (asked and set(asked) <= set(devices)):
        signals = _signals(task, system)
        if signals:
            run = _run(task, system, asked or devices, delay)
            return GridRun(run, not task.sets, signals, None)
    if len(asked) > 1:
        allowed = f"devices of the grid ({', '.join(devices) or 'none'}), or one place"
        raise InputError(f"--place: {task.place} given; allowed: {allowed}")
    ranking = design.ranked(task._replace(signal=None), jobs, tell)
    channel, target = ranking.channel, ranking.target
    names = [ranking.chosen.signal]
    clear = design.maximum(list(ranking.system.signals), abs(ranking.observability[target]), channel, ranking.system)
    names += [name for name in clear if name not in names][: MORE_SIGNALS - 1]
    if task.signal is not None:
        names = task.signal.split(",")
        for name in names:
            check_known("--signal", name, list(ranking.system.signals))
    content, place = design.with_choice(ranking, names)
    run = _run(task, content, [place], delay)
    return GridRun(run, False, names, ranking)


def _signals(task: Task, system: System) -> list[str]:
    """The signals named, or the grid's own of the channel that the PMUs of the profile report."""
    if task.signal is not None:
        names = task.signal.split(",")
        for name in names:
            check_known("--signal", name, list(system.signals))
        return names
    return [name for name, signal in system.signals.items() if signal.channel == task.channel(system)]


def _run(task: Task, system: System, devices: list[str], delay: float | None) -> dict[str, Any]:
    """Content of a run without controllers."""
    profile = {} if task.profile == DEFAULT_PROFILE else dict(read_profile(task.profile).set)
    fields = {name: value for name, value in profile.items() if "." not in name and name != "system"}
    if delay is not None or "link" not in fields:
        fields["link"] = design.link_of(task.delay if delay is None else delay)
    return {
        "description": f"{system.name}, law by facts-damping design",
        "system": system.model_dump(by_alias=True),
        "scenario": [],
        "devices": devices,
        "controllers": [],
        "frame_rate": design.FRAME_RATE,
        **fields,
    }
