"""Values of the curves of a cockpit: from the newest messages while a run goes on, or from a record."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.sparse import csr_array

from facts_damping.analysis import forced
from facts_damping.analysis.modes.ringdown import fit_ringdown
from facts_damping.case.names import controller_names
from facts_damping.record import group_by
from facts_damping.signals import NANOSECONDS, NEVER

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from numpy.typing import NDArray

    from facts_damping.case.model import Case
    from facts_damping.record import Record
    from facts_damping_views.cockpit.layout import Curve, Mode, Panel

RATE = 20  # values per second
WINDOW_S = 12.0  # of the difference of frequencies in which modes are estimated
INTERAREA = (0.1, 1.0)  # Hz, band of modes between areas
FORCED_S = 60.0  # of all differences in which a forced oscillation is looked for
UNSURE = 0.1  # standard error of a damping ratio beyond which it is not shown


class Sums:
    """Computes all curves of a panel from columns."""

    def __init__(self, curves: Sequence[Curve]) -> None:
        self.columns = list(dict.fromkeys(column for curve in curves for column in curve.parts))
        place = {name: i for i, name in enumerate(self.columns)}
        rows = [(i, place[name], w) for i, curve in enumerate(curves) for name, w in curve.parts.items()]
        i, j, weight = zip(*rows, strict=True)
        self._weights = csr_array((weight, (i, j)), shape=(len(curves), len(place)))
        empty = [math.nan if not curve.parts else curve.offset for curve in curves]
        self._offsets = np.array(empty)[:, None]

    def of(self, columns: NDArray[np.float64]) -> NDArray[np.float64]:
        """Curves (samples, curves) of columns (samples, columns); NaN: a column that is needed is not known."""
        return np.asarray((self._weights @ columns.T + self._offsets).T)


def frame_columns(message: Any) -> Iterator[tuple[str, float]]:
    """Columns of frames as the PMUs report them (PmuDataFrame)."""
    for entry in message.frames:
        for field in ("frequency_hz", "active_power_pu"):  # those that curves use
            yield f"pmu.{entry.pmu}.{field}", getattr(entry, field)


def state_columns(message: Any) -> Iterator[tuple[str, float]]:
    """Columns of machines and devices (PlantState)."""
    for machine in message.machines:
        for field in ("rotor_angle_rad", "electrical_power_pu"):
            yield f"machine.{machine.machine}.{field}", getattr(machine, field)
    for device in message.devices:
        for field in ("setpoint_pu", "reference_pu"):
            yield f"device.{device.device}.{field}", getattr(device, field)


def setpoint_columns(way: str, message: Any) -> Iterator[tuple[str, float]]:
    """Columns of setpoints (DeviceSetpoints); `way`: issued, supervised or applied."""
    for entry in message.setpoints:
        yield f"{way}.{entry.controller}.{entry.device}_pu", entry.value_pu


def up_columns(link: int, message: Any) -> Iterator[tuple[str, float]]:
    """Latencies of delivered frames, ms (PmuDataFrame)."""
    by_pmu = [(entry.pmu, _since(entry.header.stamp, entry.arrival)) for entry in message.frames]
    yield from ((f"latency.{link}.up.{pmu}", value) for pmu, value in by_pmu)
    if by_pmu:
        yield f"latency.{link}", max(value for _, value in by_pmu)


def down_columns(link: int, message: Any) -> Iterator[tuple[str, float]]:
    """Delivered setpoints, and their latencies from measurement to device, ms (DeviceSetpoints)."""
    yield from setpoint_columns("applied", message)
    for entry in message.setpoints:
        yield f"latency.{link}.down.{entry.device}", _since(entry.header.stamp, entry.effective)


def supervision_columns(message: Any) -> Iterator[tuple[str, float]]:
    """Values of a supervisor's monitors (SupervisorState)."""
    for name, value in zip(message.monitors, message.values, strict=False):
        yield f"supervision.{message.controller}.{name}", value


def _since(first: Any, later: Any) -> float:
    return float(1e3 * (later.sec - first.sec) + 1e-6 * (later.nanosec - first.nanosec))


