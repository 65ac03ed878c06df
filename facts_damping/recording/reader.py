"""Reads a recording back into a `Record`, the plain data of a run."""

from __future__ import annotations

from dataclasses import replace
from functools import reduce
from operator import attrgetter
from typing import TYPE_CHECKING, Any

import numpy as np

from facts_damping.digest import digest
from facts_damping.errors import OLD_NAMES, InputError, RecordingError, one_line
from facts_damping.parameters.recorded_run import recorded_run
from facts_damping.parameters.run import Run
from facts_damping.parameters.yaml_text import UNREADABLE, parse
from facts_damping.record import Record
from facts_damping.recording import decode, decoded_tables, events, gaps
from facts_damping.recording.gaps import OF_LINKS
from facts_damping.recording.scan import scan
from facts_damping.recording.validation import drop_foreign, expected, sender
from facts_damping.recording.writer import CONFIGURATION
from facts_damping.signals import NANOSECONDS

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    from facts_damping.recording.columns import Block
    from facts_damping.recording.decode import Series
    from facts_damping.recording.scan import Content
    from facts_damping.recording.validation import Expected

# Topics that are read: kind, message type, end of the topic's name. Each controller has its `/setpoints`, each link
# its `/pmu/delivered` and `/setpoints/delivered`.
KINDS = {
    "frames": ("facts_damping_msgs/msg/PmuDataFrame", "/pmu/frames"),
    "delivered": ("facts_damping_msgs/msg/PmuDataFrame", "/pmu/delivered"),
    "issued": ("facts_damping_msgs/msg/DeviceSetpoints", "/setpoints"),
    "applied": ("facts_damping_msgs/msg/DeviceSetpoints", "/setpoints/delivered"),
    "supervised": ("facts_damping_msgs/msg/DeviceSetpoints", "/supervised"),
    "supervision": ("facts_damping_msgs/msg/SupervisorState", "/state"),
    "estimates": ("facts_damping_msgs/msg/JacobianEstimate", "/estimate"),
    "learning": ("facts_damping_msgs/msg/ControllerState", "/state"),
    "state": ("facts_damping_msgs/msg/PlantState", "/plant/state"),
    "events": ("facts_damping_msgs/msg/GridEvent", "/plant/events"),
    "refused": ("facts_damping_msgs/msg/RefusedMessages", "/security/refused"),
    "diagnostics": ("diagnostic_msgs/msg/DiagnosticArray", "/diagnostics"),
    "changes": ("facts_damping_msgs/msg/RunChange", "/run/changes"),
    "run": ("facts_damping_msgs/msg/RunState", "/run/state"),
}
REQUIRED = ("frames", "state")  # required of every recording
CLOSED_LOOP = ("delivered", "issued", "applied")  # required of a run with controllers
# Kinds with several topics: one per link, controller, identifier, ...
SEVERAL = (*OF_LINKS, "issued", "supervised", "supervision", "estimates", "learning", "diagnostics")
ALL_COUNT = ("applied",)  # several messages of one tick are all kept: each has acted
SILENT_S = 0.5  # s of frames, in a cut recording
UNTIMED = ("events", "refused", "diagnostics", "changes", "run")  # messages without a tick


def load(path: Path | str) -> Record:
    """Record of a recording: a folder in rosbag2's layout or an `.mcap` file, whole or cut anywhere.

    Messages are decoded by the schemas stored in the file. Of a cut recording, the ticks are kept that all topics have
    which were not silent before. `Record.notes` list what is missing, one line each. Raises RecordingError (one line,
    with the damage found) if a topic is missing, a schema is foreign, or no tick is complete.
    """
    content = scan(path)
    configuration, notes = _configuration(content)
    try:
        record = _assemble(content, configuration, notes)
    except (ArithmeticError, AttributeError, LookupError, MemoryError, RecursionError, TypeError, ValueError) as error:
        reason = f"{path}: a message does not have this package's fields ({one_line(error)})"
        raise RecordingError(content.refusal(reason)) from error
    except RecordingError as error:
        raise RecordingError(content.refusal(f"{path}: {error}")) from error
    if content.digest and content.digest != (recomputed := digest(record)):
        stored = f"not {content.digest} as stored in it"
        record.notes.append(f"digest {recomputed}, {stored}: the recording was changed or is damaged")
    return record


