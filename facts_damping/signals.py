"""Names, units and layouts of all quantities that are measured, sent and recorded.

Tables are NumPy arrays of structured type, so that compiled functions, nodes and analysis use the same field names.
Times are integer nanoseconds of simulated time.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from numpy.typing import NDArray

from facts_damping.compiling.structs import Array
from facts_damping.monitor_table import MONITORS

if TYPE_CHECKING:
    from collections.abc import Iterator


NANOSECONDS = 1_000_000_000
NEVER = np.iinfo(np.int64).max  # ns, a time that never comes
NOT_YET = -1  # ns, time of an event that has not happened yet


def to_ns(seconds: float) -> int:
    """Seconds as integer nanoseconds, to the nearest."""
    return round(seconds * NANOSECONDS)


# Channels of a PMU in the order of a frame's columns: name, unit. NaN: not available.
CHANNELS = {
    "voltage_magnitude": "pu",
    "voltage_angle": "rad",
    "speed_deviation": "pu",
    "active_power": "pu",
    "reactive_power": "pu",
    "frequency": "hz",
    "rocof": "hz_per_s",
    "current_magnitude": "pu",
    "current_angle": "rad",
}

# One entry of a PMU frame as a link delivers it. `values` are in the order of CHANNELS.
DELIVERY = np.dtype(
    [
        ("tick", "i8"),  # tick in which it is delivered
        ("pmu", "i8"),  # index of the PMU
        ("link", "i8"),  # index of the link that delivers it, among those of the run
        ("status", "i8"),  # bits of PmuFrame.msg
        ("measured_ns", "i8"),  # time of measurement, by the PMU's clock
        ("arrival_ns", "i8"),  # time of arrival at the controllers
        ("values", "f8", (len(CHANNELS),)),
    ]
)

SPEED_BAND = 0.2  # p.u. about synchronous speed, beyond which the machine model is not valid

# One setpoint of one device, as a controller issues it or as a link delivers it.
SETPOINT = np.dtype(
    [
        ("tick", "i8"),  # tick in which it is issued, or delivered
        ("controller", "i8"),  # index of the controller in the run
        ("device", "i8"),  # index of the device in the run
        ("measured_ns", "i8"),  # time of measurement of the newest frame it rests on
        ("issued_ns", "i8"),  # time at which the controller computed it
        ("effective_ns", "i8"),  # time at which it reaches the device (as issued: issued_ns)
        ("value", "f8"),  # p.u. of the system's base voltage
    ]
)

# Estimates of an identifier after a tick: one row for each of its signals and devices.
ESTIMATE = np.dtype(
    [
        ("tick", "i8"),
        ("controller", "i8"),  # index of the controller in the run that it serves
        ("signal", "i8"),  # index of the signal among the controller's
        ("device", "i8"),  # index of the device in the run
        ("measured_ns", "i8"),  # time of measurement of the newest frame it rests on; -1: none yet
        ("jacobian", "f8"),  # p.u. of the signal per p.u. of setpoint, `horizon` frames ahead
        ("prediction", "f8"),  # p.u.; NaN: none yet
        ("error", "f8"),  # p.u., prediction less measurement; NaN: none yet
        ("ahead", "f8"),  # s, how far `change` looks ahead; NaN: not asked for
        ("change", "f8"),  # p.u., predicted from the frame after the newest over `ahead`; NaN: none
    ]
)

# Learning of a network after a tick: one row for each output and group of parameters (h, s, w and so on).
LEARNING = np.dtype(
    [
        ("tick", "i8"),
        ("controller", "i8"),  # index of the controller in the run
        ("identifier", "i8"),  # 0: the controller's own network, 1: its identifier's
        ("output", "i8"),  # index of the output: a device of the controller, a signal of the identifier
        ("group", "i8"),  # index of the group, in the order of the network's parameters
        ("rate", "f8"),  # learning rate at the newest frame used for learning
        ("lyapunov", "f8"),  # Lyapunov function at that frame, normalised (6.15), (6.10)
        ("fall", "f8"),  # its decrease by the step, to first order in the parameters
    ]
)

# State of a supervisor after a tick; codes as in `facts_damping.monitor_table`.
SUPERVISION = np.dtype(
    [
        ("tick", "i8"),
        ("controller", "i8"),  # index of the controller in the run
        ("state", "i8"),
        ("cause", "i8"),
        ("refused", "i8"),
        ("fraction", "f8"),  # progress of the newest switch-over between setpoint sources, 0 to 1
        ("values", "f8", (len(MONITORS),)),  # values of the monitors; NaN: unknown
        ("probe_gain", "f8"),  # of the device whose response is known least; NaN: not probed
        ("probe_phase", "f8"),  # rad
        ("probe_coherence", "f8"),
        ("added_damping", "f8"),  # 1/s, reduction of the mode's growth rate by the controller, from the probe
        ("phase_margin", "f8"),  # rad, phase error in either direction at which the added damping becomes zero
        ("gain_margin", "f8"),  # factor on the gain at which the mode neither decays nor grows; NaN: none
    ]
)

# True state of a machine, which PMUs do not measure completely.
MACHINE_TRUTH = np.dtype(
    [
        ("rotor_angle", "f8"),  # rad, against the synchronously rotating frame
        ("speed_deviation", "f8"),  # p.u. of synchronous speed
        ("electrical_power", "f8"),  # p.u. of the system base, air-gap power
        ("mechanical_power", "f8"),  # p.u. of the system base, from the turbine
        ("field_voltage", "f8"),  # p.u., 1 = open-circuit rated voltage on the air-gap line
        ("terminal_voltage", "f8"),  # p.u.
    ]
)

# True state of a FACTS device. The setpoint is a series voltage; at a bus, an offset of the voltage reference; for an
# HVDC link, power added to its order, with current and power at its `to` bus. NaN: not applicable to the kind.
DEVICE_TRUTH = np.dtype(
    [
        ("setpoint", "f8"),  # p.u., the setpoint in force, after limits
        ("reference", "f8"),  # p.u., the setpoint after the rate limit
        ("injected_voltage", "f8"),  # p.u., quadrature voltage, capacitive positive; NaN: no series device
        ("active_voltage", "f8"),  # p.u., in phase with the current, drop positive; NaN: no series device
        ("current", "f8"),  # p.u. of the system base
        ("dc_voltage", "f8"),  # p.u. of the rated DC voltage; NaN: no DC link
        ("state", "f8"),  # p.u.: charge of a battery, reactance of a TCSC, susceptance of an SVC; NaN: none of these
        ("active_power", "f8"),  # p.u. of the system base, supplied to the network
        ("reactive_power", "f8"),  # p.u. of the system base, supplied to the network
        ("blocked", "f8"),  # 1 = blocked (too little current or voltage, or no solution)
        ("released", "f8"),  # 1 = released by its watchdog: it accepts no setpoint
        ("refused_value", "f8"),  # setpoints refused by its watchdog so far: not finite or beyond the limit,
        ("refused_stamp", "f8"),  # too old or from the future,
        ("refused_order", "f8"),  # not newer than a previous one
    ]
)

# Table types for compiled functions.
Deliveries = Annotated[NDArray[Any], Array(DELIVERY, 1)]
Deliveries2 = Annotated[NDArray[Any], Array(DELIVERY, 2)]
Setpoints = Annotated[NDArray[Any], Array(SETPOINT, 1)]
Estimates = Annotated[NDArray[Any], Array(ESTIMATE, 1)]
Learnings = Annotated[NDArray[Any], Array(LEARNING, 1)]
Supervisions = Annotated[NDArray[Any], Array(SUPERVISION, 1)]
MachineTruths = Annotated[NDArray[Any], Array(MACHINE_TRUTH, 1)]
DeviceTruths = Annotated[NDArray[Any], Array(DEVICE_TRUTH, 1)]


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
class Record:
    """All results of one closed loop, from `loop.run` or from a recording.

    `frames` (ticks, PMUs, channels): each PMU's report at a tick, with time of measurement `measured_ns`
    (ticks, PMUs; NEVER: none yet) and status bits `status`; `machines` (ticks, machines) of MACHINE_TRUTH; `devices`
    (ticks, devices) of DEVICE_TRUTH; `delivered`: one row per entry (DELIVERY); `issued` and `applied`: one row per
    setpoint (SETPOINT); `estimates`: one row per identified derivative (ESTIMATE); `learning`: one row per learning
    rate (LEARNING); `supervised`: one row per setpoint of a supervisor (SETPOINT); `supervision`: one row per tick and
    supervisor (SUPERVISION).

    `links`: number of delivering links, including those that have not delivered yet. `refused`: number of messages that
    each node refused: `node`, `topic`, `cause`, `source`, `count`. `joined`: nodes that joined during the run: `node`,
    `time_s`, `armed_s` (None: disarmed to the end). `changes`: changes during the run: `tick` from which it acts,
    `node`, `role`, `index`, `kind`, `name`, `value` (docs/ros2.md). `absences`: ticks at which a node was absent
    before it began or restarted: `role`, `index`, `first`, `end`. `latest`: newest inputs of nodes when they acted, by
    role, index and name of the input: (ticks, 2), the node's tick and the tick of the newest message it had.
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
    refused: list[dict[str, Any]] = field(default_factory=list)
    joined: list[dict[str, Any]] = field(default_factory=list)
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
        given = self.configuration.get("frame_rate")
        if isinstance(given, int):
            return given
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