def latencies(case: Case, record: Record) -> dict[str, NDArray[np.float64]]:
    """Latencies in ms at every tick, held from the newest entry: of each link (the largest of a tick), up, down."""
    columns: dict[str, NDArray[np.float64]] = {}
    ticks, rows = record.ticks, record.delivered[record.delivered["arrival_ns"] < NEVER]
    for (link, pmu), entries in group_by(rows, "link", "pmu"):
        value = (entries["arrival_ns"] - entries["measured_ns"]) / 1e6
        columns[f"latency.{link}.up.{record.pmus[pmu]}"] = _held(ticks, entries["tick"], value)
    for (link,), entries in group_by(rows, "link"):
        first = np.flatnonzero(np.diff(entries["tick"], prepend=-1))
        value = np.maximum.reduceat((entries["arrival_ns"] - entries["measured_ns"]) / 1e6, first)
        columns[f"latency.{link}"] = _held(ticks, entries["tick"][first], value)
    used = {name: case.used_links[c] for c, name in enumerate(controller_names(case))}
    for (c, device), setpoints in group_by(record.applied, "controller", "device"):
        name = record.controller_names[c]
        if name in used:
            value = (setpoints["effective_ns"] - setpoints["measured_ns"]) / 1e6
            columns[f"latency.{used[name]}.down.{record.device_names[device]}"] = _held(ticks, setpoints["tick"], value)
    return columns


