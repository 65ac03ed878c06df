"""Streams of PMUs that a run follows: the servers, and which of their channels are those of the system's PMUs."""

from __future__ import annotations

import ipaddress
import re
from typing import TYPE_CHECKING, Any, NamedTuple

from pydantic import Field, field_validator, model_validator

from facts_damping.errors import InputError
from facts_damping.fields import Name, ParameterModel, quantity
from facts_damping.parameters.field_errors import check
from facts_damping.parameters.files import find, read_table

if TYPE_CHECKING:
    from collections.abc import Mapping

UNITS: Mapping[str, Mapping[str, float]] = {  # by quantity: SI units, or p.u., for one of the unit
    "voltage": {"V": 1.0, "kV": 1e3},
    "current": {"A": 1.0, "kA": 1e3},
    "active_power": {"kW": 1e3, "W": 1.0, "MW": 1e6},
    "reactive_power": {"kvar": 1e3, "var": 1.0, "Mvar": 1e6},
    "speed": {"ppm": 1e-6, "p.u.": 1.0},
}
KINDS = ("tcp", "udp")
ALLOWED = "tcp://HOST:PORT/IDCODE, udp://HOST:PORT/IDCODE, udp://@ADDRESS:PORT/IDCODE"
MAX_ID = 65534


class Server(NamedTuple):
    """Where a stream comes from."""

    kind: str  # of KINDS
    spontaneous: bool  # it sends to an address of this computer, or to a group, and takes no commands
    host: str
    port: int
    idcode: int

    def __str__(self) -> str:
        """As it is given."""
        return f"{self.kind}://{'@' if self.spontaneous else ''}{self.host}:{self.port}/{self.idcode}"


def server(text: str) -> Server:
    """A server from `tcp://HOST:PORT/IDCODE`; the IDCODE is 1 where none is given. Raises ValueError."""
    kind, _, rest = text.partition("://")
    place, _, idcode = rest.partition("/")
    host, _, port = place.rpartition(":")
    spontaneous = host.startswith("@")
    host = host.removeprefix("@")
    numbers = port.isdecimal() and 0 < int(port) < 65536 and (idcode or "1").isdecimal()
    if kind not in KINDS or not host or not numbers or (spontaneous and (kind != "udp" or not _is_address(host))):
        raise ValueError(f"'{text}' given; allowed: {ALLOWED}")
    number = int(idcode or 1)
    if not 1 <= number <= MAX_ID:
        raise ValueError(f"'{text}' given; allowed: an IDCODE of 1 to {MAX_ID}")
    return Server(kind, spontaneous, host, int(port), number)


def _is_address(host: str) -> bool:
    try:
        ipaddress.IPv4Address(host)
    except ValueError:
        return False
    return True


class Channel(ParameterModel):
    """A channel of a PMU; a name alone stands for a channel in the first of the allowed units."""

    channel: str = Field(min_length=1, max_length=255, description="name of the phasor or analog, as the PMU says it")
    unit: str | None = Field(None, description="unit of its values; none: V, A, kW, kvar, ppm")
    reverse: bool = Field(
        False, description="true: counted the other way, as of a current into the machine or against the branch"
    )


class Channels(ParameterModel):
    """Where a PMU's signals are; what is not given is looked for under the names that `pmu-serve` gives."""

    pmu: str | int | None = Field(None, description="name (STN) or IDCODE of the PMU; none: named as here")
    voltage: Channel | None = Field(None, description="phasor of the voltage, phase to ground; none: V1")
    current: Channel | None = Field(None, description="phasor of the current; none: I1")
    active_power: Channel | None = Field(
        None, description="analog of the three-phase active power; none: `P kW`, else from the phasors"
    )
    reactive_power: Channel | None = Field(None, description="analog of the reactive power; none: `Q kvar`, likewise")
    speed: Channel | None = Field(None, description="analog of the rotor's speed deviation; none: `SPEED ppm`, if any")

    @field_validator(*UNITS, mode="before")
    @classmethod
    def _named(cls, channel: Any) -> Any:
        return {"channel": channel} if isinstance(channel, str) else channel

    @model_validator(mode="after")
    def _of_its_quantity(self) -> Channels:
        for quantity_, units in UNITS.items():
            unit = getattr(getattr(self, quantity_), "unit", None)
            if unit is not None and unit not in units:
                raise ValueError(f"{quantity_}: unit '{unit}' given; allowed: {', '.join(units)}")
        return self


class Streams(ParameterModel):
    """Streams of IEEE C37.118.2 that stand in for the plant of a run ([streams](replay.md))."""

    servers: list[str] = Field(min_length=1, max_length=1000, description=f"where they come from: {ALLOWED}")
    wait: float = quantity(
        0.2, "s", "how long a frame waits, from when it is due, for those of other servers", ge=0, le=60
    )
    pmus: dict[Name, Channels] = Field(
        {}, description="PMU of the run's system: PMU and channels of the stream; none: the PMU of the same name"
    )

    @field_validator("servers")
    @classmethod
    def _are_addresses(cls, addresses: list[str]) -> list[str]:
        for text in addresses:
            server(text)
        if len(set(addresses)) < len(addresses):
            raise ValueError("a server given twice; allowed: each once")
        return addresses


def read_streams(source: str) -> Streams:
    """Streams from the path of a YAML file, or from one server's address. Raises `InputError`."""
    if "://" in source or re.fullmatch(r"[\w.-]+:\d+(/\d+)?", source):
        return check(Streams, {"servers": [source if "://" in source else f"tcp://{source}"]}, "streams")
    if not source:
        raise InputError(f"streams: nothing given; allowed: a YAML file, or {ALLOWED}")
    path = find("streams", source)
    return check(Streams, read_table(path), str(path))