def origin(path: Path | str) -> tuple[dict[str, Any], str]:
    """The run's configuration, and the namespace of its graph (`/`: none).

    Raises RecordingError as `load` does, and if the configuration is missing.
    """
    content = scan(path)
    try:
        frames = _topics(content, controlled=False)["frames"][0]
    except RecordingError as error:
        raise RecordingError(content.refusal(f"{path}: {error}")) from error
    configuration, notes = _configuration(content)
    if not configuration:
        raise RecordingError(f"{path}: {'; '.join(notes)}")
    return configuration, frames.removesuffix(KINDS["frames"][1]) or "/"


def _assemble(content: Content, configuration: dict[str, Any], notes: list[str]) -> Record:
    topics = _topics(content, bool(configuration.get("controllers")))
    silent = set() if content.complete else _silent(content, topics["frames"][0], configuration.get("frame_rate"))
    messages = _messages(content, topics, notes)
    events.subtract_epoch(messages, topics["state"], configuration.get("frame_rate"))
    of = expected(configuration)
    drop_foreign(messages, topics, of, notes)
    series = {
        kind: [decode.series(topic, messages[topic], kind in ALL_COUNT, notes) for topic in names]
        for kind, names in topics.items()
        if kind not in UNTIMED
    }
    untimed = {kind: [block for topic in topics[kind] for block in messages[topic]] for kind in UNTIMED}
    changes = events.changes(untimed["changes"])
    late = gaps.late_starts(changes)
    ticks = _ticks(series, late, content.complete, silent)
    away = gaps.find_absences(series, late, 0, int(ticks[-1]) + 1)
    notes += gaps.gap_notes(series, away, int(ticks[-1]))
    ends = [events.run_ended(messages[topic]) for topic in topics["run"]]
    lost = gaps.lost_messages(series, content.lost, ends[0][1] if ends and ends[0] else -1)
    _check_end(ticks, configuration, series["state"][0], content.complete, ends, notes)
    return replace(
        _tables(configuration, series, ticks, of),
        links=len(series["delivered"]),
        events=events.events(untimed["events"]),
        refused=events.refused(untimed["refused"]),
        joined=events.joined(untimed["diagnostics"]),
        changes=changes,
        absences=away,
        publishers=content.publishers,
        versions=content.versions,
        notes=notes,
        messages_lost=lost,
        gap_tick=gaps.first_missing(series, away, ticks),
    )


def _tables(
    configuration: dict[str, Any], series: Mapping[str, Sequence[Series]], ticks: NDArray[np.int64], of: Expected
) -> Record:
    """A record with the tables of its ticks; `of`: names that the run gives."""
    first, last = int(ticks[0]), int(ticks[-1])
    cut = {kind: [decode.between(part, first, last) for part in parts] for kind, parts in series.items()}
    measured, state = (decode.select(cut[kind][0], ticks) for kind in REQUIRED)
    pmus = _named(of, "pmu", measured, "frames")
    devices, machines = (_named(of, kind, state, f"{kind}s") for kind in ("device", "machine"))
    controllers, issued = _controllers(cut["issued"], cut["applied"])
    applied = decoded_tables.setpoints(cut["applied"], controllers, devices)
    frames, measured_ns, status = decoded_tables.frames(measured, pmus)
    return Record(
        configuration=configuration,
        pmus=pmus,
        machine_names=machines,
        device_names=devices,
        controller_names=controllers,
        time_ns=decode.column(state, lambda message: decode.time_ns(message.header.stamp), np.int64),
        frames=frames,
        measured_ns=measured_ns,
        status=status,
        delivered=decoded_tables.deliveries(cut["delivered"], pmus),
        issued=decoded_tables.setpoints(issued, controllers, devices),
        applied=applied if len(cut["applied"]) < 2 else decoded_tables.merged(applied),
        supervised=decoded_tables.setpoints(cut["supervised"], controllers, devices),
        supervision=decoded_tables.supervision(cut["supervision"], controllers),
        machines=decoded_tables.truth(state, "machines", "machine", machines),
        devices=decoded_tables.truth(state, "devices", "device", devices),
        estimates=decoded_tables.estimates(cut["estimates"], devices),
        learning=decoded_tables.learning(cut["learning"], cut["estimates"]),
        in_synchronism=decode.column(state, attrgetter("in_synchronism"), np.bool_),
        latest=decoded_tables.latest("controller", cut["learning"], attrgetter("controller"))
        | decoded_tables.latest("identifier", cut["estimates"], attrgetter("identifier"))
        | decoded_tables.latest("supervisor", cut["supervision"], attrgetter("controller")),
    )


