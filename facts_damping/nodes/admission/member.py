"""What all nodes of a graph have in common: wait for peers, filter messages, publish diagnostics and changes."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from facts_damping_msgs.msg import DeviceSetpoints, PmuDataFrame, RunChange

from facts_damping.case.names import label
from facts_damping.nodes import clock
from facts_damping.nodes.admission.joining import Joining
from facts_damping.nodes.admission.message_filter import MessageFilter
from facts_damping.nodes.admission.publishers import Reading
from facts_damping.nodes.base.qos import LOGGED, PUBLISHER_QOS
from facts_damping.nodes.base.spinner import Spinner
from facts_damping.nodes.base.topics import CHANGES, DIAGNOSTICS, graph_prefix
from facts_damping.nodes.transport import stamps
from facts_damping.nodes.transport.messages import Health, diagnostics, stamped
from facts_damping.nodes.transport.signing import seal, signing
from facts_damping.nodes.transport.tables import FramesMessage, SetpointsMessage
from facts_damping.parameters.run import Weights
from facts_damping.parameters.yaml_text import dump
from facts_damping.recording.events import ROLES
from facts_damping.simulation.measured_plant import tick_ns
from facts_damping.version import __version__

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from numpy.typing import NDArray
    from rclpy.lifecycle import LifecycleNode
    from rclpy.publisher import Publisher

    from facts_damping.case.model import Case
    from facts_damping.case.names import Address
    from facts_damping.nodes.base.parameters import Options
    from facts_damping.nodes.transport.signing import Seal
    from facts_damping.parameters.run import Controller

(PLANT, LINK, CONTROLLER, IDENTIFIER, SUPERVISOR), RECORDER = ROLES, "recorder"  # a recorder changes nothing
NUMBERED = (LINK, CONTROLLER, IDENTIFIER, SUPERVISOR)  # roles that a run may have several nodes of
IDLE_S = 1.0  # wall time without a message before a node reports it, and between two such reports


class Member:
    """Membership of a node in the graph of a run: message filter, arming, changes, diagnostics."""

    def __init__(
        self,
        node: LifecycleNode,
        case: Case,
        options: Options,
        role: str,
        index: int = 0,
        *,
        address: Address | None = None,
        hardware: str = "",
        send_refusals: Callable[[bytes], None] | None = None,
    ) -> None:
        """`role`, `index`: the node's place in the run; `hardware`: what it represents or commands, for diagnostics.

        `address`: of the node, if it may be in a namespace below the graph's; `send_refusals`: as in MessageFilter.
        """
        graph = "" if address is None else graph_prefix(node, address)
        self._case, self.graph, self._signing = case, graph, signing(case, options.start_timeout)
        self._node, self._options, self._role, self._index, self._hardware = node, options, role, index, hardware
        self._rate, self._name = case.run.frame_rate, node.get_fully_qualified_name()
        stamps.begin(learns=options.paced and role not in (PLANT, RECORDER))
        self.message_filter = MessageFilter(node, case, options, graph, send_refusals, leads=role == PLANT)
        # A supervisor starts in shadow and has its own arming.
        self.joining = Joining(node, options, arms=role in (LINK, CONTROLLER, IDENTIFIER))
        self._changes: Publisher[Any] = node.create_publisher(RunChange, f"{graph}{CHANGES}", LOGGED)
        self._diagnostics: Publisher[Any] = node.create_publisher(DiagnosticArray, DIAGNOSTICS, PUBLISHER_QOS)
        self._pending: list[tuple[str, str, Any, Callable[[int], None] | None]] = []
        self._tick, self._reported_at = -1, clock.monotonic()
        self._what = f"{role} {index}" if role in NUMBERED else role
        self._run = label(case.summary())
        self.at_ns = 0  # start of the newest tick

    def seal(self, topic: str) -> Seal | None:
        """Seal of a topic, given relative to the graph's namespace; None if messages are not signed."""
        return seal(self._signing, topic)

    def subscribe_frames(self, topic: str, use: Callable[[int, NDArray[Any]], None]) -> None:
        """Subscribe to the frames of a topic; `use(tick, rows)`."""
        read = FramesMessage(self._case, self.seal(topic)).read
        self.message_filter.subscribe(PmuDataFrame, f"{self.graph}{topic}", use, Reading(read), leads=True)

    def subscribe_setpoints(
        self,
        topic: str,
        use: Callable[[int, NDArray[Any]], None],
        sender: str = "",
        of: Iterable[int] | None = None,
        newest: Callable[[], int] | None = None,
    ) -> None:
        """Subscribe to setpoints: `use(tick, rows)`; `sender`, `of`: see SetpointsMessage; `newest`: Reading."""
        read = SetpointsMessage(self._case, sender, of, self.seal(topic)).read
        self.message_filter.subscribe(DeviceSetpoints, f"{self.graph}{topic}", use, Reading(read, newest))

    def spin(self) -> Spinner:
        """Make the node's spinner. Call this after the last subscription and service is created."""
        return Spinner(self._node, self)

    def wait(self, expected: dict[Publisher[Any], int], spinner: Spinner) -> None:
        """Wait for the peers; `expected`: number of subscribers per publisher.

        If a recorder is awaited, it must also subscribe to changes and diagnostics.
        """
        self.log_started()
        extra = int(self._options.recorder)
        self.message_filter.wait_for_peers(expected | {self._changes: extra, self._diagnostics: extra}, spinner.serve)

    def log_started(self) -> None:
        """Log the version, the run and the mode."""
        of = f"{self._what} of {self._run}, mode {self._options.mode}"
        self.message_filter.log.info(f"started: facts_damping {__version__}, {of}")

    def change(self, kind: str, name: str = "", value: Any = None, act: Callable[[int], None] | None = None) -> None:
        """Queue a change for the next tick: `act(tick)` is called and the change is published then."""
        self._pending.append((kind, name, value, act))

    def change_weights(self, controller: Controller) -> None:
        """Queue the report of the weights with which a resumed node begins."""
        if isinstance(controller.weights, Weights):
            self.change("weights", "", controller.weights.model_dump())

    def begin(self, tick: int) -> None:
        """Begin a tick: apply and publish the changes queued since the last one."""
        start, late = tick_ns(tick, self._rate), self._tick < 0 < tick
        changed = self.joining.begin(start)
        if late:
            self._pending.insert(0, ("start", "", None if self.joining.acts else "disarmed", None))
        self._tick, self.at_ns = tick, start
        while self._pending:
            kind, name, value, act = self._pending.pop(0)
            if act is not None:
                act(tick)
            self._publish_change(kind, name, value)
        if changed in ("arm", "disarm") and not late:
            self._publish_change(changed, "", None)
        if changed and (joined := self.joining.health()) is not None:
            self.message_filter.log.report(joined.message)
            self.publish(joined)

    def _publish_change(self, kind: str, name: str, value: Any) -> None:
        change = RunChange(node=self._name, role=self._role, index=self._index, kind=kind, name=name, tick=self._tick)
        change.value = "" if value is None else dump(value).strip()
        self._changes.publish(stamped(change, self.at_ns))

    def report_health(self, health: Callable[[], Health], last: bool = False) -> None:
        """Publish the node's diagnostics once per simulated second, and at the `last` tick."""
        if not (last or self._tick % self._rate == 0):
            return
        row, joined = health(), self.joining.health()
        if joined is not None:
            level = max(row.level, joined.level)
            row = Health(level, f"{row.message}; {joined.message}", {**row.values, **joined.values})
        self.publish(row)

    def publish(self, health: Health) -> None:
        """Publish the node's diagnostics now."""
        self._reported_at = clock.monotonic()
        self._diagnostics.publish(diagnostics(self._name.lstrip("/"), self._hardware, health, self.at_ns))

    def report(self, last: bool = False) -> None:
        """Report refusals, peers that come or go, and silence. Called periodically."""
        self.message_filter.report_refusals(last)
        self.message_filter.report_peers()
        idle_s = clock.monotonic() - self.message_filter.admitted_at
        if self._role != PLANT and not last and min(idle_s, clock.monotonic() - self._reported_at) > IDLE_S:
            text = f"nothing has come for {idle_s:.0f} s"
            self.publish(Health(DiagnosticStatus.WARN, text, {"mode": self._options.mode}))
