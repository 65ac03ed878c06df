"""Tables of a record from series of messages."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from facts_damping import signals
from facts_damping.errors import RecordingError
from facts_damping.monitor_table import CODES, MONITORS, STATES, cause_code
from facts_damping.recording.decode import Series, place, time_ns
from facts_damping.recording.fields import DEVICE_FIELDS, FRAME_FIELDS, MACHINE_FIELDS
from facts_damping.signals import NEVER

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from numpy.typing import NDArray

    from facts_damping.recording.columns import Block


NewestTicks = dict[tuple[str, int, str], "NDArray[np.int64]"]


def frames(source: Series, pmus: Sequence[str]) -> tuple[NDArray[np.float64], NDArray[np.int64], NDArray[np.int64]]:
    """Frames (ticks, PMUs, channels), and their times of measurement and status, both (ticks, PMUs).

    NaN, NEVER and 0 where a PMU did not report.
    """
    values = np.full((len(source.ticks), len(pmus), len(signals.CHANNELS)), np.nan)
    measured_ns, status = np.full(values.shape[:2], NEVER), np.zeros(values.shape[:2], np.int64)
    index = _index(pmus)
    for block in source.blocks:
        for entry in block.message.frames:
            at = block.rows, index[entry.pmu]
            values[at], status[at] = _values(entry, FRAME_FIELDS), entry.status
            measured_ns[at] = time_ns(entry.header.stamp)
    return values, measured_ns, status


def truth(source: Series, entries: str, name: str, names: Sequence[str]) -> NDArray[Any]:
    """True states of machines or devices (`entries` of PlantState), (ticks, names); NaN where missing."""
    fields, layout = (
        (MACHINE_FIELDS, signals.MACHINE_TRUTH) if entries == "machines" else (DEVICE_FIELDS, signals.DEVICE_TRUTH)
    )
    values = np.full((len(source.ticks), len(names), len(fields)), np.nan)
    index = _index(names)
    for block in source.blocks:
        for entry in getattr(block.message, entries):
            values[block.rows, index[getattr(entry, name)]] = _values(entry, fields)
    return values.view(layout)[..., 0] if values.size else np.empty(values.shape[:2], layout)


def deliveries(sources: Sequence[Series], pmus: Sequence[str]) -> NDArray[Any]:
    """Frames as delivered by the links: one row (DELIVERY) per entry, sorted by tick, then link.

    Raises RecordingError for an unknown PMU.
    """
    index = _index(pmus)
    parts = [
        _rows(
            signals.DELIVERY,
            block,
            source,
            pmu=_lookup(index, entry.pmu, source.topic),
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
    return _table(parts, signals.DELIVERY, "link", "tick")


def setpoints(sources: Sequence[Series], controllers: Sequence[str], devices: Sequence[str]) -> NDArray[Any]:
    """Setpoints of several topics, one row (SETPOINT) each, sorted by tick, then by topic in the order given.

    Raises RecordingError for an unknown controller or device.
    """
    controller, device = _index(controllers), _index(devices)
    parts = [
        _rows(
            signals.SETPOINT,
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
    return _table(parts, signals.SETPOINT, "tick")


def supervision(sources: Sequence[Series], controllers: Sequence[str]) -> NDArray[Any]:
    """States of the supervisors: one row (SUPERVISION) per tick and supervisor, sorted by tick, then controller.

    Monitors that this version does not know are left out; monitors without a value are NaN. Raises RecordingError for
    an unknown controller.
    """
    controller, parts = _index(controllers), []
    for source in sources:
        for block in source.blocks:
            message = block.message
            values = np.full((len(block.rows), len(MONITORS)), np.nan)
            for name, column in zip(message.monitors, message.values, strict=False):
                if name in CODES:
                    values[:, CODES[name]] = column
            fields = {
                "controller": _lookup(controller, message.controller, source.topic),
                "state": _known(STATES.index, message.state, source.topic),
                "cause": _known(cause_code, message.cause, source.topic),
                "refused": _known(cause_code, message.refused, source.topic),
                "values": values,
            }
            numbers = {name: getattr(message, field) for name, field in signals.SUPERVISION_FIELDS.items()}
            parts.append(_rows(signals.SUPERVISION, block, source, **fields, **numbers))
    return _table(parts, signals.SUPERVISION, "controller", "tick")


def _known(code: Callable[[str], int], name: str, topic: str) -> int:
    """Code of a word. Raises RecordingError for a word that this version does not know."""
    try:
        return code(name)
    except (KeyError, ValueError) as error:
        raise RecordingError(f"{topic}: unknown word {name!r}") from error


def merged(applied: NDArray[Any]) -> NDArray[Any]:
    """Setpoints (SETPOINT) of several links in the order that the plant takes them: by tick, then effective time."""
    return applied[np.lexsort((applied["effective_ns"], applied["tick"]))]


def estimates(sources: Sequence[Series], devices: Sequence[str]) -> NDArray[Any]:
    """Estimates of the identifiers: one row (ESTIMATE) per derivative, sorted by tick, then controller."""
    index = _index(devices)
    parts = [
        _rows(
            signals.ESTIMATE,
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
        for i in range(len(message.prediction))
        for j, name in enumerate(message.input_names)
    ]
    return _table(parts, signals.ESTIMATE, "controller", "tick")


def learning(controllers: Sequence[Series], identifiers: Sequence[Series]) -> NDArray[Any]:
    """Learning of the networks: one row (LEARNING) per learning rate, by tick; controllers before identifiers."""
    parts = [
        _rows(
            signals.LEARNING,
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
    return _table(parts, signals.LEARNING, "controller", "identifier", "tick")


def latest(role: str, sources: Sequence[Series], sender: Callable[[Any], str]) -> NewestTicks:
    """Newest input ticks of each node when it acted (`record.Record.latest`); empty if its messages lack them."""
    newest: NewestTicks = {}
    for source in sources:
        parts: dict[tuple[str, int, str], list[NDArray[np.int64]]] = {}
        for block in source.blocks:
            names = getattr(block.message, "latest", [])
            for name, ticks in zip(names, getattr(block.message, "latest_ticks", []), strict=False):
                pairs = np.column_stack([source.ticks[block.rows], np.asarray(ticks, np.int64)])
                what = f"controller {place(name)}" if name.startswith("controller_") else name
                parts.setdefault((role, place(sender(block.message)), what), []).append(pairs)
        for key, tables in parts.items():
            whole = np.concatenate(tables)
            newest[key] = whole[np.argsort(whole[:, 0], kind="stable")]
    return newest


def _rows(layout: Any, block: Block, source: Series, **fields: Any) -> NDArray[Any]:
    table = np.zeros(len(block.rows), layout)
    table["tick"] = source.ticks[block.rows]
    for name, values in fields.items():
        table[name] = values
    return table


def _table(parts: Sequence[NDArray[Any]], layout: Any, *keys: str) -> NDArray[Any]:
    """Rows of all parts, sorted by the keys, the last one first; rows of equal keys stay in the order of the parts."""
    table = np.concatenate(parts) if parts else np.zeros(0, layout)
    return table[np.lexsort([table[key] for key in keys])]


def _values(entry: Any, fields: Sequence[str]) -> NDArray[np.float64]:
    """Fields of an entry as columns, (messages, fields)."""
    return np.column_stack([getattr(entry, name) for name in fields]).astype(np.float64)


def _index(names: Sequence[str]) -> dict[str, int]:
    return {name: position for position, name in enumerate(names)}


def _lookup(index: Mapping[str, int], name: str, topic: str) -> int:
    if name not in index:
        raise RecordingError(f"{topic}: unknown name {name!r}; the recording knows {', '.join(index) or 'none'}")
    return index[name]
