"""The streams of a run: checks their configurations, finds their PMUs, and converts instants to ticks."""

from __future__ import annotations

from collections import deque
from typing import TYPE_CHECKING, Any

import numpy as np

from facts_damping.errors import InputError, check_known, one_line
from facts_damping.measurement.pmu_model import UNSYNCHRONISED
from facts_damping.output.tables import some_of
from facts_damping.signals import DELIVERY, NEVER
from facts_damping.simulation.measured_plant import entries, tick_ns
from facts_damping_streams.c37118 import mapping, stat
from facts_damping_streams.c37118.configuration import TIME_BASE, Configuration
from facts_damping_streams.c37118.session import Instant
from facts_damping_streams.parameters import server
from facts_damping_streams.streaming.pdc import grid_pmus
from facts_damping_streams.streaming.stream_clock import JUMP_S, Following, PmuReport, latency

if TYPE_CHECKING:
    from collections.abc import Iterable

    from numpy.typing import NDArray

    from facts_damping.case.model import Case
    from facts_damping_streams.c37118.mapping import Places
    from facts_damping_streams.parameters import Streams
    from facts_damping_streams.streaming.client import Client, Lost
    from facts_damping_streams.streaming.stream_clock import Tick

LINES, LINES_S = 10, 60.0  # messages about a server in this time, s


