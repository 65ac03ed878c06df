"""The plant with PMUs at its PMUs: measures and advances both; compiled."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from facts_damping.compiling import compiled, entry_point
from facts_damping.compiling.structs import Float2, Int1, Struct
from facts_damping.measurement.pmu_model import Pmus, PmuState, report, take_sample
from facts_damping.plant.integration import advance
from facts_damping.plant.measurement import measure, sample
from facts_damping.plant.model import Plant, PlantState, Work, workspace
from facts_damping.signals import DELIVERY, NANOSECONDS, NEVER, DeviceTruths, MachineTruths, Setpoints, start_of

if TYPE_CHECKING:
    from numpy.typing import NDArray

LONG = 1.5  # samples
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
    sound = measure(measured.plant, measured.plant_state, start_ns, frame, machines, devices, work)
    report(pmus, measured.pmu_state, tick, work.phasors, frame, measured_ns, status)
    return sound  # type: ignore[no-any-return]


def with_pmus(plant: Plant, state: PlantState, pmus: Pmus, pmu_state: PmuState) -> MeasuredPlant:
    """A plant with its PMUs; of one whose steps are longer than `LONG` samples these lie within its steps."""
    within = plant.step_ns * pmus.per_frame * pmus.frame_rate > LONG * NANOSECONDS
    work = workspace(plant, state, pmus.per_frame - 1 if within else 0)
    return MeasuredPlant(plant, state, work, pmus, pmu_state)


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
    """Advance the plant to the next tick under `count` setpoints ordered by time, while PMUs take samples.

    A step ends at each sample, unless steps are so long that samples lie within them (`with_pmus`).
    """
    plant, plant_state, pmus, work = measured.plant, measured.plant_state, measured.pmus, measured.work
    now, first = tick_ns(tick, pmus.frame_rate), 0
    if work.samples.shape[0] > 0:
        advance(plant, plant_state, now, tick_ns(tick + 1, pmus.frame_rate), setpoints, count, work)
        for i in range(work.samples.shape[0]):
            take_sample(measured.pmu_state, work.samples[i])
        return
    samples = pmus.per_frame * pmus.frame_rate
    for i in range(1, pmus.per_frame + 1):
        end = tick_ns(tick * pmus.per_frame + i, samples)
        last = first
        while last < count and (setpoints[last].effective_ns < end or i == pmus.per_frame):
            last += 1
        advance(plant, plant_state, now, end, setpoints[first:last], last - first, work)
        if i < pmus.per_frame:
            sample(plant, plant_state, end, work)
            take_sample(measured.pmu_state, work.phasors)
        now, first = end, last