FLAGS = ("blocked", "released")  # fields of DEVICE_TRUTH that are flags
REFUSED = ("refused_value", "refused_stamp", "refused_order")  # its counters of refused setpoints, by cause

# Units of the truth's fields; all others are p.u.
TRUTH_UNITS = {"rotor_angle": "rad", **dict.fromkeys((*FLAGS, *REFUSED), "-")}


def truth_field(name: str) -> str:
    """Name of a truth's field in messages and columns: with its unit, if it has one."""
    unit = TRUTH_UNITS.get(name, "pu")
    return name if unit == "-" else f"{name}_{unit}"


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
        for (c, d), own in group_by(getattr(record, way), "controller", "device"):
            name = f"{way}.{record.controller_names[c]}.{record.device_names[d]}"
            yield f"{name}_pu", "pu", _held(record.ticks, own["tick"], own["value"][:, None])[:, 0]
    for kind, names, table in (
        ("machine", record.machine_names, record.machines),
        ("device", record.device_names, record.devices),
    ):
        for i, one in enumerate(names):
            for name in table.dtype.names or ():
                yield f"{kind}.{one}.{truth_field(name)}", TRUTH_UNITS.get(name, "pu"), table[name][:, i]
    yield "in_synchronism", "-", record.in_synchronism
    yield from _learnt(record)
    yield from _watched(record)


