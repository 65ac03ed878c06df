"""The application of a cockpit: page, static files, data, report and socket; who may use it; what each client gets.

Who may use it: access.py. Nothing that a client sends is more than a value for one of the listed controls. Each client
has room for one frame, the newest, and for 256 other messages, the oldest of which are dropped; what
it does not get is counted. A message that takes longer than 10 s ends its connection. Nothing waits for a client.
"""

from __future__ import annotations

import asyncio
import json
import logging
from collections import deque
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, NamedTuple

from facts_damping.errors import InputError, one_line
from facts_damping.extras import library
from facts_damping.output.writing import finite
from facts_damping_views.cockpit import controls as of_controls
from facts_damping_views.cockpit import words
from facts_damping_views.cockpit.access import EXTRA, POLICY, REPORT_POLICY, RequestFilter, new_token
from facts_damping_views.cockpit.clients import Client, History
from facts_damping_views.cockpit.reports import Reports, while_there

if TYPE_CHECKING:
    from collections.abc import Callable, Coroutine, Mapping

    from facts_damping_views.cockpit.controls import Control, Move, Request, Values

    Answer = Callable[[bool, str], None]

HOST, PORT = "127.0.0.1", 8766
STATIC = Path(__file__).with_name("static")


KEPT = 200  # events that a new client gets


SEND_S = 10.0  # longest time for a message


LONGEST = 65536  # bytes of a message from a client


CLIENTS = 32  # most at once


PENDING = 16  # most requests of a client that are not answered


class Content(NamedTuple):
    """What a cockpit shows: the layout; by panel, in a replay its data and events, and the recording for reports."""

    layout: dict[str, Any]
    data: Mapping[str, bytes] = MappingProxyType({})
    events: Mapping[str, list[dict[str, Any]]] = MappingProxyType({})
    recordings: Mapping[str, str] = MappingProxyType({})