def _held(ticks: NDArray[np.int64], at: NDArray[np.int64], values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Values at sorted ticks `at`, held on a grid of ticks; NaN before the first."""
    return np.concatenate([[np.nan], values])[np.searchsorted(at, ticks, side="right")]


def of_record(case: Case, panel: Panel, record: Record) -> NDArray[np.float32]:
    """All curves of a record, (times, 1 + curves), at 20 times a second or at each tick if these are fewer.

    The first column is the time, s. A value is that of the newest tick, so each is one of the recording.
    """
    time_s = record.time_s
    wanted = np.arange(time_s[0], time_s[-1] + 1e-6, 1.0 / RATE)
    rows = np.unique(np.searchsorted(record.time_ns, np.round(wanted * NANOSECONDS) + 1) - 1)
    sums, columns = Sums(panel.curves), record.arrays | latencies(case, record)
    nothing = np.full(len(time_s), np.nan)
    values = sums.of(np.column_stack([columns.get(name, nothing)[rows] for name in sums.columns]))
    since = [event.time_ns / NANOSECONDS for event in record.events]
    for mode in panel.modes:
        values[:, mode.damping] = _dampings(time_s[rows], values[:, mode.signal], since, panel.frequency)
    return np.column_stack([time_s[rows], values]).astype(np.float32)


def _dampings(
    time_s: NDArray[np.float64], signal: NDArray[np.float64], events: Sequence[float], frequency: float
) -> NDArray[np.float64]:
    """Damping ratio in % as it would have been estimated at each full second."""
    ratios = np.full(len(time_s), np.nan)
    for second in range(int(time_s[0]) + 1, int(time_s[-1]) + 1):
        until = int(np.searchsorted(time_s, second, side="right"))
        last = max((at for at in events if at <= second), default=-math.inf)
        mode = estimate(time_s[:until], signal[:until], last, frequency)
        ratios[until - 1 : until - 1 + RATE] = math.nan if mode is None else 100.0 * mode["damping_ratio"]
    return ratios


def estimate(
    time_s: NDArray[np.float64], signal: NDArray[np.float64], event_s: float, frequency: float
) -> dict[str, float] | None:
    """The strongest mode between areas in the last 12 s of a difference of frequencies, mHz; later than an event.

    `time_s`, `signal`: (samples,), newest last; `event_s`: the last event, s. Frequency in Hz, damping ratio and
    standard error. None: nothing oscillates, too short, or too uncertain.
    """
    recent = (time_s > time_s[-1] - WINDOW_S) & np.isfinite(signal)
    if np.count_nonzero(recent) < 3 * RATE:
        return None
    grid = np.arange(time_s[recent][0], time_s[recent][-1], 1.0 / RATE)  # the newest messages come at uneven times
    x = np.interp(grid, time_s[recent], signal[recent]) / (1e3 * frequency)
    fit = fit_ringdown(grid, x, max(event_s, float(grid[0]) - 1.0))
    for mode in fit.modes if fit is not None else ():
        if INTERAREA[0] <= mode.frequency_hz <= INTERAREA[1] and mode.damping_ratio_error < UNSURE:
            names = ("frequency_hz", "damping_ratio", "damping_ratio_error")
            return {name: float(getattr(mode, name)) for name in names}
    return None


class Live:
    """The newest values while a run goes on, and the last seconds of the differences of frequencies."""

    def __init__(self, panel: Panel) -> None:
        self._panel, self._sums = panel, Sums(panel.curves)
        self._place = {name: i for i, name in enumerate(self._sums.columns)}
        self._columns = np.full(len(self._place), np.nan)
        self._room = int(FORCED_S * RATE) + 1
        self._signals: list[tuple[float, ...]] = []  # time and signals, newest last
        self._row = np.full(len(panel.curves), np.nan)  # the newest values
        self.modes: dict[str, Mapping[str, float]] = {}  # estimated, by label
        self.forced = ""  # oscillation in words; empty: none is known

    def put(self, columns: Iterator[tuple[str, float]]) -> None:
        """Take the columns of a message."""
        for name, value in columns:
            if (place := self._place.get(name)) is not None:
                self._columns[place] = value

    def frame(self, time_s: float, lag_s: float) -> bytes:
        """The values as the page gets them: Float32 time, lag, curves."""
        self._row = values = self._sums.of(self._columns[None])[0]
        for mode in self._panel.modes:
            mode_now = self.modes.get(mode.label)
            values[mode.damping] = math.nan if mode_now is None else 100.0 * mode_now["damping_ratio"]
        if self._signals and time_s <= self._signals[-1][0]:
            self._signals.clear()  # another run has begun
        self._signals.append((time_s, *(values[mode.signal] for mode in self._panel.modes)))
        del self._signals[: -self._room]
        return np.concatenate([[time_s, lag_s], values]).astype("<f4").tobytes()

    def frequencies(self) -> dict[str, float]:
        """The newest frequency at each bus, Hz; NaN: not known."""
        return {bus["name"]: float(self._row[bus["frequency"]]) for bus in self._panel.shown["diagram"]["buses"]}

    def history(self) -> NDArray[np.float64]:
        """Times and differences of frequencies in the last seconds, (samples, 1 + modes)."""
        return np.array(self._signals).reshape(-1, 1 + len(self._panel.modes))


def estimates(
    history: NDArray[np.float64], modes: Sequence[Mode], event_s: float, frequency: float
) -> dict[str, dict[str, float]]:
    """Modes by label from `Live.history`; for a thread beside."""
    if len(history) < 2:
        return {}
    time_s = history[:, 0]
    by_label = {mode.label: estimate(time_s, history[:, 1 + i], event_s, frequency) for i, mode in enumerate(modes)}
    return {label: mode for label, mode in by_label.items() if mode is not None}


def forced_oscillation(history: NDArray[np.float64], event_s: float, frequency: float) -> str:
    """A forced oscillation in the differences of `Live.history`, later than an event (s), in words; empty: none.

    It takes 0.1 s of processor for a minute; for a thread beside.
    """
    known = history[:, 1:][:, np.isfinite(history[:, 1:]).all(axis=0)]
    if len(history) < 2 or not known.shape[1]:
        return ""
    grid = np.arange(history[0, 0], history[-1, 0], 1.0 / RATE)
    x = np.column_stack([np.interp(grid, history[:, 0], signal) for signal in known.T]) / (1e3 * frequency)
    origin = forced.origin(grid, x, max(event_s, float(grid[0]) - 1.0))
    return forced.words(origin, frequency) if origin.kind == forced.FORCED else ""
