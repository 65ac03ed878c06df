"""Loads everything that a node needs; the fork server of `forked` imports this module before it forks."""

from __future__ import annotations

import atexit
import gc
import importlib
import os
import shutil
from contextlib import suppress

import rcl_interfaces.srv
from facts_damping_msgs.srv import Apply, Step
from rcl_interfaces.msg import ParameterEvent
from rclpy.type_support import check_for_type_support
from rosgraph_msgs.msg import Clock
from std_srvs.srv import Trigger

from facts_damping.case.loading import load_case
from facts_damping.errors import FactsDampingError
from facts_damping.extensions import given
from facts_damping.nodes import recorder
from facts_damping.nodes.base.warmup import load
from facts_damping.nodes.launching import forked
from facts_damping.nodes.launching.starting import STREAMS
from facts_damping.recording.schemas import schema_text, type_hash

for node in ("controller", "identifier", "plant_sim", "replay_source", "supervisor", "wan_link"):
    importlib.import_module(f"facts_damping.nodes.{node}")
if STREAMS in given("nodes"):  # of another package
    importlib.import_module(given("nodes")[STREAMS].value)

PARAMETER_SERVICES = (
    *("DescribeParameters", "GetParameters", "GetParameterTypes"),
    *("ListParameters", "SetParameters", "SetParametersAtomically"),
)
SERVICES = (*(getattr(rcl_interfaces.srv, name) for name in PARAMETER_SERVICES), Apply, Step, Trigger)


def load_all() -> None:
    """Load type support of messages and services, and the kernels from their cache, into this process."""
    case = load_case(None, ["controllers.0.name=HBsWC", "controllers.0.scheme=indirect"])
    messages = set(recorder.topics(case).values())
    for kind in (Clock, ParameterEvent, *SERVICES, *messages):
        check_for_type_support(kind)
    for name in map(recorder.message_type, messages):
        type_hash(name, schema_text(name))
    load()


with suppress(FactsDampingError):  # the command tells it
    load_all()

# This process ends last, even if its parent was killed and could not remove the folder.
if forked.FOLDER in os.environ:
    atexit.register(shutil.rmtree, os.environ[forked.FOLDER], ignore_errors=True)

# Keep all objects: garbage collection in a fork would touch, and so copy, their memory pages.
gc.collect()
gc.freeze()
