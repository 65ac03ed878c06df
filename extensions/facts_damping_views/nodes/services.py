"""Services of a graph, as a cockpit calls them: without waiting."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import rclpy
from facts_damping_msgs.srv import Apply, Step
from rcl_interfaces.srv import SetParameters
from rclpy.executors import SingleThreadedExecutor
from rclpy.parameter import Parameter
from std_srvs.srv import Trigger

from facts_damping.nodes import clock
from facts_damping_views.cockpit import controls

if TYPE_CHECKING:
    from collections.abc import Callable

    from facts_damping.nodes.base.managed import ManagedNode
    from facts_damping_views.cockpit.controls import Request

ANSWER_S = 5.0  # longest wait for the answer of a service
SERVICES = {
    controls.TRIGGER: Trigger,
    controls.APPLY: Apply,
    controls.STEP: Step,
    controls.PARAMETER: SetParameters,
}


class Services:
    """Calls services of the graph and gives their answers; `poll` does the work and never waits."""

    def __init__(self, node: ManagedNode) -> None:
        self._resolve = node.resolve_service_name
        more: dict[str, Any] = {
            "use_global_arguments": False,
            "start_parameter_services": False,
            "enable_rosout": False,
        }
        self._node = rclpy.create_node(f"{node.get_name()}_client", namespace=node.get_namespace(), **more)
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self._node)
        self._clients: dict[str, Any] = {}
        self._waiting: list[list[Any]] = []  # client, request, future or None, deadline, what gets the answer

    def call(self, asked: Request, answer: Callable[[bool, str], None]) -> None:
        """Call a service; `answer` gets success and message."""
        kind, name = SERVICES[asked.kind], self._resolve(asked.service)
        if name not in self._clients:
            self._clients[name] = self._node.create_client(kind, name)
        request = kind.Request()
        if asked.kind == controls.APPLY:
            request.change = asked.content
        elif asked.kind == controls.STEP:
            request.ticks = asked.content
        elif asked.kind == controls.PARAMETER:
            changed, value = asked.content
            request.parameters = [Parameter(changed, value=value).to_parameter_msg()]
        self._waiting.append([self._clients[name], request, None, clock.monotonic() + ANSWER_S, answer])

    def poll(self) -> None:
        """Send requests whose service is there, and pass on answers."""
        for waiting in self._waiting:
            if waiting[2] is None and waiting[0].service_is_ready():
                waiting[2] = waiting[0].call_async(waiting[1])
        for _ in self._waiting:
            self._executor.spin_once(timeout_sec=0)
        still_waiting = []
        for waiting in self._waiting:
            client, _, future, deadline, answer = waiting
            if future is not None and future.done():
                answer(*_answer(future.result()))
            elif clock.monotonic() > deadline:
                if future is not None:
                    client.remove_pending_request(future)
                answer(False, f"no answer from {client.srv_name} within {ANSWER_S:g} s")
            else:
                still_waiting.append(waiting)
        self._waiting = still_waiting

    def close(self) -> None:
        """Release the node of the calls."""
        self._executor.shutdown()
        self._node.destroy_node()


def _answer(response: Any) -> tuple[bool, str]:
    """Success and message of a service."""
    if hasattr(response, "results"):  # of parameters
        reasons = "; ".join(result.reason for result in response.results)
        return all(result.successful for result in response.results), reasons
    return bool(response.success), str(response.message)