def _configuration(content: Content) -> tuple[dict[str, Any], list[str]]:
    """Configuration stored in the file, and notes on damage and on messages that the recorder lost."""
    notes = list(content.notes)
    for whose, count in content.lost.items():
        topic, _, publisher = whose.partition(" ")
        of = f" of {publisher}" if publisher else ""
        notes += [f"{topic}: the recorder lost {count} messages{of}"] if count else []
    try:
        configuration = parse(content.configuration)
    except UNREADABLE as error:
        return {}, [*notes, f"the run's configuration cannot be read and is left out: {one_line(error)}"]
    if not isinstance(configuration, dict):
        return {}, [*notes, "the run's configuration is missing"]
    try:
        return recorded_run(configuration, CONFIGURATION), notes
    except InputError as error:
        return {}, [*notes, f"the run's configuration does not fit this version and is left out: {error}"]


def _topics(content: Content, controlled: bool) -> dict[str, list[str]]:
    """Names of the recorded topics of each kind. Raises RecordingError if one is missing or not unique."""
    topics = {
        kind: [
            name
            for name, topic in content.topics.items()
            if topic.message_type == message_type and name.endswith(suffix)
        ]
        for kind, (message_type, suffix) in KINDS.items()
    }
    for kind in REQUIRED + (CLOSED_LOOP if controlled else ()):
        if not topics[kind]:
            old = {topic.message_type.rpartition("/")[2] for topic in content.topics.values()} & OLD_NAMES.keys()
            before = f"; made before {min(old)} was renamed to {OLD_NAMES[min(old)]}" if old else ""
            raise RecordingError(f"no topic ...{KINDS[kind][1]} of type {KINDS[kind][0]} in the recording{before}")
    for kind, names in topics.items():
        if len(names) > 1 and kind not in SEVERAL:
            raise RecordingError(f"several topics ...{KINDS[kind][1]} in the recording: {', '.join(names)}")
    graph = topics["frames"][0].removesuffix(KINDS["frames"][1])
    for kind in OF_LINKS:
        suffix = KINDS[kind][1]
        topics[kind].sort(key=lambda name: _link_place(name.removesuffix(suffix), graph, topics["issued"]))
    return topics


def _link_place(namespace: str, graph: str, issued: Sequence[str]) -> int:
    """Index in the run of the controller that owns a link, by the controllers in the namespace or by its name.

    -1 for the run's own link, which is in the graph's namespace.
    """
    if namespace == graph:
        return -1
    beside = [name.rsplit("/", 2)[1] for name in issued if name.rsplit("/", 2)[0] == namespace]
    return max(decode.place(name) for name in [*beside, namespace.rpartition("/")[2]])


def _messages(content: Content, topics: Mapping[str, Sequence[str]], notes: list[str]) -> dict[str, list[Block]]:
    """Decoded messages of the given topics, by kind, in file order. Empties `content.messages`.

    Copies of setpoints are left out: only one of them has acted.
    """
    data: dict[str, list[bytes]] = {topic: [] for names in topics.values() for topic in names}
    for message in content.messages:
        if message.topic in data:
            data[message.topic].append(message.data)
    content.messages.clear()  # frees the memory: an hour of messages takes a gigabyte
    for topic in (name for kind in ALL_COUNT for name in topics[kind]):
        count, data[topic] = len(data[topic]), list(dict.fromkeys(data[topic]))
        if len(data[topic]) < count:
            notes.append(f"{topic}: {count - len(data[topic])} messages are copies of others: the first counts")
    blocks: dict[str, list[Block]] = {}
    for topic in list(data):
        try:
            blocks[topic] = decode.decode(content.topics[topic], data.pop(topic), notes)
        except RecordingError as error:
            if not content.topics[topic].message_type.startswith("diagnostic_msgs/"):
                raise
            blocks[topic] = []  # any program may publish diagnostics
            notes.append(f"{topic} is left out: {error}")
    return blocks


