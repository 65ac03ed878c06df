"""The server of a cockpit: who may use it, what it refuses, and clients that do not read."""

from __future__ import annotations

import json
import socket
import sys
import time
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from starlette.testclient import TestClient
from starlette.websockets import WebSocketDisconnect
from websockets.exceptions import ConnectionClosed

from facts_damping.case.loading import load_case
from facts_damping.cli.main import main
from facts_damping.errors import InputError
from facts_damping.simulation import loop
from facts_damping_views.cockpit import application, clients, controls, server
from facts_damping_views.commands import content
from tests.views.cockpit.serving import page_socket, request, serving

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from facts_damping_views.cockpit.controls import Request

ADDRESS = "http://127.0.0.1:8766"
SOCKET, OWN = "ws://127.0.0.1:8766/socket", {"origin": ADDRESS}
LAYOUT: dict[str, Any] = {"type": "layout", "title": "it", "mode": "live", "panels": [], "duration": None}


class Asked(list[Any]):
    """Requests that a cockpit carries out, with what gets their answers."""

    def __call__(self, request: Request, answer: Any) -> None:
        self.append((request, answer))


@pytest.fixture(scope="module")
def table() -> Any:
    return controls.controls(load_case("two_area_deployment"), launched=True)


@pytest.fixture
def asked() -> Asked:
    return Asked()


@pytest.fixture
def cockpit(table: Any, asked: Asked) -> application.Cockpit:
    return application.Cockpit(application.Content(LAYOUT), table, asked)


@contextmanager
def opened(cockpit: application.Cockpit) -> Iterator[TestClient]:
    """A client that has the cookie."""
    with TestClient(cockpit.app, base_url=ADDRESS) as browser:
        assert browser.get(f"/?token={cockpit.token}").status_code == 200
        yield browser


@pytest.fixture
def client(cockpit: application.Cockpit) -> Iterator[TestClient]:
    with opened(cockpit) as browser:
        yield browser


def heard(session: Any, kind: str) -> Any:
    """The next message of a type."""
    while True:
        message = session.receive_json()
        if message["type"] == kind:
            return message


def test_page_and_its_files_come_from_here_alone(client: TestClient) -> None:
    page = client.get("/")
    assert page.status_code == 200
    assert "default-src 'self'" in page.headers["content-security-policy"]
    assert page.headers["x-content-type-options"] == "nosniff"
    assert client.get("/static/../server.py").status_code == 404
    assert client.get("/static/%2e%2e/server.py").status_code == 404
    for path in ("/data/it", "/events/it", "/report"):
        answer = client.get(path)
        assert (answer.status_code, "allowed:" in answer.text) == (404, True)


@pytest.mark.parametrize(
    ("headers", "status"),
    [
        ({}, 200),
        ({"host": "localhost:8766"}, 200),
        ({"host": "evil.example:8766"}, 403),
        ({"host": "127.0.0.1:80"}, 403),
        ({"origin": "http://evil.example"}, 403),
        ({"origin": "null"}, 403),
        ({"sec-fetch-site": "none", "sec-fetch-dest": "document"}, 200),  # an address that was typed
        ({"sec-fetch-site": "cross-site", "sec-fetch-dest": "document"}, 200),  # a link
        ({"sec-fetch-site": "cross-site", "sec-fetch-dest": "image"}, 403),
    ],
)
def test_requests_of_other_hosts_origins_and_sites_are_refused_and_counted(
    client: TestClient, cockpit: application.Cockpit, headers: dict[str, str], status: int
) -> None:
    answer = client.get("/", headers=headers)
    assert answer.status_code == status
    assert status == 200 or "given; allowed: " in answer.text
    assert client.portal is not None
    client.portal.call(cockpit.status, {"run": "running"})
    with client.websocket_connect(SOCKET, headers=OWN) as session:
        assert heard(session, "status")["counts"]["requests_refused"] == (status == 403)


@pytest.mark.parametrize(
    ("site", "status"), [("same-origin", 404), ("none", 404), ("same-site", 403), ("cross-site", 403), ("x", 403)]
)
def test_report_is_for_the_page_and_for_typed_addresses(client: TestClient, site: str, status: int) -> None:
    """404: it is allowed, but nothing is recorded."""
    headers = {"sec-fetch-site": site, "sec-fetch-dest": "document"}
    assert client.get("/report", headers=headers).status_code == status


@pytest.mark.parametrize("origin", [None, "http://evil.example", "https://127.0.0.1:8766", "http://localhost:8766"])
def test_socket_needs_the_page_s_own_origin(client: TestClient, origin: str | None) -> None:
    headers = {} if origin is None else {"origin": origin}
    with pytest.raises(WebSocketDisconnect), client.websocket_connect(SOCKET, headers=headers):
        pass
    with client.websocket_connect(SOCKET, headers=OWN) as session:
        assert heard(session, "layout")["title"] == "it"


