"""identifier: subscribes to delivered frames and a controller's setpoints, publishes the plant's Jacobian."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from facts_damping_msgs.msg import JacobianEstimate

from facts_damping.case.names import acting, identifier_addresses, link_addresses, setpoint_senders
from facts_damping.control.identifier import identify, store_setpoints, write_estimates
from facts_damping.nodes.admission.member import IDENTIFIER, Member
from facts_damping.nodes.base.live_parameters import declare_settings
from facts_damping.nodes.base.parameters import read_case, read_index, read_options
from facts_damping.nodes.base.qos import PUBLISHER_QOS
from facts_damping.nodes.base.run import run_node
from facts_damping.nodes.base.weights_file import WeightsFile
from facts_damping.nodes.input_collector import UnitDelay
from facts_damping.nodes.transport.messages import Estimates
from facts_damping.signals import ESTIMATE
from facts_damping.simulation.adapted_weights import adapted
from facts_damping.simulation.assembly import build_control

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from facts_damping.nodes.base.managed import ManagedNode
    from facts_damping.parameters.run import Weights

SHARED = ["clip", "projection", "stale"]  # parameters of the controller that an identifier uses too


class IdentifierNode:
    """The identifier of one controller of the run."""

    def __init__(self, node: ManagedNode) -> None:
        self.case, self.options, self.weights = read_case(node), read_options(node), WeightsFile(node)
        addresses = identifier_addresses(self.case)
        self.index = read_index(node, addresses)
        self.case = self.weights.start(self.case, self.index)
        address, link = addresses[self.index], link_addresses(self.case)[self.case.used_links[self.index]]
        self.controller = self.case.controllers[self.index]
        self.row = list(addresses).index(self.index)
        bank, _, self.identifiers, self.state = build_control(self.case)
        hardware = ", ".join(self.controller.devices)
        self.member = member = Member(
            node, self.case, self.options, IDENTIFIER, self.index, address=address, hardware=hardware
        )
        if self.weights.resumed:
            member.change_weights(self.controller)
        names = [name for name in self.controller.parameters if name.startswith("identifier_")] + SHARED
        rows, swing = self.identifiers.settings[self.row], bank.mode_shape[self.index]
        declare_settings(node, self.controller, names, rows, swing, member.change)
        acts = acting(self.case, self.index)
        sender = setpoint_senders(self.case)[acts]
        self.estimates = Estimates(self.case, self.index)
        self.rows = np.zeros(len(self.controller.signals) * len(self.controller.devices), ESTIMATE)
        self.ticks = UnitDelay(self.options, self.case.run.frame_rate, sender.place, self.learn)
        self.to_controller = node.create_publisher(JacobianEstimate, f"{address.name}/estimate", PUBLISHER_QOS)
        member.subscribe_frames(link.topic("pmu/delivered"), self.ticks.frames)
        member.subscribe_setpoints(sender.topic, self.ticks.receive, sender.name, [acts])
        member.message_filter.subscribe_run_state()
        self.spinner, self.activation = member.spin(), member.joining

    def ready(self) -> None:
        """Wait for its link, its controller, and the recorder."""
        self.member.wait({self.to_controller: 1 + int(self.options.recorder)}, self.spinner)

    def run(self) -> None:
        """Serve until stopped, then save the weights."""
        try:
            self.ticks.spin(self.spinner)
        finally:
            self.weights.keep(self.learnt, last=True)

    def learnt(self) -> Weights | None:
        """The adapted weights; None if there are none."""
        return adapted(self.controller, self.index, None, (self.row, self.state))

    def learn(self, tick: int, delivered: NDArray[Any], setpoints: list[NDArray[Any]]) -> None:
        """Process one tick: store earlier setpoints, learn from the frames and, if armed, publish the estimate."""
        self.member.begin(tick)
        learner = self.identifiers, self.state, self.row
        for rows in setpoints:
            store_setpoints(*learner, rows, len(rows))
        identify(*learner, delivered, len(delivered))
        write_estimates(*learner, tick, self.rows, 0)
        if self.member.joining.acts:
            self.to_controller.publish(self.estimates.fill(tick, self.rows, self.state, self.row, self.ticks.latest))
        self.member.report_health(lambda: self.ticks.health("identifies"))
        self.weights.keep(self.learnt)


main = partial(
    run_node, "identifier", IdentifierNode, "The identifier of a controller of the run: estimates the plant's Jacobian."
)
