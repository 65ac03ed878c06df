"""From CDR messages to the arrays of `facts_damping.signals`."""

from __future__ import annotations

import re
from functools import lru_cache
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from rosbags.typesys import Stores, TypesysError, get_typestore

from facts_damping.errors import RecordingError
from facts_damping.monitor_table import CODES, MONITORS, STATES, cause_code
from facts_damping.recording.columns import Block, blocks, kept
from facts_damping.recording.fields import DEVICE_FIELDS, FRAME_FIELDS, MACHINE_FIELDS, check_fields
from facts_damping.recording.schemas import parse_schema
from facts_damping.signals import (
    CHANNELS,
    DELIVERY,
    DEVICE_TRUTH,
    ESTIMATE,
    LEARNING,
    LOST,
    MACHINE_TRUTH,
    NANOSECONDS,
    SETPOINT,
    SUPERVISION,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping, Sequence

    from numpy.typing import NDArray
    from rosbags.typesys.store import Typestore

    from facts_damping.recording.bagfile import TopicInfo


NewestTicks = dict[tuple[str, int, str], "NDArray[np.int64]"]


class Series(NamedTuple):
    """Messages of one topic in order of ticks: the topic's name, its ticks, the messages by the column.

    The rows of the blocks are places among the ticks.
    """

    topic: str
    ticks: NDArray[np.int64]
    blocks: list[Block]


def decode(topic: TopicInfo, data: Sequence[bytes], notes: list[str]) -> list[Block]:
    """Messages of a topic by the schema stored with it; those that do not fit it are left out, and told in `notes`.

    Raises RecordingError if the schema cannot be read or has not the fields that are read of our messages.
    """
    if not data:  # then an older schema harms nobody
        return []
    store = _store(topic.message_type, topic.schema)
    try:
        found, odd = blocks(data, store.fielddefs, topic.message_type)
    except KeyError as error:
        raise RecordingError(f"{topic.name}: the schema of {topic.message_type} lacks {error}") from error
    if odd:
        notes.append(f"{topic.name}: {odd} messages that are no {topic.message_type} are left out")
    return found


@lru_cache(maxsize=64)
def _store(message_type: str, schema: str) -> Typestore:
    """Types of one schema; kept, because rosbags compiles code for every type of every store."""
    definitions = parse_schema(message_type, schema)
    check_fields(message_type, definitions)
    store = get_typestore(Stores.EMPTY)
    try:
        store.register(definitions)
    except TypesysError as error:
        raise RecordingError(f"schema of {message_type}: {error}") from error
    return store


def series(topic: str, found: Sequence[Block], several: bool = False) -> tuple[Series, int]:
    """Messages sorted by their tick, the first of each, or all if `several`; and how many are not the first."""
    count = sum(len(block.rows) for block in found)
    ticks = np.zeros(count, np.int64)
    for block in found:
        ticks[block.rows] = block.message.tick
    sorted_ticks, first = np.unique(ticks, return_index=True)
    again = count - len(sorted_ticks)
    if several and again:
        first = np.argsort(ticks, kind="stable")
        sorted_ticks = ticks[first]
    place = np.full(count, -1)
    place[first] = np.arange(len(first))
    return Series(topic, sorted_ticks, _placed(found, place)), again


def select(source: Series, ticks: NDArray[np.int64]) -> Series:
    """Part of a series that belongs to the given ticks."""
    return _part(source, np.isin(source.ticks, ticks))


def between(source: Series, first: int, last: int) -> Series:
    """Part of a series from a tick up to another."""
    return _part(source, (source.ticks >= first) & (source.ticks <= last))


def _part(source: Series, keep: NDArray[np.bool_]) -> Series:
    place = np.where(keep, np.cumsum(keep) - 1, -1)
    return Series(source.topic, source.ticks[keep], _placed(source.blocks, place))


def _placed(found: Sequence[Block], place: NDArray[np.int64]) -> list[Block]:
    """Blocks at other places, in the order in which each first appears; without messages whose place is negative."""
    moved = [kept(block, place[block.rows]) for block in found]
    return sorted((block for block in moved if len(block.rows)), key=lambda block: int(block.rows.min()))


def column(source: Series, take: Callable[[Any], NDArray[Any]], kind: type) -> NDArray[Any]:
    """What `take` gives of a message, for each tick: (ticks,)."""
    values: NDArray[Any] = np.zeros(len(source.ticks), kind)
    for block in source.blocks:
        values[block.rows] = take(block.message)
    return values


def names_of(found: Iterable[Block], entries: str, name: str) -> list[str]:
    """Names in the field `name` of the entries of messages, in order of appearance."""
    return list(dict.fromkeys(getattr(entry, name) for block in found for entry in getattr(block.message, entries)))


def time_ns(time: Any) -> NDArray[np.int64]:
    """A builtin_interfaces/Time in ns."""
    return np.asarray(np.asarray(time.sec, np.int64) * NANOSECONDS + time.nanosec, np.int64)


def frames(source: Series, stations: Sequence[str]) -> tuple[NDArray[np.float64], NDArray[np.int64], NDArray[np.int64]]:
    """Reported frames, (ticks, stations, channels), their times and status, (ticks, stations).

    NaN, LOST and 0 where a station did not report.
    """
    values = np.full((len(source.ticks), len(stations), len(CHANNELS)), np.nan)
    measured_ns, status = np.full(values.shape[:2], LOST), np.zeros(values.shape[:2], np.int64)
    index = _index(stations)
    for block in source.blocks:
        for entry in block.message.frames:
            at = block.rows, index[entry.station]
            values[at], status[at] = _values(entry, FRAME_FIELDS), entry.status
            measured_ns[at] = time_ns(entry.header.stamp)
    return values, measured_ns, status


def truth(source: Series, entries: str, name: str, names: Sequence[str]) -> NDArray[Any]:
    """Truth about machines or devices (`entries` of PlantState), (ticks, names); NaN where it is missing."""
    fields, layout = (MACHINE_FIELDS, MACHINE_TRUTH) if entries == "machines" else (DEVICE_FIELDS, DEVICE_TRUTH)
    values = np.full((len(source.ticks), len(names), len(fields)), np.nan)
    index = _index(names)
    for block in source.blocks:
        for entry in getattr(block.message, entries):
            values[block.rows, index[getattr(entry, name)]] = _values(entry, fields)
    return values.view(layout)[..., 0] if values.size else np.empty(values.shape[:2], layout)


def deliveries(sources: Sequence[Series], stations: Sequence[str]) -> NDArray[Any]:
    """Frames as the links delivered them, a row (DELIVERY) an entry, by tick, then by link.

    Raises RecordingError: unknown station.
    """
    index = _index(stations)
    parts = [
        _rows(
            DELIVERY,
            block,
            source,
            station=_lookup(index, entry.station, source.topic),
            link=link,
            status=entry.status,
            measured_ns=time_ns(entry.header.stamp),
            arrival_ns=time_ns(entry.arrival),
            values=_values(entry, FRAME_FIELDS),
        )
        for link, source in enumerate(sources)
        for block in source.blocks
        for entry in block.message.frames
    ]
    table = _joined(parts, DELIVERY)
    return table[np.lexsort((_order(parts), table["link"], table["tick"]))]


def setpoints(sources: Sequence[Series], controllers: Sequence[str], devices: Sequence[str]) -> NDArray[Any]:
    """Setpoints of several topics, a row (SETPOINT) each, by tick, then by controller's topic.

    Raises RecordingError: unknown controller or device.
    """
    controller, device = _index(controllers), _index(devices)
    parts = [
        _rows(
            SETPOINT,
            block,
            source,
            controller=_lookup(controller, entry.controller, source.topic),
            device=_lookup(device, entry.device, source.topic),
            measured_ns=time_ns(entry.header.stamp),
            issued_ns=time_ns(entry.issued),
            effective_ns=time_ns(entry.effective),
            value=entry.value_pu,
        )
        for source in sources
        for block in source.blocks
        for entry in block.message.setpoints
    ]
    table = _joined(parts, SETPOINT)
    return table[np.lexsort((_order(parts), table["tick"]))]


def supervision(sources: Sequence[Series], controllers: Sequence[str]) -> NDArray[Any]:
    """What supervisors told of themselves, a row (SUPERVISION) a tick and supervisor, in the order of controllers.

    Monitors that this version does not know are left out; those that are not told are NaN. Raises RecordingError:
    unknown controller.
    """
    controller, parts = _index(controllers), []
    for source in sources:
        for block in source.blocks:
            message = block.message
            values = np.full((len(block.rows), len(MONITORS)), np.nan)
            for name, given in zip(message.monitors, message.values, strict=False):
                if name in CODES:
                    values[:, CODES[name]] = given
            parts.append(
                _rows(
                    SUPERVISION,
                    block,
                    source,
                    controller=_lookup(controller, message.controller, source.topic),
                    state=_known(STATES.index, message.state, source.topic),
                    cause=_known(cause_code, message.cause, source.topic),
                    refused=_known(cause_code, message.refused, source.topic),
                    share=message.share,
                    values=values,
                    probe_gain=message.probe_gain,
                    probe_phase=message.probe_phase_rad,
                    probe_coherence=message.probe_coherence,
                    added_damping=message.added_damping_per_s,
                    phase_margin=message.phase_margin_rad,
                    gain_margin=message.gain_margin,
                )
            )
    table = _joined(parts, SUPERVISION)
    return table[np.lexsort((table["controller"], table["tick"]))]


def _known(code: Callable[[str], int], name: str, topic: str) -> int:
    """The code of a word. Raises RecordingError for one that this version does not know."""
    try:
        return code(name)
    except (KeyError, ValueError) as error:
        raise RecordingError(f"{topic}: unknown word {name!r}") from error


def merged(applied: NDArray[Any]) -> NDArray[Any]:
    """Setpoints (SETPOINT) of several links as the plant takes them: by tick, then by the time they take effect."""
    return applied[np.lexsort((applied["effective_ns"], applied["tick"]))]


def estimates(sources: Sequence[Series], devices: Sequence[str]) -> NDArray[Any]:
    """What identifiers estimated, a row (ESTIMATE) a derivative, tick by tick in the order of the controllers."""
    index = _index(devices)
    parts = [
        _rows(
            ESTIMATE,
            block,
            source,
            controller=place(message.identifier),
            signal=i,
            device=_lookup(index, name, source.topic),
            measured_ns=time_ns(message.header.stamp),
            jacobian=message.jacobian[i * len(message.input_names) + j],
            prediction=message.prediction[i],
            error=message.error[i],
            ahead=message.ahead,
            change=message.change[i],
        )
        for source in sources
        for block in source.blocks
        for message in [block.message]
        for i in range(_same_length(message.prediction, message.error, message.change))
        for j, name in enumerate(message.input_names)
    ]
    table = _joined(parts, ESTIMATE)
    return table[np.lexsort((_order(parts), table["controller"], table["tick"]))]


def learning(controllers: Sequence[Series], identifiers: Sequence[Series]) -> NDArray[Any]:
    """How networks learn, a row (LEARNING) a learning rate, tick by tick: controllers, then identifiers, in order."""
    parts = [
        _rows(
            LEARNING,
            block,
            source,
            controller=place(message.identifier if identifier else message.controller),
            identifier=identifier,
            output=k // len(message.parameter_groups),
            group=k % len(message.parameter_groups),
            rate=rate,
            lyapunov=message.lyapunov,
            fall=message.lyapunov_fall,
        )
        for identifier, sources in enumerate((controllers, identifiers))
        for source in sources
        for block in source.blocks
        for message in [block.message]
        for k, rate in enumerate(message.learning_rates)
    ]
    table = _joined(parts, LEARNING)
    return table[np.lexsort((_order(parts), table["controller"], table["identifier"], table["tick"]))]


def heard(role: str, sources: Sequence[Series], sender: Callable[[Any], str]) -> NewestTicks:
    """What nodes had at hand when they acted (`signals.Record.heard`); nothing where their messages do not tell."""
    found: NewestTicks = {}
    for source in sources:
        parts: dict[tuple[str, int, str], list[NDArray[np.int64]]] = {}
        for block in source.blocks:
            names = getattr(block.message, "heard", [])
            for name, ticks in zip(names, getattr(block.message, "heard_ticks", []), strict=False):
                pairs = np.column_stack([source.ticks[block.rows], np.asarray(ticks, np.int64)])
                what = f"controller {place(name)}" if name.startswith("controller_") else name
                parts.setdefault((role, place(sender(block.message)), what), []).append(pairs)
        for key, tables in parts.items():
            whole = np.concatenate(tables)
            found[key] = whole[np.argsort(whole[:, 0], kind="stable")]
    return found


def _rows(layout: Any, block: Block, source: Series, **fields: Any) -> NDArray[Any]:
    """Rows of a table, one for each message of a block."""
    table = np.zeros(len(block.rows), layout)
    table["tick"] = source.ticks[block.rows]
    for name, values in fields.items():
        table[name] = values
    return table


def _joined(parts: Sequence[NDArray[Any]], layout: Any) -> NDArray[Any]:
    return np.concatenate(parts) if parts else np.zeros(0, layout)


def _order(parts: Sequence[NDArray[Any]]) -> NDArray[np.int64]:
    """Number of the part that each row of the joined table is of."""
    return np.repeat(np.arange(len(parts)), [len(part) for part in parts])


def _same_length(*lists: Sequence[Any]) -> int:
    """Length of lists, which has to be one. Raises ValueError."""
    (length,) = {len(one) for one in lists}
    return length


def place(name: str) -> int:
    """Place in the run of a controller (`controller_0_LLC`), or of the one that another serves; 0 for other names."""
    number = re.fullmatch(r"(?:controller|identifier|supervisor)_(\d+)_.*", name)
    return int(number[1]) if number else 0


def _values(entry: Any, fields: Sequence[str]) -> NDArray[np.float64]:
    """Numbers of an entry side by side, (messages, fields)."""
    return np.column_stack([getattr(entry, name) for name in fields]).astype(np.float64)


def _index(names: Sequence[str]) -> dict[str, int]:
    return {name: position for position, name in enumerate(names)}


def _lookup(index: Mapping[str, int], name: str, topic: str) -> int:
    if name not in index:
        raise RecordingError(f"{topic}: unknown name {name!r}; the recording knows {', '.join(index) or 'none'}")
    return index[name]
