"""Reads the files that a run names, in one pass and before their contents are checked."""

from __future__ import annotations

from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar

from facts_damping.parameters.field_errors import check_field, worded
from facts_damping.parameters.files import find, read_table

if TYPE_CHECKING:
    from collections.abc import Iterator

    from facts_damping.fields import ParameterModel
    from facts_damping.parameters.run import Run

    M = TypeVar("M", bound=ParameterModel)


class Source(NamedTuple):
    """Content of a run's field, inline or of the file that it names."""

    content: Any
    field: str
    file: str = ""  # empty: inline


class Sources(NamedTuple):
    """All that a run names besides its systems; `links`: of each controller, None: the run's."""

    scenario: Source
    measurement: Source
    link: Source
    links: list[Source | None]
    supervision: Source | None


def resolve(run: Run, system: str) -> Sources:
    """Read the files that a run names. `system`: name of its system, to which its scenario belongs."""
    if isinstance(run.scenario, str):
        scenario = read_source("scenarios", run.scenario, "scenario", f"{system}/")
    else:
        scenario = Source({"name": "inline", "events": run.scenario}, "scenario")
    return Sources(
        scenario,
        read_source("measurement", run.measurement, "measurement"),
        read_source("links", run.link, "link"),
        [
            None if controller.link is None else read_source("links", controller.link, f"controllers.{i}.link")
            for i, controller in enumerate(run.controllers)
        ],
        None if run.supervision is None else read_source("supervision", run.supervision, "supervision"),
    )


def read_source(kind: str, written: str | dict[str, Any], field: str, within: str = "") -> Source:
    """Content of a run's field: by name or path of a file of that kind, or inline."""
    if not isinstance(written, str):
        return Source(written, field)
    path = find(kind, written, within)
    return Source(read_table(path), field, str(path))


@contextmanager
def located(source: Source) -> Iterator[str]:
    """The field that paths in errors of a source begin with; an error in a file begins with that."""
    if not source.file:
        yield source.field
        return
    with worded(source.file):
        yield ""


def checked(model: type[M], source: Source) -> M:
    """A source's content as a model."""
    with located(source) as field:
        return check_field(model, source.content, field)
