"""Cost of one controller step (infer, learn, identify) for every variant, beside the operations of Table 3.1."""

from __future__ import annotations

import statistics
import time
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from facts_damping import loop
from facts_damping.compiling import compiled
from facts_damping.configuration import load_case
from facts_damping.control.bank import act
from facts_damping.control.identifier import identify, remember, tell
from facts_damping.neurofuzzy.table import VARIANTS
from facts_damping.signals import CHANNELS, DELIVERY, ESTIMATE, SETPOINT

if TYPE_CHECKING:
    from numpy.typing import NDArray

STEPS, RUNS = 20_000, 7
PERIOD_NS = 16_666_667
SPEED = list(CHANNELS).index("speed_deviation")


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
        count = act(parts.bank, parts.bank_state, 0, k, delivered, delivered.size, out, 0)
        for i in range(parts.identifiers.controller.size):
            identify(parts.identifiers, parts.identifier_state, i, delivered, delivered.size)
            remember(parts.identifiers, parts.identifier_state, i, out, count)
            tell(parts.identifiers, parts.identifier_state, i, k, estimates, 0)
            parts.bank_state.jacobian[0, 0, 0] = parts.identifier_state.jacobian[i, 0, 0]


def step_us(name: str, scheme: str | None) -> float:
    """Median time of one step, microseconds."""
    own = [f"controllers.0.name={name}", *([f"controllers.0.scheme={scheme}"] if scheme else [])]
    case = load_case(None, own)
    parts = loop.build_loop(case)
    delivered = np.zeros(len(case.system.stations), DELIVERY)
    delivered["station"] = np.arange(len(delivered))
    out, estimates = np.zeros(8, SETPOINT), np.zeros(8, ESTIMATE)
    times = []
    for run in range(RUNS + 1):
        began = time.perf_counter()
        steps(parts, delivered, out, estimates, run * STEPS, STEPS)
        times.append(time.perf_counter() - began)
    return 1e6 * statistics.median(times[1:]) / STEPS


def main() -> None:
    """A row a variant; LLC's own step is what taking frames and issuing setpoints costs."""
    lead_lag = step_us("LLC", None)
    print(f"| controller | direct [us] | indirect [us] | direct / LLC | {' | '.join(Operations._fields)} |")
    print(f"| --- |{' --: |' * (3 + len(Operations._fields))}")
    print(f"| LLC | {lead_lag:.2f} | | 1.0 |{' |' * len(Operations._fields)}")
    for name in VARIANTS:
        direct, indirect = step_us(name, "direct"), step_us(name, "indirect")
        counts = " | ".join(str(count) for count in TABLE_3_1[name])
        print(f"| {name} | {direct:.2f} | {indirect:.2f} | {direct / lead_lag:.1f} | {counts} |")


if __name__ == "__main__":
    main()
