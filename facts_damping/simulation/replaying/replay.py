"""Replay: feeds the delivered frames of a recording to controllers and identifiers, in process.

Controllers run open loop: their setpoints have no effect. Each uses the estimates of its own identifier, which learns
from the recorded setpoints, because those moved the plant. The recorded controllers therefore reproduce their setpoints
bit for bit; other controllers show what they would have commanded.
"""

from __future__ import annotations

from copy import deepcopy
from dataclasses import replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from facts_damping.case.changes import change
from facts_damping.case.loading import load_case, make_case, recorded_case
from facts_damping.case.names import controller_names
from facts_damping.control.table import OWN, RUN
from facts_damping.digest import canonical
from facts_damping.errors import InputError
from facts_damping.parameters.files import each_path, read_sets
from facts_damping.plant.integration import watch
from facts_damping.signals import NANOSECONDS, REFUSED
from facts_damping.simulation.assembly import build_plant
from facts_damping.simulation.changes import by_tick, change_watch
from facts_damping.simulation.measured_plant import tick_ns
from facts_damping.simulation.replaying.replayed_nodes import NodeReplay, Played

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

    from facts_damping.case.model import Case
    from facts_damping.record import Record

# Fields of a controller whose change makes its stored parameters invalid.
SHAPES = ("name", "scheme", "devices", "signals", "profile")


class Difference(NamedTuple):
    """The first setpoint that differs from the recorded one; NaN: missing on that side."""

    tick: int
    controller: str
    device: str
    recorded: float  # p.u.
    replayed: float  # p.u.

    def __str__(self) -> str:
        """One line of text."""
        where = f"tick {self.tick}: {self.controller} to {self.device}"
        return f"{where}: {self.recorded!r} p.u. recorded, {self.replayed!r} p.u. replayed"


def case_of(record: Record, source: str, run: str | None, sets: list[str], *, policy: bool = False) -> Case:
    """The case to replay: that of the recording or of a run (name or path), with `--set` applied.

    If `--set` changes a controller's shape (SHAPES), its stored parameters are dropped; parameters given by the user
    stay if the kind is the same. Raises `InputError` if neither names a run, or if the recording, which may come from
    someone else, names a program that the user has not requested by `policy` or `--set`.
    """
    if run is not None:
        return load_case(run, sets)
    check_has_run(record, source)
    content, (values, origins) = deepcopy(record.configuration), read_sets(sets)
    recorded = recorded_case(content, source)  # files named from here on are named by the user
    changed = {path for key in values for path in each_path(content, key)}
    _forget(content, changed)
    if not policy:
        _refuse_code(content, changed, source)
    if not values:
        return recorded
    change(content, values, origins)
    return make_case(content, source, origins)


def check_has_run(record: Record, source: str, allowed: str = "--run with its run") -> None:
    """Raise `InputError` if a record does not hold its run's configuration, as with `ros2 bag record`.

    `allowed`: what may be given instead, for the error, which ends with the record's notes: one of them has the reason.
    """
    if not record.configuration:
        notes = "; ".join(["", *record.notes])
        raise InputError(f"{source}: holds no run; allowed: {allowed}{notes}")


def _refuse_code(content: dict[str, Any], changes: set[str], source: str) -> None:
    """Raise `InputError` if the content, and not one of the `changes`, names code that would be run."""
    rows = enumerate(content.get("controllers") or [])
    named = ((f"controllers.{i}.{field}", row.get(field)) for i, row in rows for field in RUN)
    for path, value in named:
        if value is not None and path not in changes:
            code = " ".join(value) if isinstance(value, list) else value
            problem = f"{source}: {path}: '{code}' given by the recording"
            raise InputError(f"{problem}; allowed: --policy, to run this code, or another controller by --set")


def _forget(content: dict[str, Any], changes: set[str]) -> None:
    """Drop stored parameters, scheme and weights of controllers with a field of SHAPES among `changes`."""
    asked = (content.get("asked") or {}).get("controllers") or []
    for i, row in enumerate(content.get("controllers") or []):
        changed = {name for name in SHAPES if f"controllers.{i}.{name}" in changes}
        if changed:
            asked_row = asked[i] if i < len(asked) and "name" not in changed else {}
            row["parameters"] = dict(asked_row.get("parameters") or {})
            row["weights"] = None
            for field in OWN if "name" in changed else ():
                row.pop(field, None)
            row["scheme"] = asked_row.get("scheme")


