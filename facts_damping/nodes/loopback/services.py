"""Services of a loopback: requests and answers go as bytes, at once."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from rclpy.impl.implementation_singleton import rclpy_implementation as real
from type_description_interfaces.srv import GetTypeDescription

from facts_damping.nodes.loopback.domain import Destroyable, domain

if TYPE_CHECKING:
    from facts_damping.nodes.loopback.domain import Node


@dataclass
class rmw_request_id_t:
    """Which request of which client."""

    sequence_number: int
    client: Any = None


@dataclass
class rmw_service_info_t:
    """What is known of a request, or of an answer."""

    request_id: rmw_request_id_t
    source_timestamp: int = 0
    received_timestamp: int = 0


class End(Destroyable):
    """What services and clients have in common: a queue."""

    def __init__(self, node: Node, kind: Any, name: str, qos: Any) -> None:
        super().__init__()
        self.node, self.kind, self.name, self.qos = node, kind, node.resolve(name), qos
        self.waiting: deque[tuple[bytes, rmw_service_info_t]] = deque()

    def get_logger_name(self) -> str:
        return self.node.logger_name()

    def is_ready(self) -> bool:
        """Whether there is something to take."""
        return bool(self.waiting)

    def take(self, kind: type[Any]) -> tuple[Any, Any]:
        """What has waited longest, with its header; none where nothing does."""
        if not self.waiting:
            return None, None
        data, header = self.waiting.popleft()
        return real.rclpy_deserialize(data, kind), header


class Service(End):
    """A queue of requests."""

    def __init__(self, *given: Any) -> None:
        super().__init__(*given)
        domain().services.append(self)

    def service_take_request(self, kind: type[Any]) -> tuple[Any, Any]:
        return self.take(kind)

    def service_send_response(self, response: Any, request: rmw_request_id_t) -> None:
        data = real.rclpy_serialize(response, type(response))
        request.client.waiting.append((data, rmw_service_info_t(request)))


class Client(End):
    """A queue of answers."""

    def __init__(self, *given: Any) -> None:
        super().__init__(*given)
        self.service_name, self._count = self.name, 0
        domain().clients.append(self)

    def _server(self) -> Service | None:
        return next((one for one in domain().services if one.name == self.service_name), None)

    def service_server_is_available(self) -> bool:
        return self._server() is not None

    def send_request(self, request: Any) -> int:
        self._count += 1
        if (server := self._server()) is not None:
            header = rmw_service_info_t(rmw_request_id_t(self._count, self))
            server.waiting.append((real.rclpy_serialize(request, type(request)), header))
        return self._count

    def take_response(self, kind: type[Any]) -> tuple[Any, Any]:
        response, header = self.take(kind)
        return header, response


class TypeDescriptionService(Destroyable):
    """The service that tells of types; nobody has asked it here."""

    def __init__(self, node: Node) -> None:
        super().__init__()
        name = f"{node.get_fully_qualified_name()}/get_type_description"
        self.impl = Service(node, GetTypeDescription, name, None)
