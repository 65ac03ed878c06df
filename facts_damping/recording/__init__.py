"""MCAP in and out, in the folder layout of rosbag2: no other part of the package reads or writes bags."""

from facts_damping.recording.reader import load
from facts_damping.recording.recover import recover
from facts_damping.recording.schemas import schema_text
from facts_damping.recording.writer import RecordingWriter

__all__ = ["RecordingWriter", "load", "recover", "schema_text"]
