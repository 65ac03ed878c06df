"""Contents of a report as plain data: tables, charts and maps, each with a sentence that explains it."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Literal, NamedTuple

from facts_damping.input_files import read_text
from facts_damping.parameters.yaml_text import parse

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    import numpy as np
    from numpy.typing import NDArray

    from facts_damping.analysis.summary import Summary
    from facts_damping.record import Record

SENTENCES: dict[str, str] = parse(read_text(Path(__file__).with_name("sentences.yaml")))
Mark = Literal["", "best", "worst"]


class ReportedRun(NamedTuple):
    """A recording in the report: name, record, figures, path, and improvement over the baseline in percent."""

    name: str
    record: Record
    summary: Summary
    path: str = "-"
    improvement_percent: Mapping[str, float | None] | None = None


class Cell(NamedTuple):
    """An entry of a table; the mark gives its rank within the row."""

    text: str
    mark: Mark = ""


class ReportTable(NamedTuple):
    """A table whose rows begin with their name. `runs`: the other columns are the runs, in order."""

    key: str
    title: str
    sentence: str
    head: Sequence[str]
    rows: Sequence[Sequence[Cell]]
    runs: bool = False


class Curve(NamedTuple):
    """A line of the run with that index: x and y (n,). `points`: markers without a line.

    `name` distinguishes it from other curves of the run in the same panel.
    """

    run: int
    x: NDArray[np.float64]
    y: NDArray[np.float64]
    style: Literal["solid", "dashed", "points"] = "solid"
    name: str = ""


class Panel(NamedTuple):
    """Axes with curves and horizontal lines at given levels."""

    title: str
    curves: Sequence[Curve]
    levels: Sequence[float] = ()


class Chart(NamedTuple):
    """Panels with the same labels. `over_time`: x is simulated time, s, linked with all other such charts.

    `words`: labels of ordinates 0, 1 and so on, if these are not numbers.
    """

    key: str
    title: str
    sentence: str
    x_label: str
    y_label: str
    panels: Sequence[Panel]
    over_time: bool = True
    logarithmic: bool = False
    words: Sequence[str] = ()


class Map(NamedTuple):
    """A distribution over time (s) and frequency (Hz) of the run with that index: values (frequencies, times).

    `extent`: first and last time and frequency, at the outer edges; `lines`: Hz, known frequencies.
    """

    run: int
    title: str
    extent: tuple[float, float, float, float]
    values: NDArray[np.float32]
    unit: str
    lines: Sequence[float]


class Maps(NamedTuple):
    """Maps side by side."""

    key: str
    title: str
    sentence: str
    maps: Sequence[Map]


class Tile(NamedTuple):
    """A headline figure: its name and the value of each run."""

    title: str
    values: Sequence[str]


class Section(NamedTuple):
    """A section of the report."""

    title: str
    items: Sequence[ReportTable | Chart | Maps]


class Report(NamedTuple):
    """The whole report: names of runs, main result in a sentence, tiles, remarks, events (s, text), sections."""

    title: str
    names: Sequence[str]
    lead: str
    tiles: Sequence[Tile]
    remarks: Sequence[str]
    events: Sequence[tuple[float, str]]
    sections: Sequence[Section]
