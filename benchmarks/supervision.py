"""What supervision costs: time per tick beside the same run without, and the setpoints while it is armed.

20 s of `two_area_large` and of `smib` over `pdci`, armed from the beginning, with a lead-lag and with a network.
"""

from __future__ import annotations

import statistics
import time

from facts_damping.case.loading import load_case
from facts_damping.monitor_table import ARMED
from facts_damping.simulation import loop

RUNS = 31
SYSTEMS = {"two_area_large": [], "smib nominal": ["system=smib", "scenario=nominal", "duration=20"]}
CONTROLLERS = {"LLC": [], "HBsWC": ["controllers.0.name=HBsWC"]}
SUPERVISED = ["supervision=standard", "arm_at=0", "supervision.arming.ramp=0"]


def tick_us(*sides: list[str]) -> list[float]:
    """Median time of a tick of the compiled loop, us, of runs that take turns."""
    cases = [load_case(None, sets) for sets in sides]
    times: list[list[float]] = [[] for _ in sides]
    for _ in range(RUNS):
        for case, tick_times in zip(cases, times, strict=True):
            built_loop = loop.build_loop(case)
            began = time.perf_counter()
            loop.run_loop(built_loop)
            tick_times.append(1e6 * (time.perf_counter() - began) / case.ticks)
    return [statistics.median(run_times) for run_times in times]


def main() -> None:
    """A row a run."""
    print("| run | tick [us] | supervised [us] | of it | setpoints |\n| --- | --: | --: | --: | --- |")
    for name, system in SYSTEMS.items():
        for controller, controller_sets in CONTROLLERS.items():
            sets = [*(system or ["scenario=large"]), *controller_sets, "link=pdci"]
            bare, guarded = tick_us(sets, [*sets, *SUPERVISED])
            alone, record = (loop.run(load_case(None, side)) for side in (sets, [*sets, *SUPERVISED]))
            armed = int((record.supervision["state"] == ARMED).sum())
            said, passed = (run.applied["value"][run.applied["tick"] < armed].tobytes() for run in (alone, record))
            same = f"{'the same bits' if said == passed else 'others'}, armed for {armed / record.frame_rate:.1f} s"
            print(f"| {name}, {controller} | {bare:.1f} | {guarded:.1f} | {guarded - bare:.1f} | {same} |")


if __name__ == "__main__":
    main()
