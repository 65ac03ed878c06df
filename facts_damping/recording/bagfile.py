"""The `metadata.yaml` of a recording's folder: format version 9, as ROS 2 Jazzy and later write it."""

from __future__ import annotations

import os
from functools import lru_cache
from typing import TYPE_CHECKING, Any, NamedTuple

import yaml

from facts_damping.parameters.yaml_text import UNREADABLE, PlainDumper, parse

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

VERSION = 9
SQLITE = ".db3"
SUFFIXES = (".mcap", SQLITE)  # of a recording's files
FILE_NAME = "metadata.yaml"
INFORMATION, CUSTOM, DIGEST = "rosbag2_bagfile_information", "custom_data", "digest"  # keys in metadata.yaml

_FOREVER = {"sec": 9223372036, "nsec": 854775807}

# QoS of every recorded topic: only the emulated link may lose data.
RELIABLE = {
    "history": "keep_all",
    "depth": 0,
    "reliability": "reliable",
    "durability": "volatile",
    "deadline": _FOREVER,
    "lifespan": _FOREVER,
    "liveliness": "automatic",
    "liveliness_lease_duration": _FOREVER,
    "avoid_ros_namespace_conventions": False,
}


class TopicInfo(NamedTuple):
    """A recorded topic: name, type ("package/msg/Type"), schema text, offered QoS (YAML), RIHS01 hash."""

    name: str
    message_type: str
    schema: str
    qos: str
    type_hash: str


def qos_text(profiles: Sequence[Mapping[str, Any]]) -> str:
    """YAML text of offered QoS profiles, as a channel's metadata holds it."""
    return dump([dict(profile) for profile in profiles]).strip()


def bag_information(
    file_name: str, counts: Mapping[TopicInfo, int], span: tuple[int, int], custom: Mapping[str, str]
) -> dict[str, Any]:
    """Content of `rosbag2_bagfile_information`.

    `counts`: messages per topic; `span`: log times of the first and last message, ns; `custom`: free text by key.
    The compression fields stay empty because chunks are compressed inside the MCAP file.
    """
    start, duration = {"nanoseconds_since_epoch": span[0]}, {"nanoseconds": span[1] - span[0]}
    total = sum(counts.values())
    return {
        "version": VERSION,
        "storage_identifier": "mcap",
        "duration": duration,
        "starting_time": start,
        "message_count": total,
        "topics_with_message_count": [_topic(topic, count) for topic, count in counts.items()],
        "compression_format": "",
        "compression_mode": "",
        "relative_file_paths": [file_name],
        "files": [{"path": file_name, "starting_time": start, "duration": duration, "message_count": total}],
        CUSTOM: dict(custom),
        "ros_distro": os.environ.get("ROS_DISTRO", "unknown"),
    }


@lru_cache(maxsize=64)
def _profiles(qos: str) -> Any:
    """QoS profiles from their text, which most topics share."""
    return parse(qos) or []


def _topic(topic: TopicInfo, count: int) -> dict[str, Any]:
    try:
        profiles = _profiles(topic.qos)
    except UNREADABLE:  # as another recorder wrote them
        profiles = []
    metadata = {
        "name": topic.name,
        "type": topic.message_type,
        "serialization_format": "cdr",
        "offered_qos_profiles": profiles,
        "type_description_hash": topic.type_hash,
    }
    return {"topic_metadata": metadata, "message_count": count}


def dump(content: Any) -> str:
    """YAML 1.1 text in block style, without anchors, which some bag readers do not know; keys keep their order."""
    return str(yaml.dump(content, Dumper=PlainDumper, sort_keys=False, default_flow_style=False))
