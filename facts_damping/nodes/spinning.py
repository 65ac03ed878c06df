"""A wait set that is kept between turns: rclpy's executors build theirs anew at every spin.

Measured with five processes, that alone doubles the ticks per second of a lockstep graph. It serves
subscriptions and services (so `ros2 param` works); the nodes here have no timers and no actions.
"""

from __future__ import annotations

import signal
import time
from contextlib import ExitStack
from threading import Event
from typing import TYPE_CHECKING, Any

from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.utilities import get_default_context

if TYPE_CHECKING:
    from rclpy.node import Node

REQUESTS_S = 0.05  # wall time between two looks for requests, and for whether the node was told to stop
MOST = 100  # messages of a subscription that are taken at once: others' turn comes, whoever floods it

_told = Event()


class Stopped(Exception):  # noqa: N818 (not an error: a signal told the node to stop)
    """What a node was waiting for is not wanted any more."""


def stop_by_signals() -> None:
    """Take SIGINT and SIGTERM, here and not in rclpy, which shuts the middleware down under a node that works."""
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: _told.set())


def told_to_stop() -> bool:
    """Whether such a signal has come."""
    return _told.is_set()


def check_wanted() -> None:
    """Raise `Stopped` once such a signal has come."""
    if _told.is_set():
        raise Stopped


class Spinner:
    """Waits for messages and requests of one node and calls their callbacks."""

    def __init__(self, node: Node) -> None:
        """Take over the node's subscriptions and services; none may be added later."""
        self._subscriptions = [(s.handle.pointer, s) for s in node.subscriptions]
        self._services = [(s.handle.pointer, s) for s in node.services]
        context: Any = get_default_context()
        self._entered = ExitStack()
        entities: list[Any] = [*node.subscriptions, *node.services, context]
        for entity in entities:
            self._entered.enter_context(entity.handle)
        counts = (len(self._subscriptions), len(self._services))
        self._messages: Any = rclpy_implementation.WaitSet(counts[0], 0, 0, 0, 0, 0, context.handle)
        self._requests: Any = rclpy_implementation.WaitSet(0, 0, 0, 0, counts[1], 0, context.handle)
        self._asked = time.monotonic()

    def spin_once(self, timeout_s: float) -> bool:
        """Wait at most `timeout_s` seconds, then serve what is ready, one message a subscription.

        Returns whether a message was; raises `Stopped` once the node was told to stop and has taken all that is here.
        Requests are looked for now and then: waiting for them too would make every turn dearer.
        """
        self._serve()
        wait_set = self._messages
        wait_set.clear_entities()
        for _, subscription in self._subscriptions:
            wait_set.add_subscription(subscription.handle)
        wanted = not told_to_stop()
        wait_set.wait(max(0, int(min(timeout_s, REQUESTS_S) * 1e9)) if wanted else 0)
        served = False
        ready = wait_set.get_ready_entities("subscription")
        for pointer, subscription in self._subscriptions if ready else ():
            if pointer in ready:
                served |= _take(subscription)
        if not (wanted or served):
            raise Stopped
        return served

    def take_all(self) -> bool:
        """Serve what is here, also when told to stop, without waiting; at most `MOST` messages a subscription.

        Returns whether there was any.
        """
        self._serve()
        served = False
        for _, subscription in self._subscriptions:
            for _ in range(MOST):
                if not _take(subscription):
                    break
                served = True
        return served

    def _serve(self) -> None:
        """Answer the requests that wait, now and then, so that `ros2 param` works."""
        if time.monotonic() - self._asked <= REQUESTS_S:
            return
        self._asked = time.monotonic()
        wait_set = self._requests
        wait_set.clear_entities()
        for _, service in self._services:
            wait_set.add_service(service.handle)
        wait_set.wait(0)
        ready = wait_set.get_ready_entities("service")
        for pointer, service in self._services if ready else ():
            if pointer in ready:
                request, header = service.handle.service_take_request(service.srv_type.Request)
                if header is not None:
                    service.send_response(service.callback(request, service.srv_type.Response()), header)

    def close(self) -> None:
        """Let go of all entities."""
        self._messages = self._requests = None
        self._entered.close()


def _take(subscription: Any) -> bool:
    """Take one message, if there still is one, and call its callback."""
    taken = subscription.handle.take_message(subscription.msg_type, subscription.raw)
    if taken is None:
        return False
    wants = subscription._callback_type  # noqa: SLF001 (as rclpy's own executor asks)
    subscription.callback(*(taken if wants is subscription.CallbackType.WithMessageInfo else taken[:1]))
    return True
