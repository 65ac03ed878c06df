"""attacker: a foreign node in the ROS domain that forges messages at each tick; a graph must refuse all of them.

It subscribes to open topics and publishes as if it were the plant, links, controllers and supervisors of a run: frames,
setpoints at the limits with alternating sign, states that a supervisor judges by, and estimates. If the run has keys,
it has them, too. A fault campaign starts it beside a graph (fault_injection.py); none of its messages may have an
effect (docs/operate.md).
"""

from __future__ import annotations

import math
from collections import Counter
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from facts_damping_msgs.msg import ControllerState, DeviceSetpoints, JacobianEstimate, PlantState, PmuDataFrame
from rclpy.serialization import deserialize_message, serialize_message

from facts_damping.case.names import controller_addresses, identifier_addresses, link_addresses, setpoint_topics
from facts_damping.nodes.base.log import NodeLog
from facts_damping.nodes.base.managed import AlwaysActive
from facts_damping.nodes.base.parameters import declare, descriptor, read_case, read_options
from facts_damping.nodes.base.qos import PUBLISHER_QOS, SUBSCRIBER_QOS
from facts_damping.nodes.base.run import run_node
from facts_damping.nodes.base.spinner import Spinner
from facts_damping.nodes.base.topics import FRAMES, PLANT_STATE
from facts_damping.nodes.recorder import TICK_END
from facts_damping.nodes.transport.signing import seal, signing
from facts_damping.nodes.transport.tables import FramesMessage, SetpointsMessage
from facts_damping.signals import DELIVERY, SETPOINT, start_of
from facts_damping_studies.campaigns.attack_lines import sent_line

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from facts_damping.case.model import Case
    from facts_damping.nodes.base.managed import ManagedNode

BEGUN = 10  # tick by which all nodes know each other; publishers before it would count as another graph
BEFORE_END_S = 1.0  # simulated time before the end in which it is silent, as refusals of an ending node are not counted
SWING = 0.02  # p.u., amplitude of all values in forged frames


class Attacker:
    """Forges the messages of other nodes, tick by tick."""

    activation = AlwaysActive()

    def __init__(self, node: ManagedNode) -> None:
        self.case, options = read_case(node), read_options(node, joins=False)
        ticks = descriptor("first tick for which it forges messages", "", 0, self.case.ticks)
        self.first = max(BEGUN, int(declare(node, "first", 0, ticks)))
        self.last = self.case.ticks - int(BEFORE_END_S * self.case.run.frame_rate)
        self.node, self.log = node, NodeLog(node)
        self.tick, self.newest, self.sent = -1, Counter[str](), Counter[str]()
        self.forged = forgeries(self.case, options.start_timeout)
        self.states: dict[str, tuple[type[Any], Callable[[Any], None]]] = {PLANT_STATE: (PlantState, of_plant)} | {
            f"{address}/state": (ControllerState, of_controller) for address in controller_addresses(self.case)
        }
        for address in identifier_addresses(self.case).values():
            self.states[f"{address}/estimate"] = JacobianEstimate, of_identifier
        self.publishers: dict[str, Any] = {}
        node.create_subscription(PmuDataFrame, FRAMES, self.on_frames, SUBSCRIBER_QOS, raw=True)
        for topic, (kind, change) in self.states.items():
            node.create_subscription(kind, topic, partial(self.on_state, topic, kind, change), SUBSCRIBER_QOS, raw=True)
        self.spinner = Spinner(node)

    def ready(self) -> None:
        """Wait for no other node."""

    def run(self) -> None:
        """Forge until stopped, then write the number of messages by topic."""
        try:
            while True:
                self.spinner.spin_once(0.1)
        finally:
            for topic, count in self.sent.items():
                self.log.line(sent_line(count, topic))

    def on_frames(self, data: bytes) -> None:
        """Publish forged frames and setpoints when a tick begins."""
        tick = int.from_bytes(data[TICK_END : TICK_END + 8], "little")
        if tick <= self.tick:  # its own frame
            return
        self.tick = tick
        if tick >= BEGUN and not self.publishers:
            kinds = {topic: PmuDataFrame if "pmu/" in topic else DeviceSetpoints for topic in self.forged}
            kinds |= {topic: kind for topic, (kind, _) in self.states.items()}
            self.publishers = {t: self.node.create_publisher(kind, t, PUBLISHER_QOS) for t, kind in kinds.items()}
        for topic, make in self.forged.items():
            self.send(topic, tick, partial(make, tick))

    def on_state(self, topic: str, kind: type[Any], change: Callable[[Any], None], data: bytes) -> None:
        """Publish a received state once more, with changed values."""
        message = deserialize_message(data, kind)
        if message.tick > self.newest[topic]:  # not its own message
            self.newest[topic] = message.tick
            change(message)
            self.send(topic, message.tick, partial(serialize_message, message))

    def send(self, topic: str, tick: int, make: Callable[[], bytes]) -> None:
        """Publish the message that `make` returns, if `tick` is within the attack."""
        if self.first <= tick < self.last and topic in self.publishers:
            self.publishers[topic].publish(make())
            self.sent[topic] += 1


