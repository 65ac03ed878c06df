"""Services of a loopback: requests and answers are delivered as bytes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from rclpy.impl.implementation_singleton import rclpy_implementation as real
from type_description_interfaces.srv import GetTypeDescription

from facts_damping_testing.loopback.domain import Destroyable, Endpoint, deliver, domain, known

if TYPE_CHECKING:
    from facts_damping_testing.loopback.domain import Node


@dataclass
class rmw_request_id_t:
    """Number of a request, and its client."""

    sequence_number: int
    client: Any = None


@dataclass
class rmw_service_info_t:
    """Header of a request or an answer."""

    request_id: rmw_request_id_t
    source_timestamp: int = 0
    received_timestamp: int = 0


def _take(endpoint: Endpoint, kind: type[Any]) -> tuple[Any, Any]:
    """The oldest message and its header; None and None if there is none."""
    if not endpoint.waiting:
        return None, None
    data, header = endpoint.waiting.popleft()
    return real.rclpy_deserialize(data, kind), header


class Service(Endpoint):
    """A queue of requests."""

    def __init__(self, *arguments: Any) -> None:
        super().__init__(*arguments)
        domain().add(Service, self)

    def service_take_request(self, kind: type[Any]) -> tuple[Any, Any]:
        return _take(self, kind)

    def service_send_response(self, response: Any, request: rmw_request_id_t) -> None:
        data = real.rclpy_serialize(response, type(response))
        deliver(self, request.client, (data, rmw_service_info_t(request)))


class Client(Endpoint):
    """A queue of answers."""

    def __init__(self, *arguments: Any) -> None:
        super().__init__(*arguments)
        self.service_name, self._count = self.name, 0  # rclpy reads `service_name`
        domain().add(Client, self)

    def _server(self) -> Service | None:
        return next(iter(known(self.node, domain().of(Service), self.service_name)), None)

    def service_server_is_available(self) -> bool:
        return self._server() is not None

    def send_request(self, request: Any) -> int:
        self._count += 1
        if (server := self._server()) is not None:
            header = rmw_service_info_t(rmw_request_id_t(self._count, self))
            deliver(self, server, (real.rclpy_serialize(request, type(request)), header))
        return self._count

    def take_response(self, kind: type[Any]) -> tuple[Any, Any]:
        response, header = _take(self, kind)
        return header, response


class TypeDescriptionService(Destroyable):
    """The service of type descriptions, which no node here calls."""

    def __init__(self, node: Node) -> None:
        super().__init__()
        name = f"{node.get_fully_qualified_name()}/get_type_description"
        self.impl = Service(node, GetTypeDescription, name, None)