def _silent(content: Content, frames: str, frame_rate: Any) -> set[str]:
    """Topics without a message in the last `SILENT_S` of frames: their nodes had ended before the recording did."""
    passed, count = dict.fromkeys(content.topics, 0), 0  # frames before the newest message of each topic
    for message in content.messages:
        count += message.topic == frames
        passed[message.topic] = count
    rate = frame_rate if isinstance(frame_rate, int) else Run.model_fields["frame_rate"].default
    return {topic for topic, before in passed.items() if count - before > SILENT_S * rate}


def _ticks(
    series: dict[str, list[Series]], late: set[tuple[str, int, int]], complete: bool, silent: set[str]
) -> NDArray[np.int64]:
    """Ticks that the record keeps: those of both frames and state; of a cut recording, up to the last that all have.

    If the recording starts after tick 0, they begin at the first complete tick (`late`: nodes that began later),
    because a recorder does not discover all topics at once. The tick that ends an unstable run stays: it needs no
    reply. `silent`: topics that do not count at the end. Raises RecordingError if none is left.
    """
    plant, everything = [series[kind][0] for kind in REQUIRED], [part for parts in series.values() for part in parts]
    ticks: NDArray[np.int64] = reduce(np.intersect1d, [part.ticks for part in plant])
    needed = everything if len(ticks) or not complete else plant
    synchronous = decode.column(plant[1], attrgetter("in_synchronism"), np.bool_)
    ended = len(synchronous) > 0 and not synchronous[-1]
    if not complete and not ended:
        last = min(part.ticks[-1] if len(part.ticks) else -1 for part in everything if part.topic not in silent)
        ticks = ticks[ticks <= last]
    if len(ticks) and ticks[0] > 0:
        ticks = ticks[ticks >= gaps.first_complete_tick(series, late)]
    if not len(ticks):
        raise RecordingError(f"no tick is complete in the recording: {_apart(needed)}")
    return ticks


def _apart(needed: Sequence[Series]) -> str:
    """Why series share no tick: names the empty ones, else the one that ends first and the one that begins last."""
    silent = [part.topic for part in needed if not len(part.ticks)]
    if silent:
        return f"no message of {', '.join(silent)}"
    first, last = min(needed, key=lambda part: part.ticks[-1]), max(needed, key=lambda part: part.ticks[0])
    return f"{first.topic} ends with tick {first.ticks[-1]}, {last.topic} begins with tick {last.ticks[0]}"


def _check_end(
    ticks: NDArray[np.int64],
    configuration: dict[str, Any],
    state: Series,
    complete: bool,
    ends: list[tuple[str, int] | None],
    notes: list[str],
) -> None:
    """Note where a recording was cut, or that the run did not end by itself; `ends`: reason and tick of its plant.

    A recording without the plant's `/run/state` gets no such note.
    """
    reason, last = (ends[0] if ends else None) or ("", -1)
    if not complete:
        why = "the end is missing"
    elif ends == [None]:
        why = "the run was cut off, perhaps killed: its plant has not reported an end"
    elif reason == events.STOPPED:
        why = "the run was stopped"
    elif reason.startswith(events.FAILED):
        why = f"the run {reason}"
    elif last > ticks[-1]:
        why = f"the rest is missing: the run ended with tick {last}"
    else:
        return
    times = decode.column(state, lambda message: decode.time_ns(message.header.stamp), np.int64)
    end = times[int(np.searchsorted(state.ticks, ticks[-1]))] / NANOSECONDS
    duration = configuration.get("duration")
    of = f" of {duration:g} s" if isinstance(duration, int | float) else ""
    notes.append(f"{why}: the record ends with tick {ticks[-1]} at {end:.3f} s{of}")


def _named(of: Expected, kind: str, series: Series, entries: str) -> list[str]:
    """PMUs, devices or machines in the run's order, silent ones included; else in order of appearance."""
    return list(of.names.get(kind) or decode.names_of(series.blocks, entries, kind))


def _controllers(issued: Sequence[Series], applied: Sequence[Series]) -> tuple[list[str], list[Series]]:
    """Names of the controllers and their series, in the order of the run, else of the recording."""
    named = [(sender(part.blocks, part.topic), part) for part in issued]
    named.sort(key=lambda pair: decode.place(pair[0]))
    seen = decode.names_of([block for part in applied for block in part.blocks], "setpoints", "controller")
    return list(dict.fromkeys([name for name, _ in named] + seen)), [part for _, part in named]
