"""Records of random content, and the messages that a graph would have published for them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
import yaml
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from facts_damping.case.loading import read_system
from facts_damping.parameters.recorded_run import recorded_run
from facts_damping.record import GridEvent, Record
from facts_damping.recording import RecordingWriter, schema_text
from facts_damping.signals import CHANNELS, DELIVERY, DEVICE_TRUTH, MACHINE_TRUTH, NANOSECONDS, SETPOINT

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

PACKAGE = "facts_damping_msgs/msg/"
RATE = 60
PMUS, MACHINES, DEVICES, CONTROLLERS = (
    ["G1", "G2", "TIE"],
    ["G1", "G2"],
    ["sssc", "statcom"],
    ["controller_2_A", "controller_10_B"],
)
TOPICS = {
    "/pmu/frames": "PmuDataFrame",
    "/pmu/delivered": "PmuDataFrame",
    "/setpoints/delivered": "DeviceSetpoints",
    "/plant/state": "PlantState",
    "/plant/events": "GridEvent",
}


def topics(record: Record) -> dict[str, str]:
    """Topics of a run with one link, and their types."""
    types_by_topic = {f"/{name}/setpoints": "DeviceSetpoints" for name in reversed(record.controller_names)}
    types_by_topic |= {identifier(c): "JacobianEstimate" for c in set(record.estimates["controller"].tolist())}
    return TOPICS | types_by_topic


def identifier(controller: int) -> str:
    return f"/identifier_{controller}_X/estimate"


_TWO_AREA = read_system("two_area").model_dump(by_alias=True)
_BARE = ("exciters", "governors", "stabilisers", "signals", "measures")  # of all machines: left out
_SYSTEM = {name: value for name, value in _TWO_AREA.items() if name not in _BARE} | {
    "machines": [machine for machine in _TWO_AREA["machines"] if machine["name"] in MACHINES],
    "pmus": [{**_TWO_AREA["pmus"][0], "name": name} for name in PMUS],
}
CONFIGURATION = recorded_run(
    {
        "system": _SYSTEM,
        "controllers": [{"name": name, "devices": DEVICES} for name in "AB"],
        "frame_rate": RATE,
        "duration": 20,
    },
    "test",
)


def make_record(seed: int, ticks: int = 30) -> Record:
    """A record full of random bit patterns, NaN among them, with rows in the order a run makes them."""
    random = np.random.default_rng(seed)

    def floats(*shape: int) -> Any:
        bits = random.integers(0, 2**64, shape, dtype=np.uint64)
        values = bits.view(np.float64)
        values[np.isnan(values) | (random.random(shape) < 0.1)] = np.nan
        return values

    def table(layout: Any, length: int, highs: dict[str, int], content: str) -> Any:
        rows = np.zeros(length, layout)
        for name, high in highs.items():
            rows[name] = random.integers(0, high, length)
        rows["tick"].sort()
        for name in layout.names:
            if name.endswith("_ns"):
                rows[name] = random.integers(0, 10**12, length)
        rows[content] = floats(*rows[content].shape)
        return rows

    machines, devices = (
        floats(ticks, 2, len(layout.names or ())).view(layout)[..., 0] for layout in (MACHINE_TRUTH, DEVICE_TRUTH)
    )
    for name in ("blocked", "released"):
        devices[name] = random.random((ticks, 2)) < 0.5
    for name in COUNTS:
        devices[name] = random.integers(0, 1000, (ticks, 2))
    setpoint = {"tick": ticks, "controller": 2, "device": 2}
    issued = table(SETPOINT, 50, setpoint, "value")
    return Record(
        configuration=CONFIGURATION,
        pmus=PMUS,
        machine_names=MACHINES,
        device_names=DEVICES,
        controller_names=CONTROLLERS,
        time_ns=np.arange(ticks) * NANOSECONDS // RATE,
        frames=floats(ticks, 3, len(CHANNELS)),
        measured_ns=random.integers(0, 10**12, (ticks, 3)),
        status=random.integers(0, 2**16, (ticks, 3)),
        delivered=table(DELIVERY, 70, {"tick": ticks, "pmu": 3, "status": 2**16}, "values"),
        issued=issued[np.lexsort((issued["controller"], issued["tick"]))],
        applied=table(SETPOINT, 40, setpoint, "value"),
        machines=machines,
        devices=devices,
        in_synchronism=np.ones(ticks, np.bool_),
        events=[GridEvent(10**8, "load_step", "load_1", -0.1, 0.5)],
        versions={"facts_damping": "1"},
    )


UNSIGNED = np.zeros(0, np.uint8)


class Messages:
    """Makes CDR messages out of a record's rows."""

    def __init__(self) -> None:
        self.store = get_typestore(Stores.EMPTY)
        for name in {*TOPICS.values(), "JacobianEstimate"}:
            self.store.register(get_types_from_msg(schema_text(PACKAGE + name), PACKAGE + name))

    def make(self, name: str, **fields: Any) -> Any:
        return self.store.types[name if "/" in name else PACKAGE + name](**fields)

    def time(self, ns: int) -> Any:
        sec, nanosec = divmod(int(ns), NANOSECONDS)
        return self.make("builtin_interfaces/msg/Time", sec=sec, nanosec=nanosec)

    def header(self, ns: int) -> Any:
        return self.make("std_msgs/msg/Header", stamp=self.time(ns), frame_id="")

    def frame(self, pmu: str, tick: int, measured: int, arrival: int, values: Any, status: int) -> Any:
        units = dict(zip([f"{name}_{unit}" for name, unit in CHANNELS.items()], map(float, values), strict=True))
        head = {"header": self.header(measured), "pmu": pmu, "tick": tick}
        return self.make("PmuFrame", **head, arrival=self.time(arrival), **units, status=int(status))

    def frames(self, stamp: int, tick: int, entries: list[Any]) -> Any:
        head = {"header": self.header(stamp), "tick": tick, "fresh": bool(entries)}
        return self.make("PmuDataFrame", **head, frames=entries, signature=UNSIGNED)

    def setpoints(self, record: Record, stamp: int, tick: int, controller: str, rows: Any) -> Any:
        entries = [
            self.make(
                "DeviceSetpoint",
                header=self.header(row["measured_ns"]),
                device=record.device_names[row["device"]],
                controller=record.controller_names[row["controller"]],
                issued=self.time(row["issued_ns"]),
                effective=self.time(row["effective_ns"]),
                value_pu=float(row["value"]),
            )
            for row in rows
        ]
        head = {"header": self.header(stamp), "tick": tick, "controller": controller, "fresh": bool(entries)}
        return self.make("DeviceSetpoints", **head, setpoints=entries, signature=UNSIGNED)

    def estimate(self, record: Record, tick: int, controller: int) -> Any:
        rows = record.estimates[(record.estimates["tick"] == tick) & (record.estimates["controller"] == controller)]
        devices = list(dict.fromkeys(rows["device"].tolist()))
        row = rows[:: len(devices)]
        return self.make(
            "JacobianEstimate",
            header=self.header(rows["measured_ns"][0]),
            tick=tick,
            identifier=identifier(controller).split("/")[1],
            latest=["setpoints"],
            latest_ticks=np.array([tick - 1]),
            output_names=[str(signal) for signal in row["signal"]],
            input_names=[record.device_names[device] for device in devices],
            jacobian=rows["jacobian"].copy(),
            prediction=row["prediction"].copy(),
            error=row["error"].copy(),
            ahead=float(row["ahead"][0]),
            change=row["change"].copy(),
            lyapunov=0.0,
            lyapunov_fall=0.0,
            parameter_groups=[],
            learning_rates=np.zeros(0),
        )

    def state(self, record: Record, tick: int) -> Any:
        machines = [
            self.make("MachineState", machine=name, **_fields(record.machines[tick, index], {"rotor_angle": "_rad"}))
            for index, name in enumerate(record.machine_names)
        ]
        devices = [
            self.make("DeviceState", device=name, **_fields(record.devices[tick, index], dict.fromkeys(PLAIN, "")))
            for index, name in enumerate(record.device_names)
        ]
        flag = bool(record.in_synchronism[tick])
        head = {"header": self.header(record.time_ns[tick]), "tick": tick, "in_synchronism": flag}
        return self.make("PlantState", **head, machines=machines, devices=devices)

    def event(self, event: GridEvent) -> Any:
        numbers = {"value": event.value, "location": event.location}
        head = self.header(event.time_ns)
        return self.make("GridEvent", header=head, kind=event.kind, element=event.element, **numbers)

    def tick(self, record: Record, tick: int) -> dict[str, Any]:
        """All messages of one tick, by topic."""
        stamp = int(record.time_ns[tick])
        delivered = record.delivered[record.delivered["tick"] == tick]
        issued, applied = (rows[rows["tick"] == tick] for rows in (record.issued, record.applied))
        names = record.pmus
        measured = [
            self.frame(name, tick, record.measured_ns[tick, i], stamp, record.frames[tick, i], record.status[tick, i])
            for i, name in enumerate(names)
        ]
        arrived = [
            self.frame(names[row["pmu"]], tick, *row[["measured_ns", "arrival_ns", "values", "status"]])
            for row in delivered
        ]
        return {
            "/pmu/frames": self.frames(stamp, tick, measured),
            "/plant/state": self.state(record, tick),
            "/pmu/delivered": self.frames(stamp, tick, arrived),
            **{
                f"/{name}/setpoints": self.setpoints(record, stamp, tick, name, issued[issued["controller"] == index])
                for index, name in reversed(list(enumerate(record.controller_names)))
            },
            "/setpoints/delivered": self.setpoints(record, stamp, tick, "", applied),
            **{identifier(c): self.estimate(record, tick, c) for c in set(record.estimates["controller"].tolist())},
        }

    def cdr(self, message: Any) -> bytes:
        return bytes(self.store.serialize_cdr(message, message.__msgtype__))


