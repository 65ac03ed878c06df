"""A case run: how it ends, and for how long its inverters gave no current for want of a solution of the network."""

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

    from facts_damping.plant.build import Built
    from facts_damping_reproduction.inverter_faults.cases import Case

AFTERWARDS = 2.0  # s, from the end of the fault to that of the run
RATE = 240  # instants/s at which a run is looked at
LAST = 0.3  # s, the end of a run over which voltages are compared
STILL = 0.02  # p.u., by which a voltage that has settled still moves
LOW = 0.7  # p.u., voltage below which it has not recovered
VOLTAGE = list(CHANNELS).index("voltage_magnitude")
REFUSED, SETTLED, LOW_VOLTAGE, MOVING = "refused", "settled", "low voltage", "moving"
LOST, BROKEN = "out of synchronism", "numerics"


class Outcome(NamedTuple):
    """How a run ended."""

    how: str
    text: str = ""  # of a refusal; what broke
    without: float = 0.0  # s, for which an inverter gave no current, as the network had no solution with it
    voltages: NDArray[np.float64] = np.zeros((0, 0))  # (times, PMUs), p.u.


def started(case: Case, step: float = 1 / 480) -> Built:
    """The plant of a case. Raises `InputError` if limits exclude its start."""
    system = check(System, {**case.system, "step": step}, "system")
    return build(system, [], Scenario.model_validate({"name": "fault", "events": case.events}).events)


def outcome(case: Case, afterwards: float = AFTERWARDS, step: float = 1 / 480) -> Outcome:
    """Run a case."""
    try:
        built = started(case, step)
    except InputError as error:
        return Outcome(REFUSED, str(error))
    plant, state = built.plant, copy(built.state)
    work, frame = workspace(plant, state), np.zeros((len(plant.pmu_machine), len(CHANNELS)))
    machines, devices = np.zeros(len(plant.machines), MACHINE_TRUTH), np.zeros(0, DEVICE_TRUTH)
    of_inverters = plant.ports["kind"] == INVERTER
    end, now, without, voltages = to_ns(case.events[0]["time"] + case.seconds + afterwards), 0, 0, list[Any]()
    how, text = SETTLED, ""
    while now < end and how == SETTLED:
        later = min(end, now + to_ns(1 / RATE))
        advance(plant, state, now, later, np.zeros(0, SETPOINT), 0, work)
        sound, now = measure(plant, state, later, frame, machines, devices, work), later
        voltages.append(frame[:, VOLTAGE].copy())
        without += bool((work.blocked & of_inverters).any())
        if not (np.isfinite(state.x).all() and np.isfinite(state.source).all()):
            broken = [name for name, x in zip(built.state_names, state.x, strict=True) if not np.isfinite(x)]
            how, text = BROKEN, f"at {now * 1e-9:.4f} s: {', '.join(broken) or 'network'}"
        elif not sound:
            how, text = LOST, f"at {now * 1e-9:.3f} s"
    last = np.array(voltages[-round(LAST * RATE) :])
    if how == SETTLED and last.min() < LOW:
        how, text = LOW_VOLTAGE, f"{last.min():.3f} p.u. in the last {LAST:g} s"
    elif how == SETTLED and np.ptp(last, axis=0).max() > STILL:
        how, text = MOVING, f"by {np.ptp(last, axis=0).max():.3f} p.u. in the last {LAST:g} s"
    return Outcome(how, text, without / RATE, np.array(voltages))
