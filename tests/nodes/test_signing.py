"""Signed frames and setpoints: the results are the same to the bit, and nothing else is taken."""

from __future__ import annotations

import hashlib
import hmac
import time
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from facts_damping_msgs import msg
from hypothesis import given, settings
from hypothesis import strategies as st
from rclpy.serialization import deserialize_message

from facts_damping.case.loading import load_case
from facts_damping.nodes.launching import graph
from facts_damping.nodes.transport.cdr import Refused
from facts_damping.nodes.transport.signing import Seal, Signing
from facts_damping.nodes.transport.tables import FramesMessage, SetpointsMessage
from facts_damping.parameters.security import add_key
from facts_damping.recording.reader import load
from facts_damping.signals import DELIVERY, SETPOINT
from facts_damping.simulation import loop
from tests.nodes.graphs import LOADED_S, assert_same, payloads, quiet

if TYPE_CHECKING:
    from pathlib import Path

CASE = load_case(None)
NOW = time.time_ns()
OLD, NEW = bytes(range(32)), bytes(range(32, 64))
BY = Signing({1: OLD}, NOW, 30 * 10**9)


def frames(by: Signing | None = BY, topic: str = "pmu/frames") -> FramesMessage:
    return FramesMessage(CASE, None if by is None else Seal(by, topic))


def message(by: Signing | None = BY, tick: int = 0) -> bytes:
    rows = np.zeros(2, DELIVERY)
    rows["pmu"] = [0, 1]
    rows["values"] = 0.25
    return frames(by).fill(tick, tick * 10**9 // 60, rows, 2)


def cause(reader: Any, data: bytes) -> str:
    with pytest.raises(Refused) as refused:
        reader.read(data)
    return refused.value.cause


def test_code_is_that_of_hmac_over_topic_key_session_and_message() -> None:
    data = message()
    read = deserialize_message(data, msg.PmuDataFrame)
    signature = bytes(read.signature)
    number, session, code = signature[:4], signature[4:12], signature[12:]
    assert (int.from_bytes(number, "little"), int.from_bytes(session, "little")) == (1, NOW)
    body = data[: data.index(signature)]
    code_again = hmac.new(OLD, b"pmu/frames\0" + number + session + body, hashlib.sha256)
    assert code == code_again.digest()
    assert data == body + signature


@settings(deadline=None, max_examples=100)
@given(data=st.data())
def test_signed_message_with_a_changed_bit_is_refused(data: st.DataObject) -> None:
    whole = message()
    at = data.draw(st.integers(0, 8 * len(whole) - 1))
    changed = bytearray(whole)
    changed[at // 8] ^= 1 << at % 8
    assert cause(frames(), bytes(changed)) in ("signature", "names", "format")


def test_message_not_signed_with_a_known_key_is_refused() -> None:
    assert cause(frames(), message(None)) == "signature"
    assert cause(frames(), message(Signing({1: NEW}, NOW, 0))) == "signature"
    assert cause(frames(), message(Signing({2: NEW}, NOW, 0))) == "signature"
    assert cause(frames(None), message()) == "signature"
    assert cause(frames(topic="pmu/delivered"), message()) == "signature"
    both = Signing({2: NEW, 1: OLD}, NOW, 0)
    for key in ({1: OLD}, {2: NEW}):
        assert frames(both).read(message(Signing(key, NOW, 0)))[0] == 0


def test_earlier_session_is_refused() -> None:
    early = Signing({1: OLD}, NOW - 91 * 10**9, 30 * 10**9)
    assert cause(frames(), message(early)) == "session"
    reader = frames()
    near = Signing({1: OLD}, NOW - 29 * 10**9, 30 * 10**9)
    assert reader.read(message(near))[0] == 0
    assert reader.read(message(near, 1))[0] == 1
    assert reader.read(message(BY, 2))[0] == 2  # a node that has joined in the place of the one before
    assert cause(reader, message(near, 3)) == "session"
    assert cause(frames(), message(Signing({1: OLD}, time.time_ns() + 31 * 10**9, 30 * 10**9))) == "session"


def test_joining_node_takes_the_session_under_way_and_no_earlier_one() -> None:
    hour = 3600
    began = Signing({1: OLD}, NOW - hour * 10**9, 30 * 10**9)
    assert frames().read(message(began, 60 * hour))[0] == 60 * hour
    assert cause(frames(), message(began, 60 * (hour - 91))) == "session"


def test_setpoints_are_signed_too() -> None:
    rows = np.zeros(1, SETPOINT)
    topic = "controller_0_LLC/setpoints"
    data = SetpointsMessage(CASE, seal=Seal(BY, topic)).fill(0, 0, rows, "controller_0_LLC")
    reader = SetpointsMessage(CASE, "controller_0_LLC", [0], Seal(BY, topic))
    assert reader.read(data)[1].tobytes() == rows.tobytes()
    empty = SetpointsMessage(CASE, seal=Seal(BY, topic)).fill(0, 0, rows[:0], "controller_0_LLC")
    assert len(SetpointsMessage(CASE, "controller_0_LLC", [0], Seal(BY, topic)).read(empty)[1]) == 0


def test_signed_graph_gives_the_bits_of_the_in_process_run(domain: int, tmp_path: Path) -> None:
    """Over a link of its own, in a namespace; over that of the graph: `test_fault_injection.py`."""
    keys = tmp_path / "keys.yaml"
    add_key(keys)
    add_key(keys)
    controllers = ["controllers.0.name=HBsWC", "controllers.0.scheme=indirect", "controllers.0.namespace=tie"]
    sets = ["duration=2", "link=delay_100ms", f"security.keys={keys}", *controllers, "controllers.0.link=fibre"]
    case = load_case(None, sets)
    outcome = graph.run(case, "lockstep", tmp_path / "out", quiet, LOADED_S)
    assert outcome.messages_refused == {}
    assert_same(load(outcome.recording), loop.run(case))
    messages = payloads(tmp_path / "out")
    for topic, kind in (("/pmu/frames", msg.PmuDataFrame), ("setpoints/delivered", msg.DeviceSetpoints)):
        name = next(topic_name for topic_name in messages if topic_name.endswith(topic))
        assert len(deserialize_message(messages[name][-1], kind).signature) == 44