class Cockpit:
    """All clients, controls and their values. Methods are called in the server's event loop, `app` serves."""

    def __init__(
        self,
        content: Content,
        controls: Mapping[str, Control] | None = None,
        ask: Callable[[Request, Answer], None] | None = None,
        *,
        host: str = HOST,
    ) -> None:
        """`ask`: carries out a request and calls back with success and message."""
        self.content, self.controls, self._ask = content, dict(controls or {}), ask
        self.token, self._host = new_token(), host
        self.values: Values = {}
        self.clients: set[Client] = set()
        counted = ("clients", "frames_left_out", "texts_left_out", "messages_refused", "requests_refused")
        self.counts = dict.fromkeys(counted, 0)
        self._events: deque[Mapping[str, Any]] = deque(maxlen=KEPT)
        self._history = History()
        self._running = asyncio.Event()
        self._presets: dict[str, asyncio.Task[None]] = {}  # under way, by control that they move
        self._status: dict[str, Any] = {}
        self._reports = Reports()
        self.app = self._made()

    def _made(self) -> Any:
        applications = library("starlette.applications", EXTRA, "starlette")
        routing, static = library("starlette.routing", EXTRA), library("starlette.staticfiles", EXTRA)
        routes = [
            routing.Route("/", self._page),
            routing.Route("/data/{panel:path}", self._data),
            routing.Route("/events/{panel:path}", self._panel_events),
            routing.Route("/report", self._report),
            routing.Route("/report/{panel:path}", self._report),
            routing.WebSocketRoute("/socket", self._socket),
            routing.Mount("/static", static.StaticFiles(directory=STATIC)),
        ]
        return RequestFilter(applications.Starlette(routes=routes), self._host, self.token, self._count_refused)

    def _count_refused(self) -> None:
        self.counts["requests_refused"] += 1

    # What the run tells.

    def begin(self, content: Content) -> None:
        """Show a run that begins again, to all clients."""
        self.content, self.values = content, {}
        self._events.clear()
        self._history = History()
        self._end_presets()
        for client in self.clients:
            client.frame = None
            client.put_text(self._layout())

    def frame(self, data: bytes) -> None:
        """Give all clients the newest values."""
        self._history.append(data)
        for client in self.clients:
            client.put_frame(data)

    def event(self, message: Mapping[str, Any]) -> None:
        """Give all clients an event; later ones get the newest 200. A newer value of one thing replaces the last."""
        replaces = bool(self._events) and words.replaces(message, self._events[-1])
        if replaces:
            self._events.pop()
        self._events.append(message)
        self._tell(json.dumps({**message, "replaces": replaces}))

    def status(self, message: Mapping[str, Any]) -> None:
        """Give all clients the state of the run, with the counts of this server."""
        self._status = {"type": "status", **message}
        self._running.set() if message.get("run") == "running" else self._running.clear()
        self._tell(self._status_text())

    def _status_text(self) -> str:
        counts = {**self._status.get("counts", {}), **self.counts, "clients": len(self.clients)}
        for name in ("frames_left_out", "texts_left_out"):
            counts[name] += sum(getattr(client, name) for client in self.clients)
        values = {f"{name} {channel}".strip(): value for (name, channel), value in self.values.items()}
        cuts = [name for (name, _), on in self.values.items() if on is True and name.endswith("/cut")]
        cut = [name.split("/", 1)[1].removesuffix("/cut") for name in cuts]
        return json.dumps(finite({**self._status, "counts": counts, "values": values, "cut": cut}))

    def _tell(self, text: str) -> None:
        for client in self.clients:
            client.put_text(text)

    # What a client asks.

    def received(self, client: Client, data: str | bytes | None) -> None:
        """Take a message of a client: refuse and count it, or carry it out."""
        number = None
        try:
            message = parsed(data)
            number = message["id"]
            control = self._control(message["control"], client.pending)
            channel, value = of_controls.checked(control, message.get("value"))
            self._end_presets(control.id)
        except InputError as error:
            self.counts["messages_refused"] += 1
            self._answer(client, number, success=False, message=one_line(error))
            return
        self._carry_out(client, number, control, channel, value)

    def _control(self, name: str, pending: int) -> Control:
        if name not in self.controls:
            allowed = "those of the layout" if self.controls else "none in a replay"
            raise InputError(f"control: {name[:40]!r} given; allowed: {allowed}")
        if pending >= PENDING:
            raise InputError(f"{PENDING} requests wait for their answers; allowed: one more after an answer")
        return self.controls[name]

    def _end_presets(self, control: str = "") -> None:
        """End the preset that moves a control; empty: all."""
        for name in [control] if control else list(self._presets):
            if (task := self._presets.pop(name, None)) is not None:
                task.cancel()

    async def _play(self, client: Client, moves: list[Move]) -> None:
        """Give controls values one after the other, while the run goes on."""
        for move in moves:
            await asyncio.sleep(move.wait_s)
            await self._running.wait()
            control = self.controls[move.control]
            channel, value = of_controls.checked(control, move.value)
            self._carry_out(client, None, control, channel, value)

    def _carry_out(self, client: Client, number: Any, control: Control, channel: str, value: Any) -> None:
        place, before = (control.id, channel), dict(self.values)
        if control.keeps:
            self.values[place] = value
        request = control.request(value, self.values)
        if request.kind == of_controls.REPORT:
            there = bool(self.content.recordings)
            self._answer(client, number, success=there, message="/report" if there else "no recording is known")
            return
        if request.kind == of_controls.PRESET:
            moves = request.content
            for name in {move.control for move in moves}:
                self._end_presets(name)
                self._presets[name] = asyncio.ensure_future(self._play(client, moves))
            self._answer(client, number, success=True, message="begins" if moves else "it is at its end")
            return
        client.pending += 1

        def answered(success: bool, message: str) -> None:
            client.pending -= 1
            if control.keeps and not success and self.values.get(place) == value:
                self.values = {**self.values, place: before.get(place, control.shown["value"])}
            self._answer(client, number, success=success, message=message)
            if control.keeps and self._status:
                self._tell(self._status_text())

        if self._ask is not None:
            self._ask(request, answered)

    def _answer(self, client: Client, number: Any, *, success: bool, message: str) -> None:
        if number is None and success:  # of a preset
            return
        client.put_text(json.dumps({"type": "answer", "id": number, "success": success, "message": message}))

    def _layout(self) -> str:
        """The layout, with controls as they stand."""
        rows = []
        for control in self.controls.values():
            standing = self.values.get((control.id, "")) if control.shown["kind"] == "toggle" else None
            if control.shown["kind"] == "slider":
                standing = self.values.get((control.id, of_controls.ALL))
            rows.append(control.shown if standing is None else {**control.shown, "value": standing})
        return json.dumps(finite({**self.content.layout, "controls": rows}))

    # What the server serves.

    async def _socket(self, websocket: Any) -> None:
        if len(self.clients) >= CLIENTS:
            await websocket.close(1013)
            return
        await websocket.accept()
        client = Client()
        client.put_text(self._layout())
        if self._history:
            client.put_text(self._history.all())
        for event in self._events:
            client.put_text(json.dumps(event))
        if self._status:
            client.put_text(self._status_text())
        self.clients.add(client)
        try:
            async with library("anyio", EXTRA).create_task_group() as group:
                for work in (self._send, self._take):
                    group.start_soon(_until, work(websocket, client), group.cancel_scope.cancel)
        finally:
            for name in ("frames_left_out", "texts_left_out"):
                self.counts[name] += getattr(client, name)
            self.clients.discard(client)

    async def _send(self, websocket: Any, client: Client) -> None:
        while True:
            message = await client.next()
            send = websocket.send_text if isinstance(message, str) else websocket.send_bytes
            await asyncio.wait_for(send(message), SEND_S)

    async def _take(self, websocket: Any, client: Client) -> None:
        while True:
            message = await websocket.receive()
            if message["type"] != "websocket.receive":
                return
            text = message.get("text")
            self.received(client, message.get("bytes") if text is None else text)
            await asyncio.sleep(0)  # a flood leaves time for the others

    async def _page(self, _: Any) -> Any:
        responses = library("starlette.responses", EXTRA)
        return responses.FileResponse(STATIC / "index.html", headers={"content-security-policy": POLICY})

    async def _data(self, request: Any) -> Any:
        return _of_panel(request, self.content.data, "application/octet-stream")

    async def _panel_events(self, request: Any) -> Any:
        events = {name: json.dumps(panel_events) for name, panel_events in self.content.events.items()}
        return _of_panel(request, events, "application/json")

    async def _report(self, request: Any) -> Any:
        """A report of what is recorded so far, made by a process of its own; it ends when all who asked have gone."""
        responses, known = library("starlette.responses", EXTRA), self.content.recordings
        panel = request.path_params.get("panel", next(iter(known), ""))
        if panel not in known:
            return responses.PlainTextResponse(f"report: {panel[:80]!r} given; allowed: {_names(known)}", 404)
        try:
            page, reason = await while_there(request, self._reports.get(known[panel])) or (None, "its client has gone")
        except InputError as error:  # it is too long
            page, reason = None, one_line(error)
        if page is None:
            return responses.PlainTextResponse(reason, 503)
        return responses.HTMLResponse(page, headers={"content-security-policy": REPORT_POLICY})