def _learnt(record: Record) -> Iterator[tuple[str, str, NDArray[Any]]]:
    """Columns of identifiers' estimates and networks' learning."""
    rows = record.estimates
    for (c, i, d), own in group_by(rows, "controller", "signal", "device"):
        place, signal = record.controller_names[c], _signal(record, c, i)
        values = _held(
            record.ticks,
            own["tick"],
            np.column_stack([own[key] for key in ("jacobian", "prediction", "error", "change")]),
        )
        yield f"estimate.{place}.{signal}.{record.device_names[d]}_pu_per_pu", "pu/pu", values[:, 0]
        if d == rows["device"][(rows["controller"] == c) & (rows["signal"] == i)][0]:
            yield f"estimate.{place}.{signal}.prediction_pu", "pu", values[:, 1]
            yield f"estimate.{place}.{signal}.error_pu", "pu", values[:, 2]
            yield f"estimate.{place}.{signal}.change_pu", "pu", values[:, 3]
    for (c, n, o, g), own in group_by(record.learning, "controller", "identifier", "output", "group"):
        place = f"learning.{record.controller_names[c]}." + ("identifier" if n else "controller")
        values = _held(record.ticks, own["tick"], np.column_stack([own[key] for key in ("rate", "lyapunov", "fall")]))
        yield f"{place}.{o}.{g}.rate", "-", values[:, 0]
        if (o, g) == (0, 0):
            yield f"{place}.lyapunov", "-", values[:, 1]
            yield f"{place}.fall", "-", values[:, 2]


def _watched(record: Record) -> Iterator[tuple[str, str, NDArray[Any]]]:
    """Columns of supervisors: code of the state, fraction of the ramp, values of the monitors."""
    units = {"state": "-", "fraction": "-", **{name: row.unit for name, row in MONITORS.items()}}
    for (c,), own in group_by(record.supervision, "controller"):
        values = _held(record.ticks, own["tick"], np.column_stack([own["state"], own["fraction"], own["values"]]))
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
