"""Messages written and read as bytes are what rclpy makes of them, bit for bit."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from facts_damping_msgs import msg
from hypothesis import given, settings
from hypothesis import strategies as st
from rclpy.serialization import deserialize_message, serialize_message

from facts_damping.case.loading import load_case
from facts_damping.compiling import store
from facts_damping.nodes.base.warmup import load
from facts_damping.nodes.transport import packing
from facts_damping.nodes.transport.cdr import Refused
from facts_damping.nodes.transport.messages import ControllerStateMessage, Estimate, Estimates, PlantStateMessage
from facts_damping.nodes.transport.tables import FramesMessage, SetpointsMessage
from facts_damping.signals import CHANNELS, DELIVERY, DEVICE_TRUTH, ESTIMATE, MACHINE_TRUTH, NANOSECONDS, SETPOINT
from facts_damping.simulation.assembly import build_control

if TYPE_CHECKING:
    from facts_damping.case.model import Case

TIMES = st.integers(0, 2**31 * NANOSECONDS - 1)
LATER = 2**31 * 60 - 1  # a tick whose start has room in a stamp, at 60 frames/s, and after all these times
PMUS = 6
FLOATS = st.floats(allow_nan=True, width=64)


@pytest.fixture(scope="module")
def case(tmp_path_factory: pytest.TempPathFactory) -> Case:
    """Two areas with two PMUs at one bus."""
    text = (Path(__file__).parents[2] / "config" / "systems" / "two_area.yaml").read_text(encoding="utf-8")
    system = tmp_path_factory.mktemp("system") / "two_area.yaml"
    system.write_text(re.sub("(  - {name: TIE.*\n)", r"\1  - {name: TIE_2, bus: B8W}\n", text), encoding="utf-8")
    loaded = load_case(None, [f"system={system}"])
    assert len(loaded.system.pmus) == PMUS
    return loaded


def start_ns(tick: int) -> int:
    return tick * NANOSECONDS // 60


def bits(values: Any) -> bytes:
    return np.asarray(values, np.float64).tobytes()


@st.composite
def deliveries(draw: st.DrawFn) -> Any:
    count = draw(st.integers(0, 12))
    rows = np.zeros(count, DELIVERY)
    for row in rows:
        row["pmu"] = draw(st.integers(0, PMUS - 1))
        row["measured_ns"], row["arrival_ns"] = draw(TIMES), draw(TIMES)
        row["status"] = draw(st.integers(0, 2**16 - 1))
        row["values"] = draw(st.lists(FLOATS, min_size=len(CHANNELS), max_size=len(CHANNELS)))
    return rows


@settings(deadline=None, max_examples=60)
@given(rows=deliveries(), tick=st.integers(0, 2**40), start=TIMES)
def test_frames_as_bytes_are_the_message(case: Case, rows: Any, tick: int, start: int) -> None:
    data = FramesMessage(case).fill(tick, start, rows, len(rows))
    message = deserialize_message(data, msg.PmuDataFrame)
    assert (message.tick, message.fresh) == (tick, len(rows) > 0)
    assert message.header.stamp.sec * NANOSECONDS + message.header.stamp.nanosec == start
    assert [e.pmu for e in message.frames] == [case.system.pmus[i].name for i in rows["pmu"]]
    for entry, row in zip(message.frames, rows, strict=True):
        assert entry.arrival.sec * NANOSECONDS + entry.arrival.nanosec == row["arrival_ns"]
        assert bits([getattr(entry, f"{name}_{unit}") for name, unit in CHANNELS.items()]) == bits(row["values"])
        assert entry.status == row["status"]


@settings(deadline=None, max_examples=60)
@given(rows=deliveries(), before=st.integers(0, 100))
def test_frames_are_read_back_also_from_rclpy(case: Case, rows: Any, before: int) -> None:
    latest = max(rows["measured_ns"].max(initial=0), rows["arrival_ns"].max(initial=0))
    tick = rows["tick"] = min(LATER, int(latest) * 60 // NANOSECONDS + 1 + before)
    writer, reader = FramesMessage(case), FramesMessage(case)
    data = writer.fill(tick, start_ns(tick), rows, len(rows))
    again = serialize_message(deserialize_message(data, msg.PmuDataFrame))
    for source in (data, again, data):
        seen_tick, seen = reader.read(source)
        assert seen_tick == tick
        assert seen.tobytes() == rows.tobytes()


def test_measured_tick_is_that_of_the_frame(case: Case) -> None:
    rate = case.run.frame_rate
    rows = np.zeros(1, DELIVERY)
    for tick in [0, 1, 2, 59, 60, 61, 12345]:
        rows["measured_ns"] = tick * NANOSECONDS // rate
        message = deserialize_message(FramesMessage(case).fill(tick + 7, 0, rows, 1), msg.PmuDataFrame)
        assert message.frames[0].tick == tick


def refusal(message: Any, data: bytes) -> str:
    with pytest.raises(Refused) as refused:
        message.read(data)
    return refused.value.cause


def test_message_with_unknown_names_is_refused(case: Case) -> None:
    rows = np.zeros(3, DELIVERY)
    rows["pmu"] = [0, 1, 2]
    rows["values"] = np.arange(3.0 * len(CHANNELS)).reshape(3, -1)
    frames, setpoints = FramesMessage(case), SetpointsMessage(case)
    message = deserialize_message(frames.fill(5, start_ns(5), rows, 3), msg.PmuDataFrame)
    message.frames[1].pmu = "ELSEWHERE"
    assert refusal(frames, serialize_message(message)) == "names"
    message.frames[1].pmu, message.frames[1].header.frame_id = "G2", "B1"
    assert refusal(frames, serialize_message(message)) == "names"
    setpoints_sent = np.zeros(1, SETPOINT)
    sent = setpoints.fill(5, start_ns(5), setpoints_sent, "controller_0_LLC")
    assert refusal(SetpointsMessage(case), sent) == "names"
    assert refusal(SetpointsMessage(case, "controller_0_LLC", []), sent) == "names"
    asked = deserialize_message(sent, msg.DeviceSetpoints)
    asked.setpoints[0].device = "statcom"
    assert refusal(SetpointsMessage(case, "controller_0_LLC"), serialize_message(asked)) == "names"


def test_stamp_that_is_not_of_the_tick_is_refused(case: Case) -> None:
    rows = np.zeros(1, DELIVERY)
    frames = FramesMessage(case)
    for tick, start in ((5, start_ns(4)), (2**64 - 1, 0), (10**9, start_ns(5))):
        assert refusal(frames, frames.fill(tick, start, rows, 1)) == "stamp"
    rows["measured_ns"], rows["arrival_ns"] = start_ns(100), start_ns(6)  # a PMU's clock may be wrong
    assert refusal(frames, frames.fill(5, start_ns(5), rows, 1)) == "stamp"
    rows["arrival_ns"] -= 1
    assert frames.read(frames.fill(5, start_ns(5), rows, 1))[0] == 5


@pytest.fixture(scope="module")
def wholes() -> list[tuple[Any, bytes]]:
    """What reads messages of each kind that a node reads, and a message."""
    case = load_case(None, ["controllers.0.name=HBsWC", "controllers.0.scheme=indirect"])
    rows, setpoints_sent, estimate = np.zeros(2, DELIVERY), np.zeros(1, SETPOINT), np.zeros(1, ESTIMATE)
    rows["pmu"] = [0, 1]
    frames, setpoints, estimates = FramesMessage(case), SetpointsMessage(case), Estimates(case, 0)
    identifier = build_control(case)[3]
    return [
        (frames, frames.fill(0, 0, rows, 2)),
        (setpoints, setpoints.fill(0, 0, setpoints_sent, "")),
        (estimates, estimates.fill(0, estimate, identifier, 0)),
    ]


@settings(deadline=None, max_examples=300)
@given(data=st.data())
def test_mutated_bytes_are_refused_or_of_the_same_names_and_lengths(
    wholes: list[tuple[Any, bytes]], data: st.DataObject
) -> None:
    for reader, whole in wholes:
        changed = bytearray(whole)
        for _ in range(data.draw(st.integers(1, 4))):
            changed[data.draw(st.integers(0, len(changed) - 1))] = data.draw(st.integers(0, 255))
        cut = bytes(changed)[: data.draw(st.integers(0, len(changed)))] + data.draw(st.binary(max_size=20))
        for mutated in (bytes(changed), cut):
            try:
                _, content = reader.read(mutated)
            except Refused:
                continue
            if isinstance(content, Estimate):
                assert (content.jacobian.shape, content.change.shape) == ((1, 1), (1,))
            else:
                known = {"pmu": [0, 1]} if isinstance(reader, FramesMessage) else {"controller": [0], "device": [0]}
                assert {name: content[name].tolist() for name in known} == known


@settings(deadline=None, max_examples=60)
@given(
    before=st.integers(0, 100),
    entries=st.lists(st.tuples(TIMES, TIMES, TIMES, FLOATS), max_size=4),
    controller=st.sampled_from(["", "controller_0_LLC"]),
)
def test_setpoints_as_bytes_are_the_message(
    case: Case, before: int, entries: list[tuple[int, int, int, float]], controller: str
) -> None:
    latest = max((max(entry[:3]) for entry in entries), default=0)
    tick = min(LATER, latest * 60 // NANOSECONDS + 1 + before)
    rows = np.array([(tick, 0, 0, *entry) for entry in entries], SETPOINT)
    data = SetpointsMessage(case).fill(tick, start_ns(tick), rows, controller)
    message = deserialize_message(data, msg.DeviceSetpoints)
    assert (message.tick, message.controller, message.fresh) == (tick, controller, len(rows) > 0)
    assert bits([entry.value_pu for entry in message.setpoints]) == bits(rows["value"])
    assert {entry.device for entry in message.setpoints} <= {"sssc"}
    for source in (data, serialize_message(message)):
        seen_tick, seen = SetpointsMessage(case, controller).read(source)
        assert seen_tick == tick
        assert seen.tobytes() == rows.tobytes()


@settings(deadline=None, max_examples=20)
@given(rows=deliveries(), cut=st.integers(1, 40))
def test_message_cut_short_is_not_taken_for_a_whole_one(case: Case, rows: Any, cut: int) -> None:
    frames = FramesMessage(case)
    data = frames.fill(7, 0, rows, len(rows))
    assert refusal(frames, data[: max(0, len(data) - cut)]) == "format"


def test_warm_up_loads_what_messages_use() -> None:
    load()
    for kernel in (packing.write, packing.read, packing.take):
        assert kernel.symbol in store._addresses


def test_truth_and_inner_state_are_the_messages(case: Case) -> None:
    rng = np.random.default_rng(1)
    machines, devices = np.zeros(4, MACHINE_TRUTH), np.zeros(1, DEVICE_TRUTH)
    machines.view(np.float64)[:] = rng.normal(size=24)
    for name in DEVICE_TRUTH.names or ():
        devices[name] = rng.normal() if name in ("dc_voltage", "current", "state") else 0.0
    devices["blocked"], devices["refused_order"] = 1.0, 12.0
    state = deserialize_message(PlantStateMessage(case).fill(7, 1_500_000_001, True, machines, devices), msg.PlantState)
    assert (state.tick, state.in_synchronism, state.header.stamp.nanosec) == (7, True, 500_000_001)
    assert [m.machine for m in state.machines] == ["G1", "G2", "G3", "G4"]
    assert [m.rotor_angle_rad for m in state.machines] == machines["rotor_angle"].tolist()
    assert [m.terminal_voltage_pu for m in state.machines] == machines["terminal_voltage"].tolist()
    device = state.devices[0]
    assert [device.dc_voltage_pu, device.state_pu] == [devices["dc_voltage"][0], devices["state"][0]]
    assert (state.devices[0].blocked, state.devices[0].released, state.devices[0].refused_order) == (True, False, 12)
    _, control, _, _ = build_control(case)
    control.held.signal[0], control.unlimited[0], control.outputs[0] = 0.25, 3.0, 0.1
    data = ControllerStateMessage(case, 0).fill(9, 0, True, control)
    inner = deserialize_message(data, msg.ControllerState)
    assert (inner.tick, inner.fresh, inner.input_names) == (9, True, ["speed"])
    assert (list(inner.inputs), list(inner.unlimited_outputs), list(inner.outputs)) == ([0.25], [3.0], [0.1])
    assert list(inner.saturated) == [True]
