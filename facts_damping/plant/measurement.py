"""What the PMUs see, and the truth that they do not; compiled."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from facts_damping.compiling import compiled
from facts_damping.plant import excitation
from facts_damping.plant.dynamics import row_times, solve_network, stator
from facts_damping.plant.machine import ROTOR_STATES
from facts_damping.plant.model import stage_at

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from facts_damping.plant.model import Plant, PlantState, Work


@compiled
def measure(
    plant: Plant,
    state: PlantState,
    time_ns: int,
    frame: NDArray[np.float64],
    machines: NDArray[Any],
    devices: NDArray[Any],
    work: Work,
) -> bool:
    """What the PMUs see at an instant, and the truth: fills `frame` (stations, channels), MACHINE_TRUTH, DEVICE_TRUTH.

    Returns whether the plant is sound: all states finite and the rotor angles of the machines in service
    within 180 degrees of each other.
    """
    stage = stage_at(plant, time_ns)
    x = state.x
    found = solve_network(plant, x, state.reference, stage, work)
    count = plant.machines.size
    low, high, sound = math.inf, -math.inf, True
    for i in range(x.size):
        sound = sound and math.isfinite(x[i])
    for g in range(count):
        voltage, _, power = stator(plant, stage, g, work)
        delta = x[ROTOR_STATES * g]
        machines[g].rotor_angle = delta
        machines[g].speed_deviation = x[ROTOR_STATES * g + 1]
        machines[g].electrical_power = power * plant.machines[g].ratio
        machines[g].field_voltage = excitation.field_voltage(plant.exciters[g], x)
        machines[g].terminal_voltage = abs(voltage)
        if plant.online[stage, g] > 0.0:
            low, high = min(low, delta), max(high, delta)
    for p in range(plant.converters.size):
        devices[p].setpoint = state.target[p]
        devices[p].reference = state.reference[p]
        devices[p].injected_voltage = -(found.v_q + plant.converters[p].xs * found.magnitude)
        devices[p].active_voltage = found.v_p
        devices[p].current = found.magnitude
        devices[p].dc_voltage = x[plant.converters[p].offset + 2]
        devices[p].blocked = 1.0 if found.blocked else 0.0
    first = count + plant.converters.size
    stations = plant.station_machine.size
    for s in range(stations):
        voltage = row_times(plant, stage, first + s, work.injection)
        current = row_times(plant, stage, first + stations + s, work.injection)
        g = plant.station_machine[s]
        flow = voltage * current.conjugate()
        frame[s, 0] = abs(voltage)
        frame[s, 1] = math.atan2(voltage.imag, voltage.real)
        frame[s, 2] = math.nan if g < 0 else x[ROTOR_STATES * g + 1]
        frame[s, 3] = flow.real
        frame[s, 4] = flow.imag
    return sound and not high - low > math.pi
