"""Cost of one controller step (infer, learn, identify) for every variant, beside the operations of Table 3.1.

MISO is one signal and one device, MIMO speed and power and both devices.
"""

from __future__ import annotations

import statistics
import time
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from facts_damping.case.loading import load_case
from facts_damping.compiling import compiled
from facts_damping.control.bank import act, set_estimate
from facts_damping.control.identifier import identify, store_setpoints, write_estimates
from facts_damping.neurofuzzy.table import VARIANTS
from facts_damping.signals import CHANNELS, DELIVERY, ESTIMATE, SETPOINT
from facts_damping.simulation import loop

if TYPE_CHECKING:
    from numpy.typing import NDArray

STEPS, RUNS = 20_000, 7
PERIOD_NS = 16_666_667
SPEED, POWER = (list(CHANNELS).index(name) for name in ("speed_deviation", "active_power"))
MIMO = ["devices=[sssc, statcom]", "controllers.0.devices=[sssc, statcom]"]


class Operations(NamedTuple):
    """A row of Table 3.1: updated parameters, then operations of one step."""

    parameters: int
    additions: int
    multiplications: int
    divisions: int
    exponentials: int
    trigonometric: int


TABLE_3_1 = {
    "ANFTSC": Operations(10, 6, 16, 5, 4, 0),
    "ANFSC": Operations(12, 6, 18, 5, 0, 0),
    "ANFFsC": Operations(58, 63, 114, 5, 4, 8),
    "ANFGuMeC": Operations(18, 12, 42, 9, 8, 0),
    "ANFGuMoC": Operations(18, 8, 38, 5, 8, 4),
    "ANFTrMeC": Operations(18, 16, 34, 9, 4, 0),
    "ANFTrMoC": Operations(18, 12, 28, 5, 4, 4),
    "ANFLeC": Operations(24, 18, 60, 5, 4, 2),
    "ANFLeWC": Operations(20, 34, 67, 5, 0, 0),
    "ANFBsC": Operations(6, 18, 12, 5, 0, 0),
    "HBsWC": Operations(14, 24, 34, 5, 4, 4),
}


@compiled
def steps(parts: Any, delivered: NDArray[Any], out: NDArray[Any], estimates: NDArray[Any], first: int, n: int) -> None:
    """`n` frames of an oscillation, given to controller 0 and to its identifier if there is one."""
    for k in range(first, first + n):
        for j in range(delivered.size):
            delivered[j].measured_ns = delivered[j].arrival_ns = k * PERIOD_NS
            delivered[j].values[SPEED] = 0.002 * np.sin(0.066 * k + j)
            delivered[j].values[POWER] = 4.0 + np.cos(0.066 * k + j)
        count = act(parts.control.bank, parts.control.bank_state, 0, k, delivered, delivered.size, out, 0)
        for i in range(parts.control.identifiers.controller.size):
            identify(parts.control.identifiers, parts.control.identifier_state, i, delivered, delivered.size)
            store_setpoints(parts.control.identifiers, parts.control.identifier_state, i, out, count)
            write_estimates(parts.control.identifiers, parts.control.identifier_state, i, k, estimates, 0)
            learnt = parts.control.identifier_state
            set_estimate(parts.control.bank_state, 0, learnt.jacobian[i], learnt.change[i], learnt.held.newest_ns[i])


def step_us(name: str, scheme: str | None, *more: str) -> float:
    """Median time of one step, microseconds."""
    controller_sets = [f"controllers.0.name={name}", *([f"controllers.0.scheme={scheme}"] if scheme else [])]
    case = load_case(None, [*controller_sets, *more])
    parts = loop.build_loop(case)
    delivered = np.zeros(len(case.system.pmus), DELIVERY)
    delivered["pmu"] = np.arange(len(delivered))
    out, estimates = np.zeros(16, SETPOINT), np.zeros(16, ESTIMATE)
    times = []
    for run in range(RUNS + 1):
        began = time.perf_counter()
        steps(parts, delivered, out, estimates, run * STEPS, STEPS)
        times.append(time.perf_counter() - began)
    return 1e6 * statistics.median(times[1:]) / STEPS


def main() -> None:
    """A row a variant; LLC's own step is what taking frames and issuing setpoints costs."""
    lead_lag, both = step_us("LLC", None), step_us("LLC", None, *MIMO)
    heads = ["MISO direct [us]", "indirect [us]", "direct / LLC", "MIMO direct [us]", "indirect [us]"]
    print(f"| controller | {' | '.join([*heads, *Operations._fields])} |")
    print(f"| --- |{' --: |' * (len(heads) + len(Operations._fields))}")
    print(f"| LLC | {lead_lag:.2f} | | 1.0 | {both:.2f} | |{' |' * len(Operations._fields)}")
    lqg, centralised = step_us("LQG", None), step_us("LQG", None, *MIMO, "controllers.0.signals=[speed, power]")
    print(f"| LQG | {lqg:.2f} | | {lqg / lead_lag:.1f} | {centralised:.2f} | |{' |' * len(Operations._fields)}")
    for name in VARIANTS:
        direct, indirect = step_us(name, "direct"), step_us(name, "indirect")
        more = [*MIMO, "controllers.0.signals=[speed, power]"]
        several = [step_us(name, scheme, *more) for scheme in ("direct", "indirect")]
        counts = " | ".join(str(count) for count in TABLE_3_1[name])
        times = f"{direct:.2f} | {indirect:.2f} | {direct / lead_lag:.1f} | {several[0]:.2f} | {several[1]:.2f}"
        print(f"| {name} | {times} | {counts} |")


if __name__ == "__main__":
    main()
