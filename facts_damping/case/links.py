"""Reads and checks the links of a run and assigns them to controllers."""

from __future__ import annotations

from copy import deepcopy
from typing import TYPE_CHECKING, Any

from facts_damping.case.delay_traces import with_traces
from facts_damping.case.named_files import located
from facts_damping.errors import InputError
from facts_damping.link.stages import mean_delay
from facts_damping.parameters.field_errors import check, check_field, of_field
from facts_damping.parameters.files import find, read_table
from facts_damping.parameters.link import Link
from facts_damping.parameters.run import Run
from facts_damping.parameters.stages import Bernoulli

if TYPE_CHECKING:
    from facts_damping.case.named_files import Source, Sources
    from facts_damping.parameters.measurement import Measurement
    from facts_damping.parameters.plant.system import System
    from facts_damping.parameters.run import Controller
    from facts_damping.parameters.stages import StageModel


def links_of(sources: Sources) -> tuple[Link, list[Link], list[int]]:
    """The run's link; all links in use; for each controller, the index of its link among these.

    The run's link comes first if a controller has none of its own or there is no controller. Each controller's own link
    is separate, even if it has the same name as another.
    """
    link = link_of(sources.link)
    links = [link] if not sources.links or None in sources.links else []
    used = []
    for source in sources.links:
        used.append(0 if source is None else len(links))
        links += [] if source is None else [link_of(source)]
    return link, links, used


def mean_delays(controller: Controller, system: System, link: Link) -> tuple[float, float]:
    """Largest mean delay of a controller, s: from PMU to device, and from controller to device.

    Both include the devices' dead time.
    """
    signals = [name for name in controller.signals if name in system.signals]  # others, and devices, are checked later
    pmus = {pmu for name in signals for pmu in system.signals[name].weights}
    groups = {s: {s, *(n for n, signal in system.signals.items() if s in signal.weights)} for s in pmus}
    dead = {device.name: device.dead_time for device in system.devices}
    whole = [
        mean_delay([*link.up, *link.down], [*groups[s], device]) + dead.get(device, 0.0)
        for s in sorted(pmus)
        for device in controller.devices
    ]
    down = [mean_delay(link.down, [device]) + dead.get(device, 0.0) for device in controller.devices]
    return max(whole, default=0.0), max(down, default=0.0)


def link_of(source: Source) -> Link:
    """A link with its traces."""
    with located(source) as field, of_field(field):
        return with_traces(check_field(Link, source.content, field))


def signed(link: Link) -> Link:
    """A link with signed messages: a message altered on the way is refused, so it counts as lost."""

    def refused(stage: Any) -> Any:
        if stage.model != "flip":
            return stage
        shared = {name: getattr(stage, name) for name in ("stage", "channels", "start", "duration")}
        return Bernoulli(**shared, loss=stage.probability)

    return link.model_copy(update={way: [refused(stage) for stage in getattr(link, way)] for way in ("up", "down")})


def beside(link: Link, measurement: Measurement) -> Link:
    """A link for PMUs with their own filter: its constant stages `pmu`, which stand for a filter, get no delay."""
    if measurement.filter == "ideal":
        return link
    up = [stage.model_copy(update={"delay": 0.0}) if _stands_for_pmus(stage) else stage for stage in link.up]
    return link.model_copy(update={"up": up})


def _stands_for_pmus(stage: StageModel) -> bool:
    return stage.stage == "pmu" and stage.model == "constant"


def check_felt(link: Link, field: str, measurement: Measurement, sets: dict[str, str]) -> None:
    """Raise `InputError` if `--set` gives a delay for a `pmu` stage that `beside` sets to zero."""
    for i, stage in enumerate(link.up):
        setting = sets.get(f"{field}.up.{i}.delay")
        if setting is not None and _stands_for_pmus(stage) and measurement.filter != "ideal":
            others = ", ".join(f"{field}.up.{k}" for k, other in enumerate(link.up) if not _stands_for_pmus(other))
            why = f"the stage models PMUs, but this run models their filter itself ({measurement.filter})"
            raise InputError(f"{setting}: {why}; allowed: a delay of {others or 'another stage'}, or measurement=ideal")


def with_number(link: Link, path: str, value: float) -> tuple[str, int, Link]:
    """Change a number of a stage, such as `up.0.delay`. Returns way, index of the stage, and the link.

    Raises `InputError` for a value that is not allowed.
    """
    way, place, name = path.split(".")
    stages = list(getattr(link, way))
    old = stages[int(place)]
    stages[int(place)] = check(type(old), {**old.model_dump(), name: value}, "link", None, f"{way}.{place}")
    return way, int(place), link.model_copy(update={way: stages})


def open_own(content: dict[str, Any], path: str) -> None:
    """If a `--set` path `controllers.<path>` continues into a link, replace the link's name by its file's content.

    A controller without its own link starts from the run's.
    """
    place, _, field = path.partition(".")
    rows = content.get("controllers")
    if not field.startswith("link.") or not isinstance(rows, list) or not place.isdigit() or int(place) > len(rows):
        return
    if int(place) == len(rows):
        rows.append({})
    row = rows[int(place)]
    if isinstance(row, dict):
        named = row.get("link")
        if named is None:
            named = content.get("link", Run.model_fields["link"].default)
        row["link"] = read_table(find("links", named)) if isinstance(named, str) else deepcopy(named)
