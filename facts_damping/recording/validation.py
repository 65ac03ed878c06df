"""Leaves out messages that do not belong to the run, with notes: other programs may publish on its topics."""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from facts_damping.recording.columns import counted, kept
from facts_damping.recording.decode import time_ns
from facts_damping.signals import NANOSECONDS

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator, Mapping, Sequence

    from facts_damping.recording.columns import Block

# Where names stand in messages, by kind: owner of the name, list, field of its entries (none: the entry itself).
_OF_SETPOINTS = [("device", "setpoints", "device"), ("controller", "setpoints", "controller")]
NAMES: dict[str, list[tuple[str, str, str]]] = {
    "frames": [("pmu", "frames", "pmu")],
    "state": [("machine", "machines", "machine"), ("device", "devices", "device")],
    "delivered": [("pmu", "frames", "pmu")],
    **dict.fromkeys(("issued", "supervised", "applied"), _OF_SETPOINTS),
    "estimates": [("device", "input_names", "")],
    "learning": [],
    "supervision": [],
}
# Kinds whose stamp is that of their tick.
TIMED = ("frames", "state", "delivered", "issued", "supervised", "supervision", "applied")
MAX_TICKS = 2**53  # used if the run does not state its number of ticks
SHOWN = 20  # characters of a foreign name in a note
LISTED = 5  # foreign names listed in notes


class Expected(NamedTuple):
    """Valid content of a run's messages: names by kind of owner (a missing kind allows any name), and ticks."""

    names: Mapping[str, Collection[str]]
    frame_rate: int | None
    ticks: int


def expected(configuration: Mapping[str, Any]) -> Expected:
    """Valid names and ticks by a run's configuration."""
    system, rate, duration = (configuration.get(key) for key in ("system", "frame_rate", "duration"))
    names: dict[str, Collection[str]] = {}
    if isinstance(system, dict):
        names = {kind: [row["name"] for row in system[f"{kind}s"]] for kind in ("pmu", "machine")}
    if configuration.get("devices") is not None:
        names["device"] = configuration["devices"]
    ticks = MAX_TICKS
    if isinstance(rate, int) and isinstance(duration, int | float):
        ticks = max(1, round(duration * rate))
    return Expected(names, rate, ticks)


def drop_foreign(
    messages: dict[str, list[Block]], topics: Mapping[str, Sequence[str]], of: Expected, notes: list[str]
) -> None:
    """Leave out messages that do not belong to the run, with counts in `notes`; `topics`: by kind.

    The plant's messages come first: the names in them are valid in the others.
    """
    senders = {topic: sender(messages[topic], topic) for topic in topics["issued"]}
    for kind in NAMES:
        for topic in topics[kind]:
            of_topic = of
            if kind in ("issued", "supervised", "supervision", "applied") and senders:
                names = [senders[topic]] if kind == "issued" else list(senders.values())
                of_topic = of._replace(names={**of.names, "controller": names})
            messages[topic] = _sift(kind, topic, messages[topic], of_topic, notes)
            if kind in ("frames", "state"):
                of = of._replace(names={**of.names, **_named(kind, messages[topic])})


def _sift(kind: str, topic: str, blocks: Sequence[Block], of: Expected, notes: list[str]) -> list[Block]:
    """Messages of a topic that belong to the run; `notes` count the others."""
    valid: list[Block] = []
    unknown: Counter[str] = Counter()
    odd: Counter[str] = Counter()
    for block in blocks:
        foreign = [name for whose, name in _names(kind, block.message) if name not in of.names.get(whose, [name])]
        if foreign:
            unknown[foreign[0]] += len(block.rows)
            continue
        if not _whole(kind, block.message):
            odd["with lists of a wrong length"] += len(block.rows)
            continue
        ticks = np.asarray(block.message.tick, np.uint64)
        later = ticks >= of.ticks
        wrong = np.zeros(len(ticks), np.bool_)
        if kind in TIMED and of.frame_rate is not None and hasattr(block.message, "header"):
            start = np.where(later, 0, ticks).astype(np.int64) * NANOSECONDS // of.frame_rate
            wrong = ~later & (time_ns(block.message.header.stamp) != start)
        odd["of ticks outside the run"] += int(later.sum())
        odd["with the stamp of another tick"] += int(wrong.sum())
        valid.append(kept(block, np.where(later | wrong, -1, block.rows)))
    rows = [(f"with the unknown name {name[:SHOWN]!r}", count) for name, count in unknown.most_common(LISTED)]
    rows.append(("with other unknown names", unknown.total() - sum(count for _, count in rows)))
    notes += [f"{topic}: {count} messages {what} are left out" for what, count in (*rows, *odd.items()) if count]
    return counted([block for block in valid if len(block.rows)])


def _whole(kind: str, message: Any) -> bool:
    if kind == "learning":
        return bool(message.parameter_groups) or not message.learning_rates
    if kind == "supervision":
        return len(message.monitors) == len(message.values)
    if kind == "estimates":
        signals = {len(getattr(message, name)) for name in ("prediction", "error", "change")}
        return len(signals) == 1 and len(message.jacobian) == signals.pop() * len(message.input_names)
    return True


def _names(kind: str, message: Any) -> Iterator[tuple[str, str]]:
    """Names in a message, as pairs (kind of owner, name)."""
    if kind in ("issued", "supervision"):
        yield "controller", message.controller
    for whose, entries, field in NAMES.get(kind, ()):
        for entry in getattr(message, entries):
            yield whose, getattr(entry, field) if field else entry


def _named(kind: str, blocks: Sequence[Block]) -> dict[str, list[str]]:
    """Names in the messages of a kind, by kind of owner."""
    return {
        whose: list(dict.fromkeys(name for block in blocks for of, name in _names(kind, block.message) if of == whose))
        for whose, _, _ in NAMES[kind]
    }


def sender(blocks: Sequence[Block], topic: str) -> str:
    """Name of the controller of a setpoint topic: from the topic's name, else the most frequent in its messages."""
    name, counts = topic.split("/")[-2], Counter[str]()
    for block in blocks:
        counts[block.message.controller] += len(block.rows)
    return name if name in counts or not counts else counts.most_common(1)[0][0]
