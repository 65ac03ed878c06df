"""The state machine of managed nodes on a loopback: states and transitions of ROS 2's lifecycle (lifecycle_msgs)."""

from __future__ import annotations

from typing import TYPE_CHECKING

from lifecycle_msgs.msg import State, Transition, TransitionEvent
from lifecycle_msgs.srv import ChangeState, GetAvailableStates, GetAvailableTransitions, GetState
from rclpy.impl.implementation_singleton import rclpy_implementation as real
from rclpy.qos import QoSProfile, qos_profile_services_default
from rclpy.type_support import check_is_valid_msg_type

from facts_damping_testing.loopback.domain import Destroyable
from facts_damping_testing.loopback.services import Service
from facts_damping_testing.loopback.topics import Publisher

if TYPE_CHECKING:
    from facts_damping_testing.loopback.domain import Node

STATES = {
    State.PRIMARY_STATE_UNKNOWN: "unknown",
    State.PRIMARY_STATE_UNCONFIGURED: "unconfigured",
    State.PRIMARY_STATE_INACTIVE: "inactive",
    State.PRIMARY_STATE_ACTIVE: "active",
    State.PRIMARY_STATE_FINALIZED: "finalized",
    State.TRANSITION_STATE_CONFIGURING: "configuring",
    State.TRANSITION_STATE_CLEANINGUP: "cleaningup",
    State.TRANSITION_STATE_SHUTTINGDOWN: "shuttingdown",
    State.TRANSITION_STATE_ACTIVATING: "activating",
    State.TRANSITION_STATE_DEACTIVATING: "deactivating",
    State.TRANSITION_STATE_ERRORPROCESSING: "errorprocessing",
}
# Requests: start state, number and label of the transition, state meanwhile, goal after success and after failure.
ASKED = (
    ("unconfigured", Transition.TRANSITION_CONFIGURE, "configure", "configuring", "inactive", "unconfigured"),
    ("inactive", Transition.TRANSITION_CLEANUP, "cleanup", "cleaningup", "unconfigured", "inactive"),
    ("inactive", Transition.TRANSITION_ACTIVATE, "activate", "activating", "active", "inactive"),
    ("active", Transition.TRANSITION_DEACTIVATE, "deactivate", "deactivating", "inactive", "active"),
    ("unconfigured", Transition.TRANSITION_UNCONFIGURED_SHUTDOWN, "shutdown", "shuttingdown", "finalized", "finalized"),
    ("inactive", Transition.TRANSITION_INACTIVE_SHUTDOWN, "shutdown", "shuttingdown", "finalized", "finalized"),
    ("active", Transition.TRANSITION_ACTIVE_SHUTDOWN, "shutdown", "shuttingdown", "finalized", "finalized"),
)
# Ends of transitions: state meanwhile, result, its number, goal.
ENDED = (
    *((row[3], result, 10 * (i + 1) + k, to)
      for i, row in enumerate(ASKED[:5])
      for k, (result, to) in enumerate(
          (("transition_success", row[4]), ("transition_failure", row[5]), ("transition_error", "errorprocessing")))),
    ("errorprocessing", "transition_success", Transition.TRANSITION_ON_ERROR_SUCCESS, "unconfigured"),
    ("errorprocessing", "transition_failure", Transition.TRANSITION_ON_ERROR_FAILURE, "finalized"),
    ("errorprocessing", "transition_error", Transition.TRANSITION_ON_ERROR_ERROR, "finalized"),
)  # fmt: skip
STATE_NUMBERS = {label: number for number, label in STATES.items()}
GRAPH = [
    *((number, label, start, meanwhile) for start, number, label, meanwhile, *_ in ASKED),
    *((number, result, meanwhile, to) for meanwhile, result, number, to in ENDED),
]
SERVICES = {
    "change_state": ChangeState,
    "get_state": GetState,
    "get_available_states": GetAvailableStates,
    "get_available_transitions": GetAvailableTransitions,
    "get_transition_graph": GetAvailableTransitions,
}


class _Service(Service):
    """A service whose QoS is as `rclpy` reads it."""

    @property
    def qos(self) -> dict[str, object]:
        return {"depth": 10}

    @qos.setter
    def qos(self, _: QoSProfile) -> None:
        pass


class LifecycleStateMachine(Destroyable):
    """State of a managed node, as `rclpy`'s."""

    initialized = True

    def __init__(self, node: Node, _interface: bool) -> None:
        super().__init__()
        self.label, name = "unconfigured", node.get_fully_qualified_name()
        for service, kind in SERVICES.items():
            setattr(self, f"service_{service}", _Service(node, kind, f"{name}/{service}", qos_profile_services_default))
        check_is_valid_msg_type(TransitionEvent)  # loads what serialises it
        qos = QoSProfile(depth=10).get_c_qos_profile()
        self._events = Publisher(node, TransitionEvent, f"{name}/transition_event", qos)

    @property
    def current_state(self) -> tuple[int, str]:
        return STATE_NUMBERS[self.label], self.label

    @property
    def available_states(self) -> list[tuple[int, str]]:
        return list(STATES.items())

    @property
    def transition_graph(self) -> list[tuple[int, str, int, str, int, str]]:
        return [
            (number, label, STATE_NUMBERS[start], start, STATE_NUMBERS[to], to) for number, label, start, to in GRAPH
        ]

    @property
    def available_transitions(self) -> list[tuple[int, str, int, str, int, str]]:
        return [transition for transition in self.transition_graph if transition[3] == self.label]

    def get_transition_by_label(self, label: str) -> int:
        return self._find(1, label)[0]

    def trigger_transition_by_id(self, number: int, _publish: bool) -> None:
        self._enter(self._find(0, number))

    def trigger_transition_by_label(self, label: str, _publish: bool) -> None:
        self._enter(self._find(1, label))

    def _find(self, column: int, value: int | str) -> tuple[int, str, int, str, int, str]:
        for transition in self.available_transitions:
            if transition[column] == value:
                return transition
        raise real.RCLError(f"no such transition from state {self.label}")

    def _enter(self, transition: tuple[int, str, int, str, int, str]) -> None:
        number, label, start, start_label, goal, self.label = transition
        event = TransitionEvent(transition=Transition(id=number, label=label))
        event.start_state, event.goal_state = State(id=start, label=start_label), State(id=goal, label=self.label)
        self._events.publish(event)