@pytest.mark.parametrize("host", ["127.0.0.1", "192.0.2.7"])
def test_server_asks_for_a_token(host: str) -> None:
    cockpit, other = (application.Cockpit(application.Content(LAYOUT), host=host) for _ in range(2))
    token = cockpit.token
    assert len(token) >= 32
    address = f"http://{host}:8766"
    with TestClient(cockpit.app, base_url=address) as client:
        for path in ("/", "/static/index.html", "/?token=", f"/?token={other.token}", f"/data/it?token={token}"):
            assert client.get(path).status_code == 403, path
        with (
            pytest.raises(WebSocketDisconnect),
            client.websocket_connect(f"{address}/socket".replace("http", "ws"), headers={"origin": address}),
        ):
            pass
        assert cockpit.counts["requests_refused"] == 6
        answer = client.get(f"/?token={token}")
        assert "cockpit.js" not in answer.text  # it opens the page, as a redirect would
        header = answer.headers["set-cookie"].lower()
        assert "httponly" in header
        assert "samesite=strict" in header
        assert "cockpit.js" in client.get("/").text
        with client.websocket_connect(
            f"{address}/socket".replace("http", "ws"), headers={"origin": address}
        ) as session:
            assert heard(session, "layout")


MALFORMED = [
    *("", "{", "[]", "1", "null", '"text"', "{}", '{"id": 1}', '{"id": "1", "control": "run/pause"}'),
    *('{"id": true, "control": "run/pause"}', '{"id": 1, "control": 7}', '{"id": 1, "control": "run/stop"}'),
    *('{"id": 1, "control": "run/pause", "more": 1}', '{"id": NaN, "control": "run/pause"}', "[" * 30000),
    *('{"id": 1e999, "control": "run/pause"}', '{"id": 1, "control": "nodes/plant_sim/kill"}', "\0\ud7ff"),
    *('{"id": 1, "control": "link/wan_link/delay", "value": 1e9}', '{"id": 1, "control": "__class__"}'),
    *(
        '{"id": 1, "control": "grid/fault", "value": {"bus": "../../etc"}}',
        '{"id": 1, "control": "run/step"' + " " * 500,
    ),
]


def test_thousand_malformed_messages_are_refused_and_counted(
    client: TestClient, cockpit: application.Cockpit, asked: Asked
) -> None:
    with client.websocket_connect(SOCKET, headers=OWN) as session:
        heard(session, "layout")
        for i in range(1000):
            message = MALFORMED[i % (len(MALFORMED) + 1)] if i % (len(MALFORMED) + 1) < len(MALFORMED) else b"\xff\0"
            (session.send_bytes if isinstance(message, bytes) else session.send_text)(message)
            answer = heard(session, "answer")
            assert not answer["success"], message
            assert "given" in answer["message"]
            assert "\n" not in answer["message"]
        session.send_json({"id": 7, "control": "run/pause", "value": None})
        while not asked:
            time.sleep(0.001)
        assert client.portal is not None
        client.portal.call(asked[0][1], True, "paused")
        assert heard(session, "answer") == {"type": "answer", "id": 7, "success": True, "message": "paused"}
    assert cockpit.counts["messages_refused"] == 1000
    assert [request.service for request, _ in asked] == ["plant_sim/pause"]


def test_client_has_few_requests_under_way_and_sliders_go_back_when_refused(
    client: TestClient, cockpit: application.Cockpit, asked: Asked
) -> None:
    portal = client.portal
    assert portal is not None
    with client.websocket_connect(SOCKET, headers=OWN) as session:
        for i in range(application.PENDING + 1):
            session.send_json({"id": i, "control": "link/wan_link/delay", "value": 10.0 * (i + 1)})
        assert "wait for their answers" in heard(session, "answer")["message"]
        assert len(asked) == application.PENDING
        portal.call(cockpit.status, {"run": "running"})
        assert heard(session, "status")["values"] == {"link/wan_link/delay all": 160.0}
        for _, answer in asked:
            portal.call(answer, False, "no")
        assert not heard(session, "answer")["success"]
    with client.websocket_connect(SOCKET, headers=OWN) as session:  # a later page
        rows = {row["id"]: row["value"] for row in heard(session, "layout")["controls"]}
        assert rows["link/wan_link/delay"] == 150.0  # that before the one that was refused last


def test_client_gets_events_and_state_of_before(client: TestClient, cockpit: application.Cockpit) -> None:
    assert client.portal is not None
    for i in range(application.KEPT + 50):
        client.portal.call(cockpit.event, {"type": "event", "t": i, "level": "info", "text": "it"})
    client.portal.call(cockpit.status, {"run": "paused", "counts": {"deadline_misses": 3}, "modes": [float("nan")]})
    with client.websocket_connect(SOCKET, headers=OWN) as session:
        assert heard(session, "layout")
        assert [session.receive_json()["t"] for _ in range(application.KEPT)] == list(range(50, application.KEPT + 50))
        status = session.receive_json()
    assert (status["run"], status["counts"]["deadline_misses"], status["modes"]) == ("paused", 3, [None])