async def _until(work: Coroutine[Any, Any, None], end: Callable[[], None]) -> None:
    """Work on a connection until it is lost, or takes too long; then end all work on it."""
    try:
        await work
    except Exception as error:  # noqa: BLE001 (each implementation of WebSockets has its own)
        logging.getLogger(__name__).debug("connection ended: %r", error)
    end()


def _of_panel(request: Any, rows: Mapping[str, Any], kind: str) -> Any:
    responses, panel = library("starlette.responses", EXTRA), request.path_params["panel"]
    if panel not in rows:
        return responses.PlainTextResponse(f"panel: {panel[:80]!r} given; allowed: {_names(rows)}", 404)
    return responses.Response(rows[panel], media_type=kind)


def _names(rows: Mapping[str, Any]) -> str:
    return ", ".join(rows) or "none, as nothing is recorded"


def parsed(data: str | bytes | None) -> dict[str, Any]:
    """A message of a client, {"id", "control", "value"}. Raises `InputError` if it is anything else."""
    if not isinstance(data, str):
        raise InputError("a binary message given; allowed: text")
    try:
        message: Any = json.loads(data, parse_constant=_refused)
    except (ValueError, RecursionError) as error:
        raise InputError(f"a message that is not JSON given: {one_line(error)[:80]}; allowed: JSON") from error
    sound = isinstance(message, dict) and isinstance(message.get("control"), str)
    number = message.get("id") if sound else None
    if not sound or not isinstance(number, int) or isinstance(number, bool) or abs(number) > 2**53 or len(message) > 3:
        raise InputError('a message of another form given; allowed: {"id": number, "control": name, "value": ...}')
    if unknown := message.keys() - {"id", "control", "value"}:
        raise InputError(f"field {min(unknown)[:40]!r} given; allowed: id, control, value")
    return dict(message)


def _refused(name: str) -> None:
    raise ValueError(f"{name} given")
