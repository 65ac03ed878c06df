"""The plant with PMUs at its PMUs: measures and advances both; compiled."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from facts_damping.compiling import compiled, entry_point
from facts_damping.compiling.structs import Float2, Int1, Struct
from facts_damping.measurement.pmu_model import Pmus, PmuState, report, take_sample
from facts_damping.plant.integration import advance
from facts_damping.plant.measurement import measure, observe
from facts_damping.plant.model import Plant, PlantState, Work, workspace
from facts_damping.signals import DELIVERY, NEVER, DeviceTruths, MachineTruths, Setpoints, start_of

if TYPE_CHECKING:
    from numpy.typing import NDArray

tick_ns = compiled(start_of)  # of ticks of this run; those of foreign messages may be too large for machine code


class MeasuredPlant(Struct):
    """A plant and its PMUs: constant parameters and state of each."""

    plant: Plant
    plant_state: PlantState
    work: Work
    pmus: Pmus
    pmu_state: PmuState


@entry_point
def measure_with_pmus(
    measured: MeasuredPlant,
    tick: int,
    frame: Float2,
    measured_ns: Int1,
    status: Int1,
    machines: MachineTruths,
    devices: DeviceTruths,
) -> bool:
    """Write the PMUs' frame (`pmu_model.report`) and the true values; returns whether the plant is sound."""
    pmus, work = measured.pmus, measured.work
    start_ns = tick_ns(tick, pmus.frame_rate)
    if pmus.filtered:  # a filter makes the frame from phasors alone
        sound = observe(measured.plant, measured.plant_state, start_ns, machines, devices, work)
    else:
        sound = measure(measured.plant, measured.plant_state, start_ns, frame, machines, devices, work)
    report(pmus, measured.pmu_state, tick, work.phasors, frame, measured_ns, status)
    return sound  # type: ignore[no-any-return]


def with_pmus(plant: Plant, state: PlantState, pmus: Pmus, pmu_state: PmuState) -> MeasuredPlant:
    """A plant with its PMUs."""
    return MeasuredPlant(plant, state, workspace(plant, state, pmus.per_frame - 1), pmus, pmu_state)


def entries(
    start_ns: int, frame: NDArray[np.float64], measured_ns: NDArray[np.int64], status: NDArray[np.int64]
) -> NDArray[Any]:
    """The PMUs' entries (DELIVERY) of a tick begun at `start_ns`, without absent PMUs."""
    there = np.flatnonzero(measured_ns != NEVER)
    rows = np.zeros(len(there), DELIVERY)
    rows["pmu"], rows["values"] = there, frame[there]
    rows["status"], rows["measured_ns"] = status[there], measured_ns[there]
    rows["arrival_ns"] = start_ns
    return rows


@entry_point
def advance_with_pmus(measured: MeasuredPlant, tick: int, setpoints: Setpoints, count: int) -> None:
    """Advance the plant to the next tick under `count` setpoints ordered by time, while PMUs take samples."""
    work, end_ns = measured.work, tick_ns(tick + 1, measured.pmus.frame_rate)
    start_ns = tick_ns(tick, measured.pmus.frame_rate)
    advance(measured.plant, measured.plant_state, start_ns, end_ns, setpoints, count, work)
    for i in range(work.samples.shape[0]):
        take_sample(measured.pmu_state, work.samples[i])
