"""cockpit: shows a running graph on a page in a browser, and changes it by the graph's own services.

It publishes nothing. It reads the newest message of each topic twenty times a second, best effort: it delays no node.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from contextvars import Context
from functools import partial
from queue import SimpleQueue
from typing import TYPE_CHECKING, Any

from facts_damping_msgs.msg import RunState
from rclpy.serialization import deserialize_message

from facts_damping.case import names
from facts_damping.case.names import SUPERVISED, label
from facts_damping.nodes import clock
from facts_damping.nodes.base.asyncio_thread import AsyncioThread
from facts_damping.nodes.base.log import NodeLog
from facts_damping.nodes.base.managed import AlwaysActive
from facts_damping.nodes.base.parameters import declare, descriptor, read_case
from facts_damping.nodes.base.qos import listening
from facts_damping.nodes.base.run import run_node
from facts_damping.nodes.base.spinner import Spinner, check_wanted
from facts_damping.nodes.base.topics import CHANGES, DIAGNOSTICS, FRAMES, PLANT_STATE, REFUSALS, RUN_STATE
from facts_damping.nodes.recorder import topics
from facts_damping.parameters.yaml_text import UNREADABLE, parse
from facts_damping.record import GridEvent, RunChange
from facts_damping.recording.events import STOPPED
from facts_damping.signals import NANOSECONDS
from facts_damping_views.cockpit import application, controls, layout, reports, samples, server, words
from facts_damping_views.nodes.services import Services

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Mapping

    from facts_damping.nodes.base.managed import ManagedNode
    from facts_damping_views.cockpit.controls import Request

PERIOD_S = 1.0 / samples.RATE
STATUS_S = 1.0  # wall time between two states of the run, and between two estimates of modes
LOOK_S = 10.0  # between two looks for a forced oscillation
SILENT_S = 2.0  # wall time without its messages after which a node counts as dead
EVENTS = "plant/events"
EVERY = (EVENTS, CHANGES, RUN_STATE, DIAGNOSTICS, REFUSALS)  # topics of which every message counts, not the newest
STATES = {RunState.RUNNING: "running", RunState.PAUSED: "paused", RunState.ENDED: "ended"}
DONE = "done: "  # begin of the reason of a run that has reached its end


def why_ended(reason: str) -> str:
    """Why a run has ended, in words; `reason`: as its plant publishes it."""
    if reason.startswith(DONE):
        return f"it has run for {reason.removeprefix(DONE)}"
    return "it was stopped" if reason == STOPPED else reason


class Cockpit:
    """Subscribes to all topics that the page shows, serves the page, and passes on what its controls ask for."""

    activation = AlwaysActive()

    def __init__(self, node: ManagedNode) -> None:
        self.case = case = read_case(node)
        self.host: str = declare(node, "host", application.HOST, descriptor("address that the server listens at"))
        self.port: int = declare(node, "port", application.PORT, descriptor("its port; 0: a free one", "", 0, 65535))
        text = "true: the program that started it carries out the lines `kill NODE` and `restart NODE`"
        launched: bool = declare(node, "launched", False, descriptor(text))
        text = "true: that program also starts the run again, by the line `again`"
        again: bool = declare(node, "again", False, descriptor(text))
        self.recording: str = declare(
            node, "recording", "", descriptor("the run's recording, for reports; empty: none")
        )
        server.check_libraries()
        self.panel = layout.panel(case, label(case.summary()))
        self.number = 1  # of the run: one more each time that it starts again
        asks = controls.controls(case, launched=launched, again=again)
        self.cockpit = application.Cockpit(self.content(), asks, self.ask, host=self.host)
        self.asked: SimpleQueue[tuple[Request, Callable[[bool, str], None]]] = SimpleQueue()
        self.begin("running")
        self.uses, self.kinds, self.senders = self._uses()
        for topic, kind in self.kinds.items():
            take = partial(self.on_message, topic)
            node.create_subscription(kind, topic, take, listening(1000 if topic in EVERY else 1), raw=True)
        self.log, self.spinner, self.services = NodeLog(node), Spinner(node), Services(node)

    def content(self) -> application.Content:
        """What the page shows of the run."""
        title, run = self.panel.shown["name"], self.case.run
        shown = {"type": "layout", "title": title, "mode": "live", "panels": [self.panel.shown], "run": self.number}
        recordings = {title: reports.recording(self.recording, self.number)} if self.recording else {}
        return application.Content(shown | {"duration": run.duration}, recordings=recordings)

    def begin(self, state: str) -> None:
        """Know nothing of a run yet."""
        self.values = samples.Live(self.panel)
        self.newest: dict[str, bytes] = {}  # of a topic, until it is decoded
        self.heard: dict[str, float] = {}  # wall time of the newest message, by node
        self.time_s = self.event_s = 0.0
        self.source_ns = 0  # when the newest state of the plant was published
        self.state, self.reason, self.story = state, "", words.Story(self.case)
        self.counts = dict[str, int]()
        self.refused = dict[str, int]()  # messages refused by the graph's nodes

    def _uses(self) -> tuple[dict[str, Any], dict[str, Any], dict[str, str]]:
        """By topic: what takes its columns; message class (of all topics: nodes wait for readers); publishing node."""
        case, kinds = self.case, topics(self.case)
        uses: dict[str, Any] = {FRAMES: samples.frame_columns, PLANT_STATE: self.plant_state}
        senders = {PLANT_STATE: layout.PLANT}
        for i, link in enumerate(names.link_addresses(case)):
            uses[link.topic("pmu/delivered")] = partial(samples.up_columns, i)
            uses[link.topic("setpoints/delivered")] = partial(samples.down_columns, i)
            senders[link.topic("pmu/delivered")] = str(link)
        for address in names.controller_addresses(case):
            uses[f"{address}/setpoints"] = partial(samples.setpoint_columns, "issued")
            senders[f"{address}/setpoints"] = str(address)
        for address in names.identifier_addresses(case).values():
            senders[f"{address}/estimate"] = str(address)
        for c, address in names.supervisor_addresses(case).items():
            uses[f"{address}/{SUPERVISED}"] = partial(samples.setpoint_columns, "supervised")
            uses[f"{address}/state"] = partial(self.supervision, str(names.controller_addresses(case)[c]))
            senders[f"{address}/state"] = str(address)
        uses |= {EVENTS: self.on_event, CHANGES: self.on_change, RUN_STATE: self.on_run_state}
        uses |= {DIAGNOSTICS: self.on_diagnostics, REFUSALS: self.on_refusals}
        return uses, kinds, senders

    def ready(self) -> None:
        """Start the server. Raises `InputError` if host or port cannot be used."""
        self.server = server.Server(self.cockpit, self.host, self.port)
        self.thread = AsyncioThread()
        # In a context of its own: a message names no files, but the server reads reports.
        self.serving = Context().run(self.thread.begin, self.server.serve())

    def ask(self, request: Request, answer: Callable[[bool, str], None]) -> None:
        """Take a request of a page; called in the server's thread."""
        self.asked.put((request, answer))

    def on_message(self, topic: str, data: bytes, information: dict[str, Any]) -> None:
        """Keep a message, or decode it if every one counts."""
        if topic == PLANT_STATE:
            self.source_ns = information["source_timestamp"]
        if topic in EVERY:
            self.decode(topic, data)
        elif topic in self.uses:
            self.newest[topic] = data
        if topic in self.senders:
            self.heard[self.senders[topic]] = clock.monotonic()

    def decode(self, topic: str, data: bytes) -> None:
        """Take the values of a message; one that cannot be decoded is left out."""
        try:
            message = deserialize_message(data, self.kinds[topic])
            columns = list(self.uses[topic](message) or ())
        except Exception:  # noqa: BLE001 (any program may publish there; the nodes count what they refuse)
            self.counts["messages_unreadable"] = self.counts.get("messages_unreadable", 0) + 1
            return
        if topic == PLANT_STATE:
            self.time_s = message.tick / self.case.run.frame_rate
        self.values.put(iter(columns))

    def supervision(self, controller: str, message: Any) -> Iterator[tuple[str, float]]:
        """Columns of a supervisor's state; a new state is an event."""
        t = message.tick / self.case.run.frame_rate
        self.tell(self.story.on_supervision(t, controller, message.state, message.cause))
        return samples.supervision_columns(message)

    def plant_state(self, message: Any) -> Iterator[tuple[str, float]]:
        """Columns of machines and devices; a device that is released is an event."""
        t = message.tick / self.case.run.frame_rate
        self.tell(self.story.on_devices(t, [row.device for row in message.devices if row.released]))
        return samples.state_columns(message)

    def on_event(self, message: Any) -> None:
        """Tell an event of the grid."""
        self.event_s = self.time_s
        stamp = message.header.stamp
        time_ns = stamp.sec * NANOSECONDS + stamp.nanosec
        self.tell(self.story.on_event(GridEvent(time_ns, message.kind, message.element, message.value)))

    def on_change(self, message: Any) -> None:
        """Tell a change."""
        try:
            value = parse(message.value)
        except UNREADABLE:
            value = message.value
        where = message.tick, message.node, message.role, message.index
        self.tell(self.story.on_change(RunChange(*where, message.kind, message.name, value)))

    def on_run_state(self, message: Any) -> None:
        """Keep the state of the run; its end is an event."""
        state = STATES.get(message.state, "running")
        if state == "ended":
            self.on_end(why_ended(message.reason), "info" if message.in_synchronism else "error")
        self.state = state

    def on_end(self, reason: str, level: str) -> None:
        """Tell that the run has ended, once."""
        if self.state != "ended":
            self.state, self.reason = "ended", reason
            self.tell([words.event(self.time_s, f"the run has ended: {reason}", level)])

    def again(self) -> tuple[bool, str]:
        """Have the run started again. Returns whether it is possible, and a message."""
        if self.state != "ended":
            return False, "again: given during the run; allowed: once it has ended"
        self.number += 1
        self.begin("starting")
        self.log.line(controls.AGAIN)
        self.thread.soon(self.cockpit.begin, self.content())
        return True, "starts again"

    def on_diagnostics(self, message: Any) -> None:
        """Keep deadline misses of the plant; who tells of itself is alive."""
        for status in message.status:
            name = status.name.strip("/")
            self.heard[name] = clock.monotonic()
            for value in status.values:
                if value.key == "deadline_misses" and value.value.isdecimal():
                    self.counts["deadline_misses"] = int(value.value)

    def on_refusals(self, message: Any) -> None:
        """Count messages that nodes have refused."""
        self.refused[message.node] = sum(entry.count for entry in message.refused)
        self.counts["refused_by_nodes"] = sum(self.refused.values())

    def tell(self, events: Iterable[Mapping[str, Any]]) -> None:
        """Show events in the log of the page, and what is out of service and released after them.

        Those that no slider makes are lines for the program that started this, too.
        """
        for event in events:
            if event["level"] != "info" or not event.get("of"):
                self.log.line(f"{controls.EVENT} {event['t']:.1f} s: {event['text']}")
            self.thread.soon(self.cockpit.event, {**event, **self.story.shown()})

    def status(self) -> dict[str, Any]:
        """State of the run and its nodes. A node is dead if it was heard, and is silent while the run goes on."""
        now, still = clock.monotonic(), self.state != "running"
        if not still and self.heard and all(now - at >= SILENT_S for at in self.heard.values()):
            self.on_end("its nodes no longer answer; the terminal has the reason", "error")
            still = True
        alive = {name: still or now - at < SILENT_S for name, at in self.heard.items()}
        nodes = {name: "alive" if alive.get(name) else "dead" for name in self.panel.shown["nodes"] if name in alive}
        self.tell(self.story.on_nodes(self.time_s, [name for name, state in nodes.items() if state == "dead"]))
        self.tell(self.story.on_frequencies(self.time_s, self.values.frequencies()))
        self.tell(self.story.on_forced(self.time_s, self.values.forced))
        modes = [{"label": name, **mode} for name, mode in self.values.modes.items()]
        shown = {"run": self.state, "reason": self.reason, "nodes": nodes, "states": dict(self.story.states)}
        shown |= {"wrong": self.story.wrong()}
        return shown | self.story.shown() | {"modes": modes, "counts": dict(self.counts)}

    def carry_out(self) -> None:
        """Carry out what pages ask for."""
        while not self.asked.empty():
            request, answer = self.asked.get()
            later = partial(self.thread.soon, answer)
            if request == controls.START_AGAIN:
                later(*self.again())
                self.thread.soon(self.cockpit.status, self.status())
            elif request.kind == controls.LINE:
                self.tell([words.event(self.time_s, f"asked for: {request.content}")])
                self.log.line(request.content)
                later(True, "asked for")
            else:
                self.services.call(request, later)
        self.services.poll()

    def run(self) -> None:
        """Serve until stopped."""
        self.log.line(self.server.address, always=True)  # it has the token: never in a log, which others may read
        self.log.info("open in a browser: the address on standard output")
        due = status_due = clock.monotonic()
        with ThreadPoolExecutor(1) as beside:
            estimating, looking, looked_s = beside.submit(dict[str, Any]), beside.submit(str), 0.0
            try:
                while True:
                    check_wanted()
                    self.spinner.take_all()
                    self.show_newest()
                    self.carry_out()
                    if clock.monotonic() >= status_due:
                        status_due += STATUS_S
                        self.thread.soon(self.cockpit.status, self.status())
                        if estimating.done():
                            self.values.modes = estimating.result()
                            arguments = self.values.history(), self.panel.modes, self.event_s, self.panel.frequency
                            estimating = beside.submit(samples.estimates, *arguments)
                        if looking.done():
                            self.values.forced = looking.result()
                            if abs(self.time_s - looked_s) >= LOOK_S:  # it may have begun again
                                looked_s, history = self.time_s, self.values.history()
                                of = history, self.event_s, self.panel.frequency
                                looking = beside.submit(samples.forced_oscillation, *of)
                    due = max(due + PERIOD_S, clock.monotonic())
                    clock.sleep(max(0.0, due - clock.monotonic()))
            finally:
                self.end()

    def show_newest(self) -> None:
        """Decode the newest messages and send the values, if the plant has sent any."""
        fresh = PLANT_STATE in self.newest
        for topic, data in self.newest.items():
            self.decode(topic, data)
        self.newest.clear()
        if fresh:
            lag_s = 1e-9 * (clock.time_ns() - self.source_ns)
            self.thread.soon(self.cockpit.frame, self.values.frame(self.time_s, lag_s))

    def end(self) -> None:
        """Tell the last of the run, stop the server and release the services."""
        self.spinner.take_all()
        self.thread.soon(self.cockpit.status, self.status())
        self.server.stop()
        try:
            self.serving.result(3.0)
        except Exception as error:  # noqa: BLE001 (it ends anyway)
            self.log.warning(f"the server did not end by itself: {error!r}")
        self.thread.close()
        self.services.close()


main = partial(run_node, "cockpit", Cockpit, "A running graph on a page in a browser; publishes nothing to it.")
