"""Messages that would have an effect on the runs of these tests, and the runs."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from facts_damping_msgs.msg import DeviceSetpoint, DeviceSetpoints, PmuDataFrame
from rclpy.serialization import serialize_message

from facts_damping.nodes.transport.tables import FramesMessage, SetpointsMessage
from facts_damping.signals import DELIVERY, NANOSECONDS, SETPOINT, start_of

if TYPE_CHECKING:
    from collections.abc import Callable

    from facts_damping.case.model import Case

CONTROLLER, IDENTIFIER = "controller_0_HBsWC", "identifier_0_ANFGuMoI"  # of these runs
SETS = ["scenario=large", "controllers.0.name=HBsWC", "controllers.0.scheme=indirect"]
LATEST = {
    "pmu/frames": {"wan_link"},
    "pmu/delivered": {CONTROLLER, IDENTIFIER},
    f"{IDENTIFIER}/estimate": {CONTROLLER},
    f"{CONTROLLER}/setpoints": {"wan_link", IDENTIFIER},
    "setpoints/delivered": {"plant_sim"},
}  # by topic: who listens beside the recorder
FAR = 10**9  # ticks
IN_2038 = 2_145_916_800 * NANOSECONDS


def forgeries(case: Case) -> list[tuple[str, Callable[[int], bytes]]]:
    """Messages that would have an effect: topic, and function of the tick that returns the bytes."""
    frames, setpoints = FramesMessage(case), SetpointsMessage(case)

    def start(tick: int) -> int:
        return start_of(tick, case.run.frame_rate)

    def measured(at: int) -> Any:
        rows = np.zeros(1, DELIVERY)
        rows["measured_ns"] = rows["arrival_ns"] = at
        rows["values"] = 0.02
        return rows

    def setpoint(tick: int) -> Any:
        rows = np.zeros(1, SETPOINT)
        rows["measured_ns"] = rows["issued_ns"] = rows["effective_ns"] = start(tick)
        rows["value"] = 0.1 if tick % 2 else -0.1
        return rows

    unknown = DeviceSetpoints(setpoints=[DeviceSetpoint(device="of nobody", controller=CONTROLLER, value_pu=0.1)])
    none = np.zeros(0, SETPOINT)
    return [
        ("setpoints/delivered", lambda _: setpoints.fill(FAR, start(FAR), none, "")),
        ("setpoints/delivered", lambda tick: setpoints.fill(tick, start(tick), setpoint(tick), "")),
        ("setpoints/delivered", lambda _: serialize_message(unknown)),
        (f"{CONTROLLER}/setpoints", lambda tick: setpoints.fill(tick, start(tick), setpoint(tick), CONTROLLER)),
        ("pmu/frames", lambda _: frames.fill(FAR, start(FAR), measured(0), 1)),
        ("pmu/frames", lambda _: serialize_message(PmuDataFrame(tick=2**64 - 1))),
        ("pmu/delivered", lambda tick: frames.fill(tick, IN_2038, measured(IN_2038), 1)),
        ("pmu/delivered", lambda tick: np.random.default_rng(tick).bytes(60)),
    ]