COUNTS = ("refused_value", "refused_stamp", "refused_order")
PLAIN: dict[str, Any] = {"blocked": bool, "released": bool, **dict.fromkeys(COUNTS, int)}  # fields without unit


def _fields(row: Any, units: dict[str, str]) -> dict[str, Any]:
    return {name + units.get(name, "_pu"): PLAIN.get(name, float)(row[name]) for name in row.dtype.names}


@pytest.fixture(scope="session")
def messages() -> Messages:
    return Messages()


@pytest.fixture
def random_record() -> Callable[..., Record]:
    return make_record


@pytest.fixture(scope="session")
def written(messages: Messages) -> Callable[..., None]:
    """Writes a record's messages; `skip(topic, tick)` leaves some out; a flush every `chunk` ticks.

    `change(topic, message)` gives other messages; `more` are topics of other types, with a message each tick.
    """

    def write(
        record: Record,
        folder: Path,
        skip: Callable[[str, int], bool] = lambda _topic, _tick: False,
        chunk: int = 5,
        lost: dict[str, int] | None = None,
        change: Callable[[str, Any], Any] = lambda _topic, message: message,
        configuration: str | None = None,
        more: dict[str, str] | None = None,
    ) -> None:
        text = yaml.safe_dump(record.configuration) if configuration is None else configuration
        with RecordingWriter(folder, text, {"facts_damping": "1"}) as writer:
            for topic, name in topics(record).items():
                writer.add_topic(topic, PACKAGE + name)
            for topic, name in (more or {}).items():
                writer.add_topic(topic, name)
            for event in record.events:
                writer.write("/plant/events", messages.cdr(messages.event(event)), 1000, 1000)
            for tick in range(len(record.time_ns)):
                ns = 1000 + int(record.time_ns[tick])
                for topic, message in messages.tick(record, tick).items():
                    if not skip(topic, tick):
                        writer.write(topic, messages.cdr(change(topic, message)), ns + 10, ns, tick)
                for topic in more or {}:
                    writer.write(topic, bytes([0, 1, 0, 0, 2, 0, 0, 0, 97, 0]), ns, ns, tick)
                if tick % chunk == chunk - 1:
                    writer.flush()
            writer.close(lost)

    return write


@pytest.fixture
def write_record(written: Callable[..., None]) -> Callable[..., None]:
    return written