def fitted(record: Record, case: Case) -> Record:
    """The part of a record that a case can replay: up to its first gap, with the case's PMU and device indices.

    Setpoints are assigned to the case's controller of their device. Raises `InputError` if the case has no controller
    or has a PMU or link that was not recorded, or if the frames of the first tick are missing.
    """
    names = [pmu.name for pmu in case.system.pmus]
    missing = [name for name in names if name not in record.pmus]
    if missing:
        raise InputError(f"pmus: '{missing[0]}' was not recorded; there are {', '.join(record.pmus)}")
    if not case.controllers:
        raise InputError("controllers: none given; allowed: at least one, --set controllers.0.name=...")
    notes = "; ".join(["", *record.notes])
    if max(case.used_links) >= record.links:
        raise InputError(f"controllers: {len(case.links)} links given; allowed: {record.links}, as recorded{notes}")
    end = record.gap_tick if record.gap_tick is not None else int(record.ticks[-1]) + 1
    inside = record.ticks < end
    if not inside.any():
        lacks = f"tick {end}: its frames, as delivered, or setpoints are missing"
        raise InputError(f"{lacks}; nothing can be replayed{notes}")
    delivered = record.delivered[record.delivered["tick"] < end]
    places = np.array([names.index(name) if name in names else -1 for name in record.pmus], np.int64)
    delivered["pmu"] = places[delivered["pmu"]]
    pmus = [record.pmus.index(name) for name in names]
    signals: dict[str, Any] = {
        **{name: getattr(record, name)[inside][:, pmus] for name in ("frames", "measured_ns", "status")},
        **{name: _counted(getattr(record, name), record, case, end) for name in ("issued", "supervised", "applied")},
    }
    for name in ("supervision", "estimates", "learning"):
        rows = getattr(record, name)
        signals[name] = rows[rows["tick"] < end]
    return replace(
        record,
        pmus=names,
        device_names=list(case.run.devices),
        controller_names=controller_names(case),
        time_ns=record.time_ns[inside],
        delivered=delivered[delivered["pmu"] >= 0],
        machines=_ordered(record.machines[inside], record.machine_names, [m.name for m in case.system.machines]),
        devices=_ordered(record.devices[inside], record.device_names, case.run.devices),
        in_synchronism=record.in_synchronism[inside],
        **signals,
    )


def _counted(rows: NDArray[Any], record: Record, case: Case, end: int) -> NDArray[Any]:
    """Setpoints before tick `end` with the case's device and controller indices; others are left out."""
    names = list(case.run.devices)
    devices = np.array([names.index(name) if name in names else -1 for name in record.device_names], np.int64)
    commanded = np.full((2, len(names) + 1), -1, np.int64)  # of the controller, of the fallback
    for c, controller in enumerate(case.controllers):
        of = int(controller.fallback_of is not None)
        commanded[of, [names.index(name) for name in controller.devices]] = c
    before = record.configuration.get("controllers") or []
    stands_in = np.array([int(row.get("fallback_of") is not None) for row in before] or [0], np.int64)
    setpoints = rows[rows["tick"] < end].copy()
    setpoints["device"] = devices[setpoints["device"]]
    of = stands_in[np.minimum(setpoints["controller"], len(stands_in) - 1)]
    setpoints["controller"] = commanded[of, setpoints["device"]]
    return np.asarray(setpoints[(setpoints["device"] >= 0) & (setpoints["controller"] >= 0)])


def _ordered(table: NDArray[Any], there: Sequence[str], wanted: Sequence[str]) -> NDArray[Any]:
    """Columns of a table in the wanted order; NaN for missing ones."""
    ordered = np.full((len(table), len(wanted)), np.nan, table.dtype)
    for i, name in enumerate(wanted):
        if name in there:
            ordered[:, i] = table[:, there.index(name)]
    return ordered


def acted(of: Record | Played) -> NDArray[Any]:
    """The setpoints sent down the links: those of supervisors, if there are any."""
    return of.supervised if len(of.supervision) else of.issued


def play(case: Case, record: Record, progress: Callable[[int, int], None] = lambda _done, _of: None) -> Played:
    """Replay a record through a case's controllers, identifiers and supervisors; `record`: from `fitted`.

    Identifiers use the recorded setpoints, because those moved the plant.
    """
    ticks = record.ticks
    arrived = [_by_tick(record.delivered[record.delivered["link"] == link], ticks) for link in range(len(case.links))]
    nodes = NodeReplay(case, record, arrived, _by_tick(acted(record), ticks))
    for at, tick in enumerate(ticks.tolist()):
        nodes.tick(at, tick)
        if at % record.frame_rate == 0 or at + 1 == len(ticks):
            progress(at + 1, len(ticks))
    return nodes.played()


def watched(case: Case, record: Record) -> Record:
    """The record with releases and refused setpoints recomputed by the case's watchdogs; `record`: from `fitted`.

    Re-arming, resets of the plant and releases by the wall clock are as recorded.
    """
    built, devices = build_plant(case), record.devices.copy()
    plant, state = built.plant, built.state
    applied, ticks = _by_tick(record.applied, record.ticks), record.ticks.tolist()
    changes = by_tick(record.changes)
    for at, tick in enumerate(ticks):
        for run_change in changes.get(tick, ()):
            change_watch(case.run.devices, state.watch, run_change, tick_ns(tick, record.frame_rate))
        for name in ("released", *REFUSED):
            devices[name][at] = state.watch[name]
        rows = np.ascontiguousarray(applied[at])
        watch(plant, state, *(tick_ns(k, record.frame_rate) for k in (tick, tick + 1)), rows, len(rows))
    watchdog = case.run.watchdog
    configuration = {**record.configuration, "watchdog": None if watchdog is None else watchdog.model_dump()}
    return replace(record, devices=devices, configuration=configuration)


