"""controller: subscribes to delivered frames, publishes setpoints and its state; one MIMO or several MISO."""

from __future__ import annotations

from typing import TYPE_CHECKING

from facts_damping_msgs.msg import ControllerState, PmuDataFrame, VoltageSetpoints
from rcl_interfaces.msg import SetParametersResult

from facts_damping.control.bank import act, parameters
from facts_damping.control.table import CONTROLLERS
from facts_damping.errors import InputError
from facts_damping.loop import build_bank, controller_names, issue_room, rehearse, tick_ns
from facts_damping.nodes.messages import Inner
from facts_damping.nodes.node import RELIABLE, publish, run_node, wait_for_peers
from facts_damping.nodes.parameters import descriptor, read_case, read_options
from facts_damping.nodes.spinning import Spinner
from facts_damping.nodes.tables import Frames, Setpoints

if TYPE_CHECKING:
    from rclpy.node import Node
    from rclpy.parameter import Parameter


class ControllerNode:
    """One controller of the run."""

    def __init__(self, node: Node) -> None:
        """Read parameters, build the controller, wire the topics."""
        self.case, self.options = read_case(node), read_options(node)
        count = len(self.case.run.controllers)
        self.index = int(
            node.declare_parameter("index", 0, descriptor("which of the run's controllers this is", "", 0, 15)).value
        )
        if self.index >= count:
            raise InputError(f"index: {self.index} given; allowed: 0 to {count - 1}, the run's controllers")
        self.bank, self.state = build_bank(self.case)
        self.kind = CONTROLLERS[self.case.run.controllers[self.index].name]
        self.declare(node)
        self.frames, self.setpoints = Frames(self.case), Setpoints(self.case)
        self.name = controller_names(self.case)[self.index]
        self.inner = Inner(self.case, self.index)
        self.to_link = node.create_publisher(VoltageSetpoints, f"{self.name}/setpoints", RELIABLE)
        self.to_recorder = node.create_publisher(ControllerState, f"{self.name}/state", RELIABLE)
        node.create_subscription(PmuDataFrame, "pmu/delivered", self.on_frames, RELIABLE, raw=True)
        rehearse(self.case)
        self.spinner = Spinner(node)
        extra = int(self.options.recorder)
        wait_for_peers(node, {self.to_link: 1 + extra, self.to_recorder: extra}, self.options)

    def declare(self, node: Node) -> None:
        """Declare the kind's parameters; they may change while it runs."""
        row = self.bank.parameters[self.index]
        values = parameters(self.case.run.controllers[self.index])
        for i, (name, p) in enumerate(self.kind.parameters.items()):
            made = descriptor(p.description, p.unit, p.low, p.high, read_only=False)
            row[i] = node.declare_parameter(name, values[i], made).value
        node.add_on_set_parameters_callback(self.on_parameters)

    def on_parameters(self, changed: list[Parameter[float]]) -> SetParametersResult:
        """Take changed parameters over; rclpy has checked their ranges."""
        names = list(self.kind.parameters)
        for parameter in changed:
            if parameter.name in names:
                self.bank.parameters[self.index, names.index(parameter.name)] = parameter.value
        return SetParametersResult(successful=True)

    def run(self) -> None:
        """Serve until stopped."""
        while True:
            self.spinner.turn(1.0)

    def on_frames(self, data: bytes) -> None:
        """One tick: act on what was delivered, answer also when nothing was."""
        state, c = self.state, self.index
        tick, delivered = self.frames.read(data)
        start = tick_ns(tick, self.case.run.frame_rate)
        issued = issue_room(len(self.case.run.controllers[c].devices), len(delivered))
        count = act(self.bank, state, c, tick, delivered, len(delivered), issued, 0)
        publish(self.to_link, self.setpoints.fill(tick, start, issued[:count], self.name))
        inner = self.inner.fill(tick, start, len(delivered) > 0, state.inputs[c], state.unlimited[c], state.outputs[c])
        publish(self.to_recorder, inner)


def main() -> None:
    """Entry point of `ros2 run facts_damping controller`."""
    run_node("controller", ControllerNode)


if __name__ == "__main__":
    main()
