"""Reads and writes MCAP in the folder layout of rosbag2. No other part of the package reads or writes bags."""

from facts_damping.recording.reader import load, origin
from facts_damping.recording.recover import in_simulated_time, recover, seal
from facts_damping.recording.schemas import schema_text
from facts_damping.recording.writer import RecordingWriter

__all__ = ["RecordingWriter", "in_simulated_time", "load", "origin", "recover", "schema_text", "seal"]
