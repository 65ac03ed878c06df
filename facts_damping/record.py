"""The record of a closed loop: all its tables, and a column for each quantity."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from facts_damping.monitor_table import MONITORS

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray
from facts_damping.signals import (
    CHANNELS,
    ESTIMATE,
    LEARNING,
    NANOSECONDS,
    SETPOINT,
    SUPERVISION,
    TRUTH_UNITS,
    truth_field,
)


@dataclass(frozen=True)
class GridEvent:
    """An event of the grid: a line, bus, load or machine, and what changes there; NaN: not given."""

    time_ns: int
    kind: str
    element: str
    value: float = np.nan  # relative change
    location: float = np.nan  # of a fault on a line


@dataclass(frozen=True)
class RunChange:
    """A change during a run, effective from a tick on, and the node that made it."""

    tick: int
    node: str
    role: str  # plant, link, controller, identifier, supervisor
    index: int
    kind: str  # parameter, link, event, start, arm, ...
    name: str
    value: Any


@dataclass(frozen=True)
class Absence:
    """Ticks from `first` to before `end` at which a node, given by role and index, was absent from a table."""

    role: str
    index: int
    first: int
    end: int
    table: str = ""  # such as `issued`; empty: all of the node's


@dataclass(frozen=True)
class RefusedMessages:
    """Number of messages from a source on a topic that a node refused for a cause."""

    node: str
    topic: str
    cause: str
    source: str
    count: int


class NodeJoined(NamedTuple):
    """A node that joined during the run: when, and when it was armed (s; None: disarmed to the end)."""

    node: str
    time_s: float
    armed_s: float | None


@dataclass(frozen=True)
class Record:
    """All results of one closed loop, from `loop.run` or from a recording.

    `frames` (ticks, PMUs, channels): each PMU's report at a tick, with time of measurement `measured_ns`
    (ticks, PMUs; NEVER: none yet) and status bits `status`; `machines` (ticks, machines) of MACHINE_TRUTH; `devices`
    (ticks, devices) of DEVICE_TRUTH; `delivered`: one row per entry (DELIVERY); `issued` and `applied`: one row per
    setpoint (SETPOINT); `estimates`: one row per identified derivative (ESTIMATE); `learning`: one row per learning
    rate (LEARNING); `supervised`: one row per setpoint of a supervisor (SETPOINT); `supervision`: one row per tick and
    supervisor (SUPERVISION).

    `links`: number of delivering links, including those that have not delivered yet. `changes`: changes during the
    run: `tick` from which it acts, `node`, `role`, `index`, `kind`, `name`, `value` (docs/ros2.md). `absences`: ticks
    at which a node was absent before it began or restarted: `role`, `index`, `first`, `end`. `latest`: newest inputs of
    nodes when they acted, by role, index and name of the input: (ticks, 2), the node's tick and the tick of the newest
    message it had.
    `publishers`: publishing node by topic and the publisher's identity (GID), in one text. `versions`: of the software
    that made it, by package; empty if unknown. `in_synchronism` is false at the tick that ended an unstable run.
    `notes` list what a damaged recording lacks, `messages_lost` counts the messages that the recorder missed, also at
    the end; `gap_tick` is the first tick with missing data, None if complete.
    `arrays` has one column per quantity and one row per tick, `units` the unit of each column.
    """

    configuration: dict[str, Any]
    pmus: list[str]
    machine_names: list[str]
    device_names: list[str]
    controller_names: list[str]
    time_ns: NDArray[np.int64]
    frames: NDArray[np.float64]
    measured_ns: NDArray[np.int64]
    status: NDArray[np.int64]
    delivered: NDArray[Any]
    issued: NDArray[Any]
    applied: NDArray[Any]
    machines: NDArray[Any]
    devices: NDArray[Any]
    in_synchronism: NDArray[np.bool_]
    estimates: NDArray[Any] = field(default_factory=lambda: np.zeros(0, ESTIMATE))
    supervised: NDArray[Any] = field(default_factory=lambda: np.zeros(0, SETPOINT))
    supervision: NDArray[Any] = field(default_factory=lambda: np.zeros(0, SUPERVISION))
    learning: NDArray[Any] = field(default_factory=lambda: np.zeros(0, LEARNING))
    events: list[GridEvent] = field(default_factory=list)
    refused: list[RefusedMessages] = field(default_factory=list)
    joined: list[NodeJoined] = field(default_factory=list)
    changes: list[RunChange] = field(default_factory=list)
    absences: list[Absence] = field(default_factory=list)
    latest: dict[tuple[str, int, str], NDArray[np.int64]] = field(default_factory=dict)
    links: int = 1
    publishers: dict[str, str] = field(default_factory=dict)
    versions: dict[str, str] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)
    messages_lost: int = 0
    gap_tick: int | None = None

    @property
    def time_s(self) -> NDArray[np.float64]:
        """Time of every tick, s."""
        return self.time_ns / NANOSECONDS

    @property
    def asked(self) -> dict[str, Any]:
        """The run with the names that the user gave, if known, else as configured."""
        return dict(self.configuration.get("asked") or self.configuration)

    @property
    def frame_rate(self) -> int:
        """Frames per second: configured, else from the times of the ticks."""
        configured = self.configuration.get("frame_rate")
        if isinstance(configured, int):
            return configured
        return round(NANOSECONDS / float(np.diff(self.time_ns).min())) if len(self.time_ns) > 1 else 1

    @property
    def ticks(self) -> NDArray[np.int64]:
        """Number of each tick: t_k = k / f, rounded down."""
        return -(-self.time_ns * self.frame_rate // NANOSECONDS)

    @cached_property
    def arrays(self) -> dict[str, NDArray[Any]]:
        """All signals on the grid of ticks by name, each (ticks,) (docs/recordings.md).

        Occasional values (delivered entries, setpoints) are the last ones known at the end of each tick; NaN before the
        first.
        """
        return {name: values for name, _, values in _columns(self)}

    @cached_property
    def units(self) -> dict[str, str]:
        """Unit of each of `arrays`; `-`: none."""
        return {name: unit for name, unit, _ in _columns(self)}


def _columns(record: Record) -> Iterator[tuple[str, str, NDArray[Any]]]:
    """Name, unit and values of each column of a record; names end with the unit."""
    yield "tick", "-", record.ticks
    yield "time_s", "s", record.time_s
    for s, pmu in enumerate(record.pmus):
        for c, (name, unit) in enumerate(CHANNELS.items()):
            yield f"pmu.{pmu}.{name}_{unit}", unit, record.frames[:, s, c]
    for link in sorted(set(record.delivered["link"].tolist())):
        for s, pmu in enumerate(record.pmus):
            rows = record.delivered[(record.delivered["link"] == link) & (record.delivered["pmu"] == s)]
            rows = rows[_newest(rows)]
            held = _held(
                record.ticks, rows["tick"], np.column_stack([rows["values"], rows["measured_ns"] / NANOSECONDS])
            )
            for c, (name, unit) in enumerate({**CHANNELS, "measured": "s"}.items()):
                yield f"delivered.{link}.{pmu}.{name}_{unit}", unit, held[:, c]
    for way in ("issued", "supervised", "applied"):
        for (c, d), setpoints in group_by(getattr(record, way), "controller", "device"):
            name = f"{way}.{record.controller_names[c]}.{record.device_names[d]}"
            yield f"{name}_pu", "pu", _held(record.ticks, setpoints["tick"], setpoints["value"][:, None])[:, 0]
    for kind, names, table in (
        ("machine", record.machine_names, record.machines),
        ("device", record.device_names, record.devices),
    ):
        for i, element in enumerate(names):
            for name in table.dtype.names or ():
                yield f"{kind}.{element}.{truth_field(name)}", TRUTH_UNITS.get(name, "pu"), table[name][:, i]
    yield "in_synchronism", "-", record.in_synchronism
    yield from _learnt(record)
    yield from _watched(record)


def _learnt(record: Record) -> Iterator[tuple[str, str, NDArray[Any]]]:
    """Columns of identifiers' estimates and networks' learning."""
    rows = record.estimates
    for (c, i, d), estimates in group_by(rows, "controller", "signal", "device"):
        place, signal = record.controller_names[c], _signal(record, c, i)
        values = _held(
            record.ticks,
            estimates["tick"],
            np.column_stack([estimates[key] for key in ("jacobian", "prediction", "error", "change")]),
        )
        yield f"estimate.{place}.{signal}.{record.device_names[d]}_pu_per_pu", "pu/pu", values[:, 0]
        if d == rows["device"][(rows["controller"] == c) & (rows["signal"] == i)][0]:
            yield f"estimate.{place}.{signal}.prediction_pu", "pu", values[:, 1]
            yield f"estimate.{place}.{signal}.error_pu", "pu", values[:, 2]
            yield f"estimate.{place}.{signal}.change_pu", "pu", values[:, 3]
    for (c, n, o, g), part in group_by(record.learning, "controller", "identifier", "output", "group"):
        place = f"learning.{record.controller_names[c]}." + ("identifier" if n else "controller")
        values = _held(record.ticks, part["tick"], np.column_stack([part[key] for key in ("rate", "lyapunov", "fall")]))
        yield f"{place}.{o}.{g}.rate", "-", values[:, 0]
        if (o, g) == (0, 0):
            yield f"{place}.lyapunov", "-", values[:, 1]
            yield f"{place}.fall", "-", values[:, 2]


def _watched(record: Record) -> Iterator[tuple[str, str, NDArray[Any]]]:
    """Columns of supervisors: code of the state, fraction of the ramp, values of the monitors."""
    units = {"state": "-", "fraction": "-", **{name: row.unit for name, row in MONITORS.items()}}
    for (c,), part in group_by(record.supervision, "controller"):
        values = _held(record.ticks, part["tick"], np.column_stack([part["state"], part["fraction"], part["values"]]))
        for i, (name, unit) in enumerate(units.items()):
            yield f"supervision.{record.controller_names[c]}.{name}", unit, values[:, i]


def group_by(rows: NDArray[Any], *fields: str) -> list[tuple[tuple[int, ...], NDArray[Any]]]:
    """Group rows of a table by the values of some fields: the values, ascending, and their rows."""
    keys = np.column_stack([rows[field] for field in fields])
    return [(tuple(key.tolist()), rows[np.all(keys == key, axis=1)]) for key in np.unique(keys, axis=0)]


def _signal(record: Record, controller: int, signal: int) -> str:
    """Name of a controller's signal as configured; else its index."""
    rows = record.configuration.get("controllers") or []
    names = rows[controller].get("signals", []) if controller < len(rows) else []
    return str(names[signal]) if signal < len(names) else str(signal)


def _newest(rows: NDArray[Any]) -> NDArray[np.bool_]:
    """Whether each delivery of a PMU has a newer time of measurement than all before."""
    measured = rows["measured_ns"]
    before = np.concatenate([[np.iinfo(np.int64).min], np.maximum.accumulate(measured)[:-1]]) if len(rows) else measured
    return np.asarray(measured > before)


def _held(ticks: NDArray[np.int64], at: NDArray[np.int64], values: NDArray[Any]) -> NDArray[np.float64]:
    """Values (rows, columns) at sorted ticks `at`, held on a grid of ticks; NaN before the first."""
    place = np.searchsorted(at, ticks, side="right")
    padded = np.vstack([np.full((1, values.shape[1]), np.nan), values])
    return np.asarray(padded[place], np.float64)
