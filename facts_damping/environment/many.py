"""A step of many episodes, in one compiled call."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from facts_damping.compiling import released
from facts_damping.environment.pinning import get_at
from facts_damping.environment.watching import watch
from facts_damping.simulation.measured_plant import tick_ns
from facts_damping.simulation.tick import halves

if TYPE_CHECKING:
    from numpy.typing import NDArray


@released
def step_many(
    addresses: NDArray[Any],
    first: int,
    stride: int,
    waits: NDArray[Any],
    ticks: NDArray[Any],
    time_ns: NDArray[Any],
    lost: NDArray[Any],
    agent: int,
    setpoints: NDArray[Any],
    windows: NDArray[Any],
    scale: NDArray[Any],
    weights: NDArray[Any],
    deviations: NDArray[Any],
    plant: Any,
    plant_state: Any,
    work: Any,
    pmus: Any,
    pmu_state: Any,
    links: Any,
    bank: Any,
    bank_state: Any,
    ids: Any,
    id_state: Any,
    guards: Any,
    guard_state: Any,
    given: Any,
    passed: Any,
    taken: Any,
    kept: Any,
    eyes: Any,
    held: Any,
    seen: Any,
) -> None:
    """A step of the episodes first, first + stride and so on, but for those that wait.

    `addresses`: (episodes, parts), of their pinned parts (`pinning.pin`), of which those that follow are examples;
    `ticks`, `time_ns`, `lost`: the newest tick, its time, whether synchronism is lost; `setpoints`: (episodes,
    devices), p.u., of controller `agent`. Windows and deviations: `watching.watch`.
    """
    for e in range(first, addresses.shape[0], stride):
        if waits[e]:
            continue
        a, tick = addresses[e], ticks[e]
        own, signals = get_at(a[7], bank_state), get_at(a[15], kept)
        up, measured = get_at(a[5], links), get_at(a[3], pmus)
        for d in range(setpoints.shape[1]):
            own.unlimited[agent, d] = setpoints[e, d]
        halves(
            get_at(a[0], plant),
            get_at(a[1], plant_state),
            get_at(a[2], work),
            measured,
            get_at(a[4], pmu_state),
            up,
            get_at(a[6], bank),
            own,
            get_at(a[8], ids),
            get_at(a[9], id_state),
            get_at(a[10], guards),
            get_at(a[11], guard_state),
            get_at(a[12], given),
            get_at(a[13], passed),
            get_at(a[14], taken),
            signals,
            2 * tick + 1,
            2 * tick + 3,
        )
        tick += 1
        ticks[e], time_ns[e], lost[e] = tick, signals.time_ns[tick], not signals.in_synchronism[tick]
        link = up.used[agent]
        watch(
            get_at(a[16], eyes),
            get_at(a[17], held),
            get_at(a[18], seen),
            up.up.out[link],
            up.up.ring[link, 2],
            tick_ns(tick + 1, measured.frame_rate),
            windows[e],
            scale,
            weights[e],
            signals.machines[tick],
            deviations[e],
        )