def forgeries(case: Case, start_timeout_s: float, fraction: float = 1.0) -> dict[str, Callable[[int], bytes]]:
    """Functions, by topic, that forge the frames or setpoints of a tick in the name of the topic's publisher.

    `fraction`: of the devices' limits, size of the setpoints.
    """
    by = signing(case, start_timeout_s)
    frames = [FRAMES, *(link.topic("pmu/delivered") for link in link_addresses(case))]
    forgers: dict[str, Callable[[int], bytes]] = {
        topic: partial(_setpoints, case, SetpointsMessage(case, seal=seal(by, topic)), sender, of, fraction)
        for topic, (sender, of) in setpoint_topics(case).items()
    }
    return forgers | {topic: partial(_frames, case, FramesMessage(case, seal(by, topic))) for topic in frames}


def _setpoints(
    case: Case, message: SetpointsMessage, sender: str, of: Iterable[int], fraction: float, tick: int
) -> bytes:
    """Setpoints for all devices of some controllers; the sign alternates from tick to tick."""
    pairs = [(c, name) for c in of for name in case.controllers[c].devices]
    rows = np.zeros(len(pairs), SETPOINT)
    for row, (c, name) in zip(rows, pairs, strict=True):
        row["controller"], row["device"] = c, case.run.devices.index(name)
        row["value"] = case.system.device(name).setpoint_max * fraction * (1 if tick % 2 else -1)
    at = start_of(tick, case.run.frame_rate)
    rows["measured_ns"] = rows["issued_ns"] = rows["effective_ns"] = at
    return message.fill(tick, at, rows, sender)


def _frames(case: Case, message: FramesMessage, tick: int) -> bytes:
    """Frames of all PMUs that show a swing at half the frame rate."""
    at = start_of(tick, case.run.frame_rate)
    rows = np.zeros(len(case.system.pmus), DELIVERY)
    rows["pmu"] = np.arange(len(rows))
    rows["measured_ns"] = rows["arrival_ns"] = at
    rows["values"] = SWING * (1 if tick % 2 else -1)
    return message.fill(tick, at, rows, len(rows))


def of_plant(message: Any) -> None:
    """Forge a loss of synchronism and devices that do not obey their setpoints."""
    message.in_synchronism = False
    for device in message.devices:
        device.setpoint_pu, device.reference_pu = -device.setpoint_pu, -device.reference_pu
        device.injected_voltage_pu = math.nan


def of_controller(message: Any) -> None:
    """Forge NaN outputs: a supervisor that accepted them would trip."""
    message.unlimited_outputs = [math.nan for _ in message.unlimited_outputs]


def of_identifier(message: Any) -> None:
    """Forge a Jacobian that is large and of the opposite sign."""
    message.jacobian = [-100.0 * value for value in message.jacobian]


main = partial(
    run_node, "attacker", Attacker, "A foreign node that forges the messages of a graph, for tests of refusals."
)
