"""Content of a recording's files before decoding."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from facts_damping.recording.bagfile import TopicInfo


class RawMessage(NamedTuple):
    """One message: topic, reception and publication time (ns), publisher's counter, CDR bytes."""

    topic: str
    log_ns: int
    publish_ns: int
    sequence: int
    data: bytes


@dataclass
class Content:
    """All that could be read. `complete`: no file is cut; `notes`: damage found."""

    topics: dict[str, TopicInfo] = field(default_factory=dict)
    messages: list[RawMessage] = field(default_factory=list)
    configuration: str = ""
    versions: dict[str, str] = field(default_factory=dict)
    lost: dict[str, int] = field(default_factory=dict)
    publishers: dict[str, str] = field(default_factory=dict)  # node by `topic identity`
    digest: str = ""  # as stored when the recording was made; empty: not stored
    complete: bool = True
    notes: list[str] = field(default_factory=list)

    def add_topic(self, topic: TopicInfo) -> bool:
        """Add a topic. Returns whether type and schema agree with those known; if not, adds a note."""
        known = self.topics.setdefault(topic.name, topic)
        same = (known.message_type, known.schema) == (topic.message_type, topic.schema)
        if not same:
            types = f"{known.message_type}, {topic.message_type}"
            self.notes.append(f"{topic.name} has two types: {types}; messages of the second are left out")
        return same

    def refusal(self, reason: str) -> str:
        """Error message in one line: the reason, then the damage that may have caused it."""
        return "; ".join([reason, *self.notes])