def test_later_client_gets_the_values_since_the_first_tick_thinned_in_bounded_memory(
    client: TestClient, cockpit: application.Cockpit
) -> None:
    """Two hours at 20 values a second: the first, the newest minute in full, never a long step."""
    assert client.portal is not None
    times, largest = np.arange(144_000, dtype="<f4") / 20, 0
    for time_s in times:
        cockpit.frame(time_s.tobytes())
        largest = max(largest, len(cockpit._history))
    assert largest < 2700
    with client.websocket_connect(SOCKET, headers=OWN) as session:
        assert heard(session, "layout")
        values = np.frombuffer(session.receive_bytes(), "<f4")
    assert (values[0], values[-1]) == (0.0, times[-1])
    np.testing.assert_array_equal(values[-900:], times[-900:])
    steps = np.diff(values)
    assert steps.min() > 0.0
    assert steps.max() < 2.5 * times[-1] / len(values[:-900])
    client.portal.call(cockpit.begin, application.Content({**LAYOUT, "run": 2}))
    with client.websocket_connect(SOCKET, headers=OWN) as session:  # nothing of the run before
        assert heard(session, "layout")["run"] == 2
        session.send_json({"id": 1, "control": "run/report"})
        assert session.receive_json()["type"] == "answer"


def test_preset_moves_its_control_while_the_run_goes_on_until_a_hand_does(
    client: TestClient, cockpit: application.Cockpit, asked: Asked, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(controls, "GROWTH", (10.0, 400.0, 0.01))
    assert client.portal is not None

    def delays(count: int) -> list[float]:
        deadline = time.monotonic() + 20.0
        while len(asked) < count:
            assert time.monotonic() < deadline
            time.sleep(0.01)
        return [1e3 * json.loads(request.content)["up"][-1].get("delay", np.nan) for request, _ in asked]

    with client.websocket_connect(SOCKET, headers=OWN) as session:
        session.send_json({"id": 1, "control": "preset/delay"})
        assert heard(session, "answer")["success"]
        time.sleep(0.1)
        assert asked == []  # it does not run yet
        client.portal.call(cockpit.status, {"run": "running"})
        assert delays(3)[:3] == pytest.approx([10.0, 20.0, 30.0])
        for _, answer in list(asked):
            client.portal.call(answer, True, "")
        session.send_json({"id": 2, "control": "link/wan_link/delay", "value": 5.0})
        while delays(1)[-1] != pytest.approx(5.0):
            time.sleep(0.01)
        count = len(asked)
        time.sleep(0.1)
        assert len(asked) == count
        session.send_json({"id": 3, "control": "preset/cut"})
        delays(count + 1)
        assert json.loads(asked[-1][0].content)["up"][-1]["loss"] == 1.0


def test_client_that_does_not_read_costs_little_and_delays_nobody(
    table: Any, asked: Asked, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Frames of 20 kB: 40 MB in all, of which it may keep what fits into the buffers of its connection."""
    for module in (application, server):
        monkeypatch.setattr(module, "SEND_S", 0.5)
    cockpit = application.Cockpit(application.Content(LAYOUT), table, asked)
    key = "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ=="  # RFC 6455, 1.3
    upgrade = f"Upgrade: websocket\r\nConnection: Upgrade\r\nSec-WebSocket-Version: 13\r\n{key}\r\n"
    with serving(cockpit) as (served, thread):
        origin = served.address.partition("/?")[0]
        stalled = request(served.address, "/socket", f"Origin: {origin}\r\n{upgrade}")
        stalled.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        deadline = time.monotonic() + 20.0
        while not cockpit.clients:
            assert time.monotonic() < deadline
            time.sleep(0.01)
        (slow,) = cockpit.clients
        with page_socket(served.address) as reader:
            while len(cockpit.clients) < 2:
                assert time.monotonic() < deadline
                time.sleep(0.01)
            longest, held, taken_frames = 0.0, 0, 0
            for i in range(2000):
                frame = np.full(5000, i, "<f4").tobytes()
                began = time.monotonic()
                taken_frames += slow in cockpit.clients
                thread.soon(cockpit.frame, frame)
                if i % 20 == 0:
                    thread.soon(cockpit.event, {"type": "event", "t": i, "level": "info", "text": "it"})
                data = reader.recv(timeout=10.0)
                while isinstance(data, str):
                    data = reader.recv(timeout=10.0)
                assert data == frame  # the newest, at once
                longest = max(longest, time.monotonic() - began)
                held = max(held, *(len(served_client.texts) for served_client in cockpit.clients))
            assert longest < 1.0
            assert held <= clients.QUEUE
            assert (
                taken_frames - 500 < slow.frames_left_out <= taken_frames
            )  # its connection may end before the last frame
            assert slow.frames_left_out > 0
            while slow in cockpit.clients:  # its connection ends
                assert time.monotonic() < deadline
                time.sleep(0.05)
            assert cockpit.counts["frames_left_out"] == slow.frames_left_out
        stalled.close()


def test_message_that_is_too_long_ends_its_connection_alone(table: Any, asked: Asked) -> None:
    with (
        serving(application.Cockpit(application.Content(LAYOUT), table, asked)) as (served, _),
        page_socket(served.address) as connection,
        page_socket(served.address) as other,
    ):
        connection.recv()
        other.recv()
        connection.send(" " * (application.LONGEST + 1))
        with pytest.raises(ConnectionClosed, match="1009"):
            connection.recv(timeout=10.0)
        other.send("x")
        assert not json.loads(other.recv(timeout=10.0))["success"]


def test_replay_gives_what_is_recorded() -> None:
    records = [loop.run(load_case("two_area_deployment", ["duration=3", f"seed={seed}"])) for seed in (1, 2)]
    shown = content(["one", "two"], records)
    first, second = (panel["name"] for panel in shown.layout["panels"])
    assert (shown.layout["mode"], len(shown.layout["panels"])) == ("replay", 2)
    with opened(application.Cockpit(shown)) as client:
        for name, record in zip((first, second), records, strict=True):
            data = np.frombuffer(client.get(f"/data/{name}").content, "<f4")
            panel = next(panel_shown for panel_shown in shown.layout["panels"] if panel_shown["name"] == name)
            table = data.reshape(-1, 1 + len(panel["curves"]))
            g1 = panel["diagram"]["machines"][0]["power"]
            rows = np.searchsorted(record.time_s, table[:, 0] - 1e-6)
            wanted = record.arrays["machine.G1.electrical_power_pu"][rows] * 100.0
            np.testing.assert_array_equal(table[:, 1 + g1], wanted.astype(np.float32))
            events = client.get(f"/events/{name}").json()
            assert [event["text"] for event in events if event["level"] == "warn"] == [
                "fault: line_3",
                "line out: line_3",
            ]
        with client.websocket_connect(SOCKET, headers=OWN) as session:
            assert heard(session, "layout")["controls"] == []
            session.send_json({"id": 1, "control": "run/pause"})
            assert "none in a replay" in heard(session, "answer")["message"]


def test_report_is_made_by_the_command_and_has_no_rights_here(
    table: Any, asked: Asked, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """In place of the command a script: it writes the page, or ends with an error."""
    script = tmp_path / "python"
    script.write_text('#!/bin/sh\ncase $4 in bad) echo "facts-damping: no" >&2; exit 2;; esac\necho "of $4" > "$6"\n')
    script.chmod(0o700)
    monkeypatch.setattr(sys, "executable", str(script))
    shown = application.Content(LAYOUT, recordings={"one": "good", "a/b": "bad"})
    with opened(application.Cockpit(shown, table, asked)) as client:
        for path in ("/report", "/report/one"):
            answer = client.get(path)
            assert (answer.status_code, answer.text) == (200, "of good\n")
            assert answer.headers["content-security-policy"].startswith("sandbox allow-scripts")
        answer = client.get("/report/a/b")
        assert (answer.status_code, answer.text) == (503, "facts-damping: no")
        assert "allowed: one, a/b" in client.get("/report/two").text
        with client.websocket_connect(SOCKET, headers=OWN) as session:
            session.send_json({"id": 1, "control": "run/report", "value": None})
            assert heard(session, "answer") == {"type": "answer", "id": 1, "success": True, "message": "/report"}


def test_cockpit_that_cannot_start_names_the_cause(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    with socket.socket() as bound:
        bound.bind(("127.0.0.1", 0))
        bound.listen()
        port = bound.getsockname()[1]
        with pytest.raises(InputError, match=rf"host, port: 127.0.0.1, {port} given: .*; allowed: ones that are free"):
            server.Server(application.Cockpit(application.Content(LAYOUT)), "127.0.0.1", port)
    assert main(["cockpit", "two_area_small", "two_area_large"]) == 2
    assert "two_area_large: given beside a run; allowed: beside a recording" in capsys.readouterr().err
    assert main(["cockpit", str(tmp_path), "--set", "seed=1"]) == 2
    assert "--set seed=1: given with a recording; allowed: with a run" in capsys.readouterr().err
    monkeypatch.setitem(sys.modules, "uvicorn", None)
    assert main(["cockpit", "two_area_small"]) == 2
    assert "uvicorn is not installed; allowed: pip install -e '.[cockpit]'" in capsys.readouterr().err
