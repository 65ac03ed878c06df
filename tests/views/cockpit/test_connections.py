"""Connections of a cockpit that send no whole request, beside those of pages."""

from __future__ import annotations

import socket
import time
from typing import Any

import pytest

from facts_damping_views.cockpit import application, connections
from tests.views.cockpit.serving import page_socket, request, serving

LAYOUT: dict[str, Any] = {"type": "layout", "title": "it", "mode": "live", "panels": [], "duration": None}
IDLE = 600  # more than the 512 connections with which uvicorn refuses a page


def test_page_is_served_beside_many_idle_connections() -> None:
    with serving(application.Cockpit(application.Content(LAYOUT))) as (served, _):
        idle = [socket.create_connection(("127.0.0.1", served.port)) for _ in range(IDLE)]
        with page_socket(served.address) as page, request(served.address, "/") as browser:
            assert page.recv(timeout=10.0)
            assert browser.recv(100).startswith(b"HTTP/1.1 200 ")
        for connection in idle:
            connection.close()


@pytest.mark.parametrize("whole", [0, 1])
def test_connection_ends_without_the_next_whole_request(monkeypatch: pytest.MonkeyPatch, whole: int) -> None:
    """A client that sends its request, or the next one, too slowly; the page's socket stays."""
    monkeypatch.setattr(connections, "REQUEST_S", 0.2)
    with (
        serving(application.Cockpit(application.Content(LAYOUT))) as (served, _),
        page_socket(served.address) as page,
        socket.create_connection(("127.0.0.1", served.port)) as slow,
    ):
        began = time.monotonic()
        slow.sendall(b"GET / HTTP/1.1\r\nHost: it\r\n\r\n" * whole + b"GET / HTTP/1.1\r\n")
        with pytest.raises(OSError, match=r"reset|Broken"):  # noqa: PT012 (when it ends is not known)
            while time.monotonic() < began + 5.0:
                slow.sendall(b"x: y\r\n")
                time.sleep(0.01)
        assert time.monotonic() - began < 2.0
        page.send("x")
        assert page.recv(timeout=10.0)