def _by_tick(rows: NDArray[Any], ticks: NDArray[np.int64]) -> list[NDArray[Any]]:
    """Split rows, sorted by tick, into those of each tick."""
    starts, ends = (np.searchsorted(rows["tick"], ticks, side=side) for side in ("left", "right"))
    return [rows[start:end] for start, end in zip(starts, ends, strict=True)]


def first_difference(record: Record, issued: NDArray[Any]) -> Difference | None:
    """First bit difference of replayed and recorded setpoints, times included; None: identical."""
    recorded, other = canonical(record.issued), canonical(issued)
    if recorded.tobytes() == other.tobytes():
        return None
    both = min(len(recorded), len(other))
    same = [recorded[i].tobytes() == other[i].tobytes() for i in range(both)]
    i = same.index(False) if False in same else both
    sides = [rows[i] if i < len(rows) else None for rows in (recorded, other)]
    row = min((side for side in sides if side is not None), key=lambda side: int(side["tick"]))
    values = [float(side["value"]) if side is not None and side["tick"] == row["tick"] else np.nan for side in sides]
    names = record.controller_names[row["controller"]], record.device_names[row["device"]]
    return Difference(int(row["tick"]), *names, *values)


def first_supervised(record: Record, played: Played) -> int | None:
    """First tick with a bit difference in setpoints or status of supervisors; None: identical."""
    pairs = (record.supervised, played.supervised), (record.supervision, played.supervision)
    ticks = [tick for recorded, other in pairs if (tick := _first_tick(record, recorded, other)) is not None]
    return min(ticks, default=None)


def first_estimate(record: Record, estimates: NDArray[Any]) -> int | None:
    """First tick with a bit difference in the identifiers' estimates; None: identical."""
    return _first_tick(record, record.estimates, estimates)


def first_learning(record: Record, learning: NDArray[Any]) -> int | None:
    """First tick with a bit difference in the networks' learning; None: identical, as far as recorded."""
    there, again = (
        2 * (rows["tick"] << 16) + 2 * rows["controller"] + rows["identifier"] for rows in (record.learning, learning)
    )
    return _first_tick(record, record.learning, learning[np.isin(again, there)])


def _first_tick(record: Record, table: NDArray[Any], other: NDArray[Any]) -> int | None:
    """First tick with a bit difference between the rows of two tables; None: identical."""
    table, other = canonical(table), canonical(other)
    if table.tobytes() == other.tobytes():
        return None
    ticks = record.ticks.tolist()
    differ = (k for k in ticks if table[table["tick"] == k].tobytes() != other[other["tick"] == k].tobytes())
    return int(next(differ, ticks[-1] + 1))


def on_grid(record: Record, issued: NDArray[Any], device: int) -> NDArray[np.float64]:
    """The newest setpoint of a device at the end of each tick, (ticks,), p.u.; 0 before the first."""
    setpoints = issued[issued["device"] == device]
    place = np.searchsorted(setpoints["tick"], record.ticks, side="right")
    return np.asarray(np.concatenate([[0.0], setpoints["value"]])[place])


def beside(case: Case, record: Record, issued: NDArray[Any]) -> list[dict[str, Any]]:
    """Compare recorded and replayed setpoints, a row per device: rms, difference, correlation, saturation duty.

    With supervision, compares the setpoints that act (`acted`). All are sampled once a tick; `correlation` is None if
    one of the two is constant; the duty is the fraction of ticks at the device's limit.
    """
    rows = []
    for d, name in enumerate(case.run.devices):
        recorded, other = on_grid(record, acted(record), d), on_grid(record, issued, d)
        limit, moves = case.system.device(name).setpoint_max, bool(np.ptp(recorded) > 0.0 and np.ptp(other) > 0.0)
        rows.append(
            {
                "device": name,
                "rms_recorded_pu": _rms(recorded),
                "rms_replayed_pu": _rms(other),
                "rms_difference_pu": _rms(other - recorded),
                "max_difference_pu": float(np.abs(other - recorded).max()),
                "correlation": float(np.corrcoef(recorded, other)[0, 1]) if moves else None,
                "saturated_recorded": float(np.mean(np.abs(recorded) >= limit)),
                "saturated_replayed": float(np.mean(np.abs(other) >= limit)),
            }
        )
    return rows


def _rms(values: NDArray[np.float64]) -> float:
    return float(np.sqrt(np.mean(values**2)))


def notes_on(record: Record, played: Record) -> list[str]:
    """Notes on what is not replayed, one line each; `played`: from `fitted`."""
    notes = list(record.notes)
    first, last, end = int(played.ticks[0]), int(played.ticks[-1]), record.gap_tick
    if not record.latest and (len(record.estimates) or len(record.supervision)):
        notes.append("the recording does not say which messages nodes had used: taken as in lockstep")
    if first > 0:
        notes.append(f"the recording begins with tick {first}: earlier learning of controllers is not known")
    if end is not None:
        at = played.time_ns[-1] / NANOSECONDS
        notes.append(f"replayed up to tick {last} at {at:.3f} s: tick {end} is incomplete")
    return notes
