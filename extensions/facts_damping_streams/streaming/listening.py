"""Data received from servers, as text: configurations and newest values."""

from __future__ import annotations

import asyncio
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from facts_damping_streams.c37118.configuration import FORMATS, Configuration
from facts_damping_streams.c37118.session import Instant
from facts_damping_streams.streaming.client import Client

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from facts_damping_streams.c37118.configuration import PmuConfiguration
    from facts_damping_streams.parameters import Server

TITLES = ("PMU", "IDCODE", "format", "channel", "value")


@dataclass
class ServerState:
    """Data received from one server."""

    server: Server
    configuration: Configuration | None = None
    newest: Instant | None = None
    frames: int = 0
    lost: str = ""  # why there is no connection
    refused: dict[str, int] = field(default_factory=dict)  # invalid frames, by the wrong field
    why: str = ""  # what was wrong with the newest invalid frame

    def take(self, what: Any) -> None:
        """Store what was received."""
        if isinstance(what, Configuration):
            self.configuration, self.newest, self.lost = what, None, ""
        elif isinstance(what, Instant):
            self.newest, self.frames = what, self.frames + 1
        else:
            self.lost = str(what)

    def __str__(self) -> str:
        """One line of text."""
        c = self.configuration
        if c is None:
            why = self.lost or self.why or "no answer; is the IDCODE right?"
            return f"{self.server}: no configuration: {why}"
        rate = f"{c.rate} frames/s" if c.rate > 0 else f"a frame in {-c.rate} s"
        refused = f", {sum(self.refused.values())} refused ({self.why})" if self.refused else ""
        return f"{self.server}: {len(c.pmus)} PMUs, {rate}; {self.frames} frames have come{refused}"

    def values(self) -> Iterator[tuple[PmuConfiguration, list[tuple[str, float | None, str]]]]:
        """PMUs with their channels: name, newest value, unit."""
        if self.configuration is None:
            return
        data = None if self.newest is None else self.newest.data
        phasors, analogs = 0, 0
        for i, pmu in enumerate(self.configuration.pmus):
            rows: list[tuple[str, float | None, str]] = []
            for name, of, unit in (("STAT", "status", ""), ("FREQ", "frequency", "Hz"), ("DFREQ", "rocof", "Hz/s")):
                rows.append((name, None if data is None else float(getattr(data, of)[i]), unit))
            for j, phasor in enumerate(pmu.phasors, phasors):
                magnitude, angle = (None, None) if data is None else map(float, data.phasors[j])
                rows.append((phasor.name, magnitude, "A" if phasor.current else "V"))
                rows.append((f"{phasor.name} angle", angle, "rad"))
            for j, analog in enumerate(pmu.analogs, analogs):
                rows.append((analog.name, None if data is None else float(data.analogs[j]), ""))
            phasors, analogs = phasors + len(pmu.phasors), analogs + len(pmu.analogs)
            yield pmu, rows

    def rows(self) -> Iterator[tuple[str, ...]]:
        """Table rows, one per channel; the first row of a PMU names it."""
        for pmu, channels in self.values():
            first = (pmu.name, str(pmu.idcode), _format(pmu))
            for name, value, unit in channels:
                text = (
                    "-" if value is None else f"{int(value):#06x}" if name == "STAT" else f"{value:.6g} {unit}".strip()
                )
                yield (*first, name, text)
                first = ("", "", "")

    def result(self) -> dict[str, Any]:
        """Content for JSON."""
        pmus = [
            {
                "name": pmu.name,
                "idcode": pmu.idcode,
                "nominal_hz": pmu.nominal_hz,
                "format": [name for name in FORMATS if getattr(pmu, name)],
                "channels": [{"name": name, "value": value, "unit": unit} for name, value, unit in channels],
            }
            for pmu, channels in self.values()
        ]
        rate = None if self.configuration is None else self.configuration.rate
        return {
            "server": str(self.server),
            "rate": rate,
            "frames": self.frames,
            "refused": self.refused,
            "lost": self.lost or None,
            "pmus": pmus,
        }


def _format(pmu: PmuConfiguration) -> str:
    """Text of FORMAT: polar or rectangular, and which values are floats."""
    floats = [name.removeprefix("float_") for name in FORMATS if name.startswith("float_") and getattr(pmu, name)]
    return f"{'polar' if pmu.polar else 'rectangular'}, floats: {', '.join(floats) or 'none'}"


async def listen(servers: Sequence[Server], seconds: float) -> list[ServerState]:
    """Data received from servers within `seconds`."""
    states = [ServerState(server) for server in servers]
    clients = [Client(state.server, state.take) for state in states]
    tasks = {asyncio.ensure_future(client.run()) for client in clients}
    await asyncio.wait(tasks, timeout=seconds)
    for task in tasks:
        task.cancel()
    await asyncio.wait(tasks, timeout=seconds)
    for state, client in zip(states, clients, strict=True):
        state.refused, state.why = dict(client.receiver.refused), client.receiver.why
    return states