class Sources:
    """All servers of a run and their state."""

    def __init__(self, case: Case, streams: Streams) -> None:
        self.servers = [server(text) for text in streams.servers]
        self.clients: list[Client] = []
        self.grid, self._case, self._streams = grid_pmus(case), case, streams
        self.following = Following(len(self.grid), case.run.frame_rate, streams.wait)
        self._known: list[Configuration | None] = [None] * len(self.servers)
        self._places: list[Places | None] = [None] * len(self.servers)
        self._down: dict[int, str] = {}  # reason for a lost connection, by server
        self._seen = np.zeros(len(self.grid), bool)  # PMUs with values in the newest tick
        self._said = [deque[float]() for _ in self.servers]  # times of the newest messages
        self._unsaid = 0
        self.wrong = False  # whether the last message reports an error
        for name in streams.pmus:
            check_known("pmus", name, [pmu.name for pmu in self.grid])

    def take(self, i: int, at_s: float, what: Configuration | Instant | Lost) -> str:
        """Process data of server i at a time of this computer's clock. Returns a message for the user, or none."""
        self.wrong = False
        if isinstance(what, Instant):
            self._instant(i, at_s, what)
            return ""
        text = self._configuration(i, what) if isinstance(what, Configuration) else self._lost(i, what)
        return one_line(text) if text and self._may_say(i, at_s) else ""

    def _may_say(self, i: int, at_s: float) -> bool:
        """Whether a message about server i may be shown: of those after `LINES` in `LINES_S`, only the count is."""
        while self._said[i] and at_s - self._said[i][0] > LINES_S:
            self._said[i].popleft()
        if len(self._said[i]) == LINES:
            self._unsaid += 1
            return False
        self._said[i].append(at_s)
        return True

    def _lost(self, i: int, what: Lost) -> str:
        """Note that the connection to server i is lost."""
        known = self._down.get(i)
        self._down[i] = str(what)
        self._await()
        return "" if known == str(what) else f"{self.servers[i]}: {what}"

    def _instant(self, i: int, at_s: float, what: Instant) -> None:
        server_places = self._places[i]
        if server_places is None:
            return
        values, status, absent = mapping.values_of(server_places, what.data)
        if what.quality & stat.FAULT == stat.FAULT:
            status |= UNSYNCHRONISED
        rate = self._case.run.frame_rate
        number = what.soc * rate + round(what.fraction * rate / TIME_BASE)
        self.following.put(number, PmuReport(server_places.pmus, values, status, absent), at_s)

    def _configuration(self, i: int, what: Configuration) -> str:
        """Use a configuration if it fits; otherwise the server's PMUs are absent until one does."""
        back = self._down.pop(i, None) is not None
        if what == self._known[i]:
            self._await()
            return f"{self.servers[i]}: is back" if back else ""
        self._known[i] = what
        try:
            self._check(what)
            self._places[i] = self._placed(i, what)
        except InputError as error:
            self._places[i], self.wrong = None, True
            text = f"{self.servers[i]}: {error}"
        else:
            names = self._names(self._of([i])) or "none"
            text = f"{self.servers[i]}: {len(what.pmus)} PMUs, {what.rate} frames/s; PMUs: {names}"
        if self.following.first is None:
            sound = [
                c
                for c, server_places in zip(self._known, self._places, strict=True)
                if c is not None and server_places is not None
            ]
            self.following.ahead = latency(sound, self._case.run.frame_rate)
        self._await()
        return text

    def _placed(self, i: int, c: Configuration) -> Places:
        """PMUs of a server and their places in its data. Raises InputError if another server has one of them."""
        placed = mapping.places(c, self.grid, self._streams.pmus)
        for j, other in enumerate(self._places):
            twice = [] if other is None or j == i else np.intersect1d(placed.pmus, other.pmus).tolist()
            if twice:
                problem = f"PMU {self.grid[twice[0]].name}: in this stream and in {self.servers[j]}"
                raise InputError(f"{problem}; allowed: each PMU in one")
        return placed

    def _await(self) -> None:
        self.following.alignment.awaited[:] = False
        self.following.alignment.awaited[self._of(i for i in range(len(self.servers)) if i not in self._down)] = True

    def _of(self, servers: Iterable[int]) -> NDArray[np.intp]:
        placed = [self._places[i] for i in servers]
        return np.sort(
            np.concatenate([np.zeros(0, np.intp), *(places.pmus for places in placed if places is not None)])
        )

    def _check(self, c: Configuration) -> None:
        """Raise InputError for a stream that does not fit the run's grid."""
        rate, nominal = self._case.run.frame_rate, round(self._case.system.frequency)
        if c.rate != rate:
            raise InputError(f"DATA_RATE: {c.rate} frames/s given; allowed: {rate}, the run's frame_rate")
        slow = next((pmu for pmu in c.pmus if pmu.site.group_delay_us > 1e6 * JUMP_S), None)
        if slow is not None:
            problem = f"GRP_DLY: {slow.site.group_delay_us / 1e6:g} s given by {slow.name}"
            raise InputError(f"{problem}; allowed: 0 to {JUMP_S:g} s")
        other = next((pmu for pmu in c.pmus if pmu.nominal_hz != nominal), None)
        if other is not None:
            raise InputError(f"FNOM: {other.nominal_hz} Hz given by {other.name}; allowed: {nominal} Hz, the system's")

    def rows(self, tick: Tick, start_ns: int) -> NDArray[Any]:
        """Entries of a tick (DELIVERY), for PMUs with values."""
        self._seen = np.zeros(len(self.grid), bool) if tick.frame is None else tick.frame.there
        if tick.frame is None:
            return np.zeros(0, DELIVERY)
        measured = tick_ns(tick.number - self.following.ahead, self._case.run.frame_rate)
        return entries(start_ns, tick.frame.values, np.where(tick.frame.there, measured, NEVER), tick.frame.status)

    def _names(self, places: NDArray[np.intp]) -> str:
        return some_of([self.grid[s].name for s in places.tolist()])

    def unknown(self) -> bool:
        """Whether no configuration has arrived yet."""
        return not any(self._known)

    def flaws(self) -> list[str]:
        """Servers and PMUs that are missing, as texts."""
        known = self._of(range(len(self.servers)))
        lacking, unknown = known[~self._seen[known]], np.setdiff1d(np.arange(len(self.grid)), known)
        return [
            *(f"{self.servers[i]}: {why}" for i, why in self._down.items()),
            *(
                f"{client.server}: {client.receiver.why}"
                for client in self.clients
                if client.receiver.why and client.receiver.changed
            ),
            *([f"absent: {self._names(lacking)}"] if lacking.size else []),
            *([f"in no stream: {self._names(unknown)}"] if unknown.size else []),
        ]

    def counts(self) -> dict[str, int]:
        """Counters of frames received and missing."""
        receivers = [client.receiver for client in self.clients]
        return {
            "connections": sum(client.connections for client in self.clients),
            "late_entries": self.following.alignment.late,
            "moved_stamps": self.following.moved,
            "omitted_messages": self._unsaid,
            "refused_frames": sum(sum(receiver.refused.values()) for receiver in receivers),
            "lost_bytes": sum(receiver.lost_bytes for receiver in receivers),
        }
