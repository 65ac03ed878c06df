"""A step of many episodes, in one compiled call."""

from __future__ import annotations

from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray

from facts_damping.compiling import entry_point
from facts_damping.compiling.structs import Array, Bool1, Float1, Float2, Float3, Int1, Struct, Table
from facts_damping.environment.observation import AgentInputs, observe
from facts_damping.link.transfer import RING_DELIVERED
from facts_damping.simulation.measured_plant import tick_ns
from facts_damping.simulation.tick import Loop, run_half_ticks


class Episodes(Struct):
    """Episodes side by side; the first axis is the episode."""

    loops: Table[Loop]
    eyes: Table[AgentInputs]
    waits: Bool1
    ticks: Int1  # the newest
    time_ns: Int1  # its time
    lost: Bool1  # whether synchronism is lost
    agent: int  # index of its controller
    setpoints: Float2  # (episodes, devices), p.u., of that controller
    windows: Annotated[NDArray[Any], Array(np.float32, 4)]  # (episodes, ticks, signals, 3)
    scale: Float1
    weights: Float3  # (episodes, differences, machines)
    deviations: Float2  # (episodes, differences)


@entry_point
def step_many(all_of: Episodes, first: int, stride: int) -> None:
    """A step of the episodes first, first + stride and so on, except those that wait."""
    for e in range(first, len(all_of.loops), stride):
        if all_of.waits[e]:
            continue
        loop, tick, agent = all_of.loops[e], all_of.ticks[e], all_of.agent
        for d in range(all_of.setpoints.shape[1]):
            loop.control.bank_state.unlimited[agent, d] = all_of.setpoints[e, d]
        run_half_ticks(loop, max(0, 2 * tick + 1), 2 * tick + 3)  # second half of this tick, first half of the next
        tick += 1
        kept, links = loop.signals, loop.links
        all_of.ticks[e], all_of.time_ns[e] = tick, kept.time_ns[tick]
        all_of.lost[e] = not kept.in_synchronism[tick]
        link = links.used[agent]
        observe(
            all_of.eyes[e],
            links.up.out[link],
            links.up.ring[link, RING_DELIVERED],
            tick_ns(tick + 1, loop.pmus.frame_rate),
            all_of.windows[e],
            all_of.scale,
            all_of.weights[e],
            kept.machines[tick],
            all_of.deviations[e],
        )
