"""A storm as its file has it: a run, its mode, the start of its nodes, and events."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Literal

from pydantic import Field

from facts_damping.fields import ParameterModel, quantity
from facts_damping.parameters.field_errors import check
from facts_damping.parameters.files import read_table
from facts_damping.parameters.yaml_text import dump

if TYPE_CHECKING:
    from pathlib import Path


class Event(ParameterModel):
    """One event; which fields a kind has is in `events.KINDS`."""

    at: float = quantity(..., "s", "simulated time; negative: while the nodes start", ge=-1, le=1e5)
    kind: str = Field(description="kind of event")
    node: str = Field("", description="node that it happens to")
    topic: str = Field("", description="topic, relative to the graph's namespace")
    lasts: float = quantity(0.0, "s", "how long it lasts; 0: for ever, or no time", ge=0, le=1e5)
    size: float = quantity(0.0, "-", "size, in the unit of the kind")
    name: str = Field("", description="name of a service or a parameter")
    value: Any = Field(None, description="value of a parameter, or a request")


class Storm(ParameterModel):
    """A graph on a loopback, and what happens to it."""

    seed: int = quantity(..., "-", "seed of the order of turns, of discovery and of messages", ge=0, le=2**63 - 1)
    mode: Literal["lockstep", "realtime", "free"] = Field("lockstep", description="mode of the graph")
    run: dict[str, Any] = Field({}, description="run, inline")
    signed: bool = Field(False, description="whether messages are signed")
    discovery: float = quantity(0.0, "s", "longest time until nodes discover each other", ge=0, le=60)
    lease: float = quantity(20.0, "s", "time after which nodes that are silent are forgotten", ge=0, le=60)
    events: list[Event] = Field([], description="events in the order of time")

    def text(self) -> str:
        """Text of its file."""
        content = self.model_dump(exclude_defaults=True)
        return dump({"seed": self.seed, **content})


def read(path: Path) -> Storm:
    """Read the file of a storm. Raises `InputError`."""
    return check(Storm, read_table(path), str(path))
