"""Runs against other programs, an independent model, and finer steps."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from facts_damping.case.loading import load_case, load_system
from facts_damping.parameters.events import Scenario
from facts_damping.plant.build import build, longest_step
from facts_damping.plant.integration import advance
from facts_damping.plant.measurement import measure
from facts_damping.plant.model import copy, workspace
from facts_damping.signals import CHANNELS, DEVICE_TRUTH, MACHINE_TRUTH, SETPOINT, to_ns
from facts_damping.simulation import loop
from facts_damping_validation.small_signal import MACHINES, STABILISERS, STATIC, TURBINE, varied
from facts_damping_validation.table import Row, ValidationTable, figures, within

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray

    from facts_damping.parameters.plant.system import System

FINER = 8  # times the shipped step, of the reference
# System, scenario, devices, controlled by LLC, largest error of a speed in p.u.
STEPS: tuple[tuple[str, str, list[str], bool, float], ...] = (
    ("two_area", "small", ["sssc"], True, 1e-6),
    ("two_area", "small", ["sssc", "statcom"], True, 1e-6),
    ("two_area", "large", ["sssc"], True, 1e-5),
    ("two_area", "large", ["sssc"], False, 2e-5),  # it swings by 0.033 p.u. before it loses synchronism
    ("two_area", "large", ["sssc", "statcom"], True, 1e-5),
    ("two_area", "large", ["sssc", "statcom"], False, 1e-5),
    ("two_area", "multiple", ["sssc"], True, 1e-5),
    ("two_area", "multiple", ["sssc", "statcom"], False, 1e-5),
    ("smib", "nominal", ["sssc"], True, 1e-5),
    ("smib", "light", ["sssc"], False, 1e-5),
    ("smib", "heavy", ["sssc"], False, 1e-5),
    ("smib", "multiple", ["sssc"], True, 1e-5),
    ("wscc_9", "fault_bus7", [], False, 1e-5),
)


class Followed(NamedTuple):
    """Truth of a run at its instants."""

    machines: NDArray[Any]  # MACHINE_TRUTH, (instants, machines)
    devices: NDArray[Any]  # DEVICE_TRUTH, (instants, devices)
    frames: NDArray[np.float64]  # (instants, PMUs, channels)


def unwritten(system: System, devices: int, instants: int) -> Followed:
    """Truth of a run that is yet to be written, of so many devices and instants."""
    return Followed(
        np.zeros((instants, len(system.machines)), MACHINE_TRUTH),
        np.zeros((instants, devices), DEVICE_TRUTH),
        np.zeros((instants, len(system.pmus), len(CHANNELS))),
    )


def follow(
    system: System,
    installed: list[str],
    times: Sequence[float] | NDArray[np.float64],
    events: Sequence[dict[str, Any]] = (),
    setpoints: Mapping[str, float] | None = None,
    dc_voltage: float | None = None,
    asked_at: float | Sequence[float] = 0.0,
) -> Followed:
    """What happens at instants (s), with setpoints of devices from `asked_at` (s, of all or of each, rising) on.

    `dc_voltage`: p.u., at the start.
    """
    built = build(system, installed, Scenario.model_validate({"name": "inline", "events": list(events)}).events)
    state = copy(built.state)
    if dc_voltage is not None:
        state.x[[name.endswith(".vdc") for name in built.state_names]] = dc_voltage
    work, asked = workspace(built.plant, state), np.zeros(len(setpoints or ()), SETPOINT)
    for row, at, (name, value) in zip(
        asked, np.broadcast_to(asked_at, len(asked)), (setpoints or {}).items(), strict=True
    ):
        row["device"], row["value"], row["effective_ns"] = installed.index(name), value, to_ns(float(at))
    followed, now = unwritten(system, len(installed), len(times)), 0
    for k, time in enumerate(times):
        coming = asked[asked["effective_ns"] >= now]
        advance(built.plant, state, now, to_ns(time), coming, len(coming), work)
        now = to_ns(time)
        measure(built.plant, state, now, followed.frames[k], followed.machines[k], followed.devices[k], work)
    return followed


def andes() -> ValidationTable:
    """A fault and a load step in kundur_12_6 against ANDES's trapezoidal rule."""
    system = load_system("kundur_12_6")
    theirs = figures("kundur_12_6_bus8_fault_andes")
    fault = {"time": 1.0, "kind": "fault", "bus": "B8", "duration": 0.1}
    ours = follow(system, [], theirs["t"], [fault]).machines
    rows = [_speeds("fault at B8 for 0.1 s", ours, theirs, 0.001), _angles("fault at B8 for 0.1 s", ours, theirs, 0.01)]
    governors = [{"machine": g, **TURBINE} for g in MACHINES]
    controlled = varied(system, {"exciters": STATIC, "stabilisers": STABILISERS, "governors": governors})
    theirs = figures("kundur_12_6_governor_load_step_andes")
    step = {"time": 1.0, "kind": "load_step", "load": "load_1", "change": 0.05}
    ours = follow(controlled, [], theirs["t"], [step]).machines
    what = "load step with static exciters, stabilisers, governors"
    rows.append(_speeds(what, ours, theirs, 0.001))
    powers = np.array([theirs[f"pm{g}"] for g in range(1, 5)]).T
    rows.append(within(f"{what}: mechanical powers", "p.u. of 900 MVA", ours["mechanical_power"] / 9 - powers, 2e-7))
    command = "facts-damping simulate kundur_12_6_fault"
    return ValidationTable("Time domain of kundur_12_6", "ANDES, steps of 2 ms and 1 ms", command, rows)


def _speeds(what: str, ours: Any, theirs: Any, tolerance: float) -> Row:
    """Speeds, relative to the largest of their deviations."""
    speeds = np.array([theirs[f"w{g}"] - 1 for g in range(1, 5)]).T
    differences = (ours["speed_deviation"] - speeds) / np.abs(speeds).max()
    return within(f"{what}: speeds", "of the peak", differences, tolerance)


def _angles(what: str, ours: Any, theirs: Any, tolerance: float) -> Row:
    angles = np.array([theirs[f"d{g}"] for g in range(1, 5)]).T
    pair = [np.rad2deg(a - a[:, 2:3]) for a in (ours["rotor_angle"], angles)]
    return within(f"{what}: angles against G3", "deg", pair[0] - pair[1], tolerance)


def steps() -> ValidationTable:
    """The shipped step against an eighth of it, all else the same, up to 1 s before a loss of synchronism."""
    rows = []
    for system, scenario, devices, controlled, tolerance in STEPS:
        sets = [f"system={system}", f"scenario={scenario}", f"devices={json.dumps(devices)}"]
        sets += [] if controlled else ["controllers=[]"]
        step = longest_step(load_system(system), devices)
        pair = [loop.run(load_case(None, [*sets, f"system.step={step / finer!r}"])) for finer in (1, FINER)]
        lost = [record.time_s[-1] for record in pair if not record.in_synchronism[-1]]
        ticks = min(len(record.time_s) for record in pair) - (pair[0].configuration["frame_rate"] if lost else 0)
        speeds = [record.machines["speed_deviation"][:ticks] for record in pair]
        control = "LLC" if controlled else "no control"
        what = f"{system} {scenario}, {' and '.join(devices) or 'no device'}, {control}"
        rows.append(within(what, "p.u.", speeds[0] - speeds[1], tolerance))
    return ValidationTable("Error of the speeds at the shipped step", "the same with an eighth of the step", "", rows)
