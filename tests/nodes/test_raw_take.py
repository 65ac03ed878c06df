"""Messages with the identity of their publisher, by rclpy and by rcl."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Any

import pytest
from facts_damping_msgs.msg import GridEvent

from facts_damping.nodes.base import qos, run
from facts_damping.nodes.transport import raw_take
from tests.nodes.graphs import somebody, wait_until

if TYPE_CHECKING:
    from collections.abc import Callable


@pytest.mark.parametrize("take", [raw_take.take, raw_take._Rcl().take], ids=["default", "rcl"])
def test_message_comes_with_its_publisher_and_sequence(domain: int, take: Callable[[Any], Any]) -> None:
    with somebody("both") as (node, _):
        subscription = node.create_subscription(GridEvent, "events", print, qos.SUBSCRIBER_QOS, raw=True)
        publisher = node.create_publisher(GridEvent, "events", qos.PUBLISHER_QOS)
        assert take(subscription) is None
        wait_until(lambda: publisher.get_subscription_count() > 0)
        begun = time.time_ns()
        sent = [b"\x00\x01\x00\x00" + bytes([i]) * length for i, length in enumerate((12, 5000, 4))]
        for data in sent:
            publisher.publish(data)
        messages: list[Any] = []

        def received() -> bool:
            messages.extend(message for message in [take(subscription)] if message is not None)
            return len(messages) == len(sent)

        wait_until(received)
        assert [data for data, _ in messages] == sent
        informations = [information for _, information in messages]
        (there,) = node.get_publishers_info_by_topic("events")
        assert {bytes(information["publisher_gid"]["data"]) for information in informations} == {
            bytes(there.endpoint_gid)
        }
        assert [information["publication_sequence_number"] for information in informations] == [1, 2, 3]
        assert all(begun <= information["source_timestamp"] <= time.time_ns() for information in informations)


@pytest.mark.parametrize("this_host", [False, True])
def test_profiles_of_both_versions_of_fast_dds_are_the_same(monkeypatch: pytest.MonkeyPatch, this_host: bool) -> None:
    assert run.profile(this_host) is not None
    texts = {}
    for name, major in run.FAST_DDS.items():
        monkeypatch.setattr(run, "version", {f"ros-{name}": f"{major}0"}.get)
        monkeypatch.setattr(run, "FAST_DDS", {name: major})
        ours = run.profile.__wrapped__(this_host)
        assert ours is not None
        texts[ours[0]] = ours[1].read_text().partition("-->")[2]
    assert list(texts) == ["FASTDDS_DEFAULT_PROFILES_FILE", "FASTRTPS_DEFAULT_PROFILES_FILE"]
    new, old = texts.values()
    assert old == new.replace("heartbeat_period", "heartbeatPeriod") != new
