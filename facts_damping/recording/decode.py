"""From CDR messages to the arrays of `facts_damping.signals`."""

from __future__ import annotations

import re
from functools import lru_cache
from operator import itemgetter
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from rosbags.typesys import Stores, TypesysError, get_typestore

from facts_damping.errors import RecordingError
from facts_damping.recording.schemas import parse_schema
from facts_damping.signals import (
    CHANNELS,
    DELIVERY,
    DEVICE_TRUTH,
    ESTIMATE,
    LEARNING,
    MACHINE_TRUTH,
    NANOSECONDS,
    SETPOINT,
    TRUTH_UNITS,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping, Sequence

    from numpy.typing import NDArray
    from rosbags.typesys.store import Typestore

    from facts_damping.recording.bagfile import TopicInfo

# Fields of PmuFrame, MachineState and DeviceState in the order of the arrays' columns: a field of a
# message is the column's name and its unit.
_FRAME_FIELDS = [f"{name}_{unit}" for name, unit in CHANNELS.items()]
_UNITS = {name: "" if unit == "-" else f"_{unit}" for name, unit in TRUTH_UNITS.items()}
_MACHINE_FIELDS = [f"{name}{_UNITS.get(name, '_pu')}" for name in MACHINE_TRUTH.names or ()]
_DEVICE_FIELDS = [f"{name}{_UNITS.get(name, '_pu')}" for name in DEVICE_TRUTH.names or ()]


class Series(NamedTuple):
    """Messages of one topic in order of ticks: the topic's name, its ticks, the decoded messages."""

    topic: str
    ticks: NDArray[np.int64]
    messages: list[Any]


def decoder(topic: TopicInfo) -> Callable[[bytes], Any]:
    """Function that decodes a topic's messages by the schema stored with it.

    Raises RecordingError: here if the schema cannot be read, in the function if a message does not fit it.
    """
    store = _store(topic.message_type, topic.schema)

    def decode(data: bytes) -> Any:
        try:
            return store.deserialize_cdr(data, topic.message_type)
        except Exception as error:
            raise RecordingError(
                f"{topic.name}: a message is not a {topic.message_type} ({type(error).__name__})"
            ) from error

    return decode


@lru_cache(maxsize=64)
def _store(message_type: str, schema: str) -> Typestore:
    """Types of one schema; kept, because rosbags compiles code for every type of every store."""
    store = get_typestore(Stores.EMPTY)
    try:
        store.register(parse_schema(message_type, schema))
    except TypesysError as error:
        raise RecordingError(f"schema of {message_type}: {error}") from error
    return store


def series(topic: str, messages: Iterable[Any]) -> tuple[Series, int]:
    """Messages sorted by their tick, the first of each; and how many were there twice."""
    by_tick: dict[int, Any] = {}
    count = 0
    for message in messages:
        by_tick.setdefault(int(message.tick), message)
        count += 1
    ticks = sorted(by_tick)
    ordered = Series(topic, np.array(ticks, np.int64), [by_tick[tick] for tick in ticks])
    return ordered, count - len(ticks)


def select(source: Series, ticks: NDArray[np.int64]) -> Series:
    """Part of a series that belongs to the given ticks."""
    return _kept(source, np.isin(source.ticks, ticks))


def until(source: Series, last: int) -> Series:
    """Part of a series up to a tick."""
    return _kept(source, source.ticks <= last)


def _kept(source: Series, keep: NDArray[np.bool_]) -> Series:
    messages = [message for message, kept in zip(source.messages, keep, strict=True) if kept]
    return Series(source.topic, source.ticks[keep], messages)


def names_of(messages: Iterable[Any], entries: str, name: str) -> list[str]:
    """Names in the field `name` of the entries of messages, in order of appearance."""
    return list(dict.fromkeys(getattr(entry, name) for message in messages for entry in getattr(message, entries)))


def time_ns(time: Any) -> int:
    """A builtin_interfaces/Time in ns."""
    return int(time.sec) * NANOSECONDS + int(time.nanosec)


def frames(source: Series, stations: Sequence[str]) -> NDArray[np.float64]:
    """Measured frames, (ticks, stations, channels); NaN where a station did not report."""
    values = np.full((len(source.messages), len(stations), len(CHANNELS)), np.nan)
    index = _index(stations)
    for row, message in enumerate(source.messages):
        for entry in message.frames:
            values[row, index[entry.station]] = _values(entry, _FRAME_FIELDS)
    return values


def truth(source: Series, entries: str, name: str, names: Sequence[str]) -> NDArray[Any]:
    """Truth about machines or devices (`entries` of PlantState), (ticks, names); NaN where it is missing."""
    fields, layout = (_MACHINE_FIELDS, MACHINE_TRUTH) if entries == "machines" else (_DEVICE_FIELDS, DEVICE_TRUTH)
    values = np.full((len(source.messages), len(names), len(fields)), np.nan)
    index = _index(names)
    for row, message in enumerate(source.messages):
        for entry in getattr(message, entries):
            values[row, index[getattr(entry, name)]] = _values(entry, fields)
    return values.view(layout)[..., 0] if values.size else np.empty(values.shape[:2], layout)


def deliveries(sources: Sequence[Series], stations: Sequence[str]) -> NDArray[Any]:
    """Frames as the links delivered them, a row (DELIVERY) an entry, by tick, then by link.

    Raises RecordingError: unknown station.
    """
    index = _index(stations)
    rows = [
        (
            tick,
            _lookup(index, entry.station, source.topic),
            link,
            time_ns(entry.header.stamp),
            time_ns(entry.arrival),
            _values(entry, _FRAME_FIELDS),
        )
        for link, source in enumerate(sources)
        for tick, message in zip(source.ticks.tolist(), source.messages, strict=True)
        for entry in message.frames
    ]
    table = np.array(rows, DELIVERY)
    return table[np.argsort(table["tick"], kind="stable")]


def setpoints(sources: Sequence[Series], controllers: Sequence[str], devices: Sequence[str]) -> NDArray[Any]:
    """Setpoints of several topics, a row (SETPOINT) each, by tick, then by controller's topic.

    Raises RecordingError: unknown controller or device.
    """
    controller, device = _index(controllers), _index(devices)
    rows = [
        (
            tick,
            _lookup(controller, entry.controller, source.topic),
            _lookup(device, entry.device, source.topic),
            time_ns(entry.header.stamp),
            time_ns(entry.issued),
            time_ns(entry.effective),
            entry.value_pu,
        )
        for source in sources
        for tick, message in zip(source.ticks.tolist(), source.messages, strict=True)
        for entry in message.setpoints
    ]
    table = np.array(rows, SETPOINT)
    return table[np.argsort(table["tick"], kind="stable")]


def merged(applied: NDArray[Any]) -> NDArray[Any]:
    """Setpoints (SETPOINT) of several links as the plant takes them: by tick, then by the time they take effect."""
    return applied[np.lexsort((applied["effective_ns"], applied["tick"]))]


def estimates(sources: Sequence[Series], devices: Sequence[str]) -> NDArray[Any]:
    """What identifiers estimated, a row (ESTIMATE) a derivative, tick by tick in the order of the controllers."""
    index, rows = _index(devices), []
    for source in sources:
        for tick, message in zip(source.ticks, source.messages, strict=True):
            here = place(message.identifier)
            measured = time_ns(message.header.stamp)
            known = [_lookup(index, name, source.topic) for name in message.input_names]
            of_signals = zip(message.prediction, message.error, message.change, strict=True)
            for i, (prediction, error, change) in enumerate(of_signals):
                for j, device in enumerate(known):
                    jacobian = message.jacobian[i * len(known) + j]
                    rows.append((tick, here, i, device, measured, jacobian, prediction, error, message.ahead, change))
    return np.array(sorted(rows, key=itemgetter(0, 1)), ESTIMATE)


def learning(controllers: Sequence[Series], identifiers: Sequence[Series]) -> NDArray[Any]:
    """How networks learn, a row (LEARNING) a learning rate, tick by tick: controllers, then identifiers, in order."""
    rows = []
    for identifier, sources in enumerate((controllers, identifiers)):
        for source in sources:
            for tick, message in zip(source.ticks, source.messages, strict=True):
                here = place(message.identifier if identifier else message.controller)
                groups = len(message.parameter_groups)
                for k, rate in enumerate(message.learning_rates):
                    output, group = divmod(k, groups)
                    head = (tick, here, identifier, output, group)
                    rows.append((*head, rate, message.lyapunov, message.lyapunov_fall))
    return np.array(sorted(rows, key=itemgetter(0, 2, 1)), LEARNING)


def place(name: str) -> int:
    """Place in the run of a controller (`controller_0_LLC`), or of the one an identifier serves; 0 for other names."""
    number = re.fullmatch(r"(?:controller|identifier)_(\d+)_.*", name)
    return int(number[1]) if number else 0


def events(messages: Iterable[Any]) -> list[dict[str, Any]]:
    """Changes of the grid by time: `time_ns`, `kind`, `element`, `value`, `location` (NaN: not given)."""
    found = [
        {
            "time_ns": time_ns(message.header.stamp),
            "kind": message.kind,
            "element": message.element,
            "value": message.value,
            "location": message.location,
        }
        for message in messages
    ]
    return sorted(found, key=itemgetter("time_ns"))


def _values(entry: Any, fields: Sequence[str]) -> tuple[float, ...]:
    return tuple(getattr(entry, name) for name in fields)


def _index(names: Sequence[str]) -> dict[str, int]:
    return {name: position for position, name in enumerate(names)}


def _lookup(index: Mapping[str, int], name: str, topic: str) -> int:
    if name not in index:
        raise RecordingError(f"{topic}: unknown name {name!r}; the recording knows {', '.join(index) or 'none'}")
    return index[name]
