"""A case run: how it ends, and how much of it the inverters had no solution of the network and gave no current."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from facts_damping.errors import InputError
from facts_damping.parameters.events import Scenario
from facts_damping.parameters.field_errors import check
from facts_damping.parameters.plant.system import System
from facts_damping.plant.build import build
from facts_damping.plant.converters.site import INVERTER
from facts_damping.plant.integration import advance
from facts_damping.plant.measurement import measure
from facts_damping.plant.model import copy, workspace
from facts_damping.signals import CHANNELS, DEVICE_TRUTH, MACHINE_TRUTH, SETPOINT, to_ns

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from facts_damping_reproduction.inverter_faults.cases import Case

AFTERWARDS = 2.0  # s, from the end of the fault to that of the run
RATE = 240  # instants/s at which a run is looked at
LAST = 0.3  # s, the end of a run over which voltages are compared
STILL = 0.02  # p.u., by which a voltage then still moves
VOLTAGE = list(CHANNELS).index("voltage_magnitude")
REFUSED, SETTLED, MOVING, LOST, BROKEN = "refused", "settled", "moving", "out of synchronism", "numerics"


class Outcome(NamedTuple):
    """How a run ended."""

    how: str
    text: str  # of a refusal, or what broke
    without: float  # s, for which at least one inverter gave no current for want of a solution
    voltages: NDArray[np.float64]  # (times, PMUs), p.u.


def outcome(case: Case) -> Outcome:
    """Run a case."""
    none = np.zeros((0, 0))
    try:
        system = check(System, case.system, "system")
        built = build(system, [], Scenario.model_validate({"name": "fault", "events": case.events}).events)
    except InputError as error:
        return Outcome(REFUSED, str(error), 0.0, none)
    plant, state = built.plant, copy(built.state)
    work, pmus = workspace(plant, state), len(plant.pmu_machine)
    frame, nothing = np.zeros((pmus, len(CHANNELS))), np.zeros(0, DEVICE_TRUTH)
    machines, of_inverters = np.zeros(len(plant.machines), MACHINE_TRUTH), plant.ports["kind"] == INVERTER
    end, now, without, seen = to_ns(case.events[0]["time"] + case.seconds + AFTERWARDS), 0, 0, list[Any]()
    while now < end:
        later = min(end, now + to_ns(1 / RATE))
        advance(plant, state, now, later, np.zeros(0, SETPOINT), 0, work)
        now = later
        sound = measure(plant, state, now, frame, machines, nothing, work)
        seen.append(frame[:, VOLTAGE].copy())
        without += bool((work.blocked & of_inverters).any())
        if not (np.isfinite(state.x).all() and np.isfinite(state.source).all()):
            broken = [name for name, x in zip(built.state_names, state.x, strict=True) if not np.isfinite(x)]
            return Outcome(
                BROKEN, f"{now * 1e-9:.4f} s: {', '.join(broken) or 'network'}", without / RATE, np.array(seen)
            )
        if not sound:
            return Outcome(LOST, f"{now * 1e-9:.3f} s", without / RATE, np.array(seen))
    moved = np.ptp(np.array(seen[-round(LAST * RATE) :]), axis=0).max()
    return Outcome(MOVING if moved > STILL else SETTLED, f"{moved:.3f} p.u.", without / RATE, np.array(seen))
