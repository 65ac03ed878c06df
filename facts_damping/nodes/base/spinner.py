"""Spinner: an executor that keeps its wait sets; rclpy's executors build new ones at every spin.

With five processes this doubles the measured ticks per second of a lockstep graph. It serves
subscriptions and services (so `ros2 param` works); the nodes here have no timers and no actions.
"""

from __future__ import annotations

import signal
from contextlib import ExitStack
from contextvars import ContextVar
from typing import TYPE_CHECKING, Any, Protocol

from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.utilities import get_default_context

from facts_damping.interruption import heeded
from facts_damping.nodes import clock
from facts_damping.nodes.transport.raw_take import take

if TYPE_CHECKING:
    from rclpy.node import Node


REQUESTS_S = 0.05  # wall time between two checks for requests and for a stop signal
DRAIN_S = 2.0  # longest wall time that a stopped node waits for its last messages
MAXIMUM = 100  # most messages of a subscription per turn, so that a flood does not starve the other subscriptions

_stop: ContextVar[list[int] | None] = ContextVar("_stop", default=None)  # signals that came; None: none are handled


class Stopped(Exception):  # noqa: N818 (not an error: the node ends as it should)
    """A signal has stopped the node, or the run is over."""


class BeginAgain(Exception):  # noqa: N818 (not an error: another run has begun)
    """The node begins anew: the plant of a free graph was replaced, or `cleanup` was asked for."""


def stop_by_signals() -> None:
    """Handle interruptions here: rclpy's handlers would shut the middleware down while the node works.

    A repeated call keeps signals that have already come.
    """
    if (came := _stop.get()) is None:
        _stop.set(came := [])
    for number in heeded():
        signal.signal(number, lambda number, _: came.append(number))


def stop_requested() -> bool:
    """Whether a stop signal has come."""
    return bool(_stop.get())


def request_stop() -> None:
    """Stop the node as a signal does."""
    if (came := _stop.get()) is not None:
        came.append(signal.SIGTERM)


def check_wanted() -> None:
    """Raise `Stopped` if a stop signal has come."""
    if stop_requested():
        raise Stopped


class Filtered(Protocol):
    """Interface of a node with a message filter, such as Member."""

    @property
    def message_filter(self) -> Any:
        """Its MessageFilter."""

    def report(self, last: bool = False) -> None:
        """Publish pending reports. Called periodically."""


class Spinner:
    """Waits for the messages and requests of one node and calls the callbacks."""

    def __init__(self, node: Node, member: Filtered | None = None) -> None:
        """Take over the node's subscriptions and services; none may be added later. `member`: the node's, if any."""
        self._member = member
        self._subscriptions = [(s.handle.pointer, s) for s in node.subscriptions]
        self._services = [(s.handle.pointer, s) for s in node.services]
        context: Any = get_default_context()
        self._entered = ExitStack()
        entities: list[Any] = [*node.subscriptions, *node.services, context]
        for entity in entities:
            self._entered.enter_context(entity.handle)
        wait_set = rclpy_implementation.WaitSet
        self._messages: Any = wait_set(len(self._subscriptions), 0, 0, 0, 0, 0, context.handle)
        self._requests: Any = wait_set(0, 0, 0, 0, len(self._services), 0, context.handle)
        self._served_at = self._running_at = clock.monotonic()
        self._again = False

    def begin_again(self) -> None:
        """Let the node begin again once the request that asks for it is answered."""
        self._again = True

    def spin_once(self, timeout_s: float) -> bool:
        """Wait at most `timeout_s` seconds, then serve ready messages, one per subscription.

        Returns whether a message was admitted. Raises `Stopped` when the run is over, or after a stop signal once the
        queues are empty or `DRAIN_S` has passed.
        Requests are only polled, as waiting for them would make every turn more expensive.
        """
        self.serve()
        if self._member is not None and self._member.message_filter.done():
            raise Stopped
        wait_set = self._messages
        wait_set.clear_entities()
        for _, subscription in self._subscriptions:
            wait_set.add_subscription(subscription.handle)
        if running := not stop_requested():
            self._running_at = clock.monotonic()
        wait_set.wait(max(0, int(min(timeout_s, REQUESTS_S) * 1e9)) if running else 0)
        received = admitted = False
        ready = wait_set.get_ready_entities("subscription")
        for pointer, subscription in self._subscriptions if ready else ():
            if pointer in ready:
                result = _take(subscription)
                received |= result is not None
                admitted |= bool(result)
        if not running and (not received or clock.monotonic() - self._running_at > DRAIN_S):
            raise Stopped
        return admitted

    def take_all(self) -> bool:
        """Serve the queued messages without waiting, at most `MAXIMUM` per subscription; also after a stop signal.

        Returns whether there may be more.
        """
        self.serve()
        full = [all(_take(subscription) is not None for _ in range(MAXIMUM)) for _, subscription in self._subscriptions]
        return any(full)

    def serve(self) -> None:
        """Answer waiting requests (as of `ros2 param`) and report, at most once per `REQUESTS_S`."""
        if clock.monotonic() - self._served_at <= REQUESTS_S:
            return
        self._served_at = clock.monotonic()
        wait_set = self._requests
        wait_set.clear_entities()
        for _, service in self._services:
            wait_set.add_service(service.handle)
        wait_set.wait(0)
        ready = wait_set.get_ready_entities("service")
        for pointer, service in self._services if ready else ():
            if pointer in ready and not _answer(service) and self._member is not None:
                self._member.message_filter.refuse(service.srv_name, "request")
        if self._again:
            raise BeginAgain
        if self._member is not None:
            self._member.report()

    def remark(self) -> str:
        """Text that the node's message filter appends to an error."""
        return "" if self._member is None else str(self._member.message_filter.refusals.remark())

    def close(self) -> None:
        """Report for the last time and release all entities."""
        if self._member is not None:
            self._member.report(last=True)
        self._messages = self._requests = None
        self._entered.close()


def _take(subscription: Any) -> bool | None:
    """Take one message and call its callback. Returns None if there was none, false if it was refused."""
    message = take(subscription)
    if message is None:
        return None
    wants = subscription._callback_type  # noqa: SLF001 (as rclpy's own executor asks)
    arguments = message if wants is subscription.CallbackType.WithMessageInfo else message[:1]
    return subscription.callback(*arguments) is not False


def _answer(service: Any) -> bool:
    """Answer one request, if there is one; with an empty response if that fails. Returns whether it succeeded."""
    header, sound = None, True
    response = service.srv_type.Response()
    try:
        request, header = service.handle.service_take_request(service.srv_type.Request)
        if header is not None:
            response = service.callback(request, response)
    except Exception:  # noqa: BLE001 (whatever a request does to rclpy, the node goes on)
        sound = False
    if header is not None:
        service.send_response(response, header)
    return sound
