"""Rules about recordings: what is in them, and that they can be computed again."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

from facts_damping.control.table import kind_of
from facts_damping.digest import canonical
from facts_damping.errors import FactsDampingError, one_line
from facts_damping.nodes.launching.starting import RECORDER
from facts_damping.simulation import changes
from facts_damping.simulation.replaying import replay
from facts_damping_testing.storm.events import KINDS
from facts_damping_testing.storm.rules.foreign import may_be_replaced

if TYPE_CHECKING:
    from facts_damping.record import Record
    from facts_damping_testing.storm.running import Trace


# Kinds of events after which the end of a run must be in its recording.
HARMLESS_TO_THE_END = (
    *("service", "command", "parameter", "forged", "replayed", "malformed", "older", "clock", "late", "terminated"),
)
FLUSHED_S = 1.0  # wall time within which a recorder writes what it received to disk: twice its interval
ARRAYS = ("time_ns", "frames", "delivered", "issued", "applied", "devices", "supervised", "supervision", "estimates")


def recording_is_readable(trace: Trace) -> list[str]:
    """The recording is readable once a tick was recorded and flushed."""
    if trace.storm is None or trace.record is not None:
        return []
    recorders = [node for node in trace.nodes if node.name == RECORDER]
    written = max((_written(node.output) for node in recorders), default=0)
    hurt = any(node.killed or node.status for node in recorders) or _disk_failed(trace)
    if hurt or written < 50 or "no tick" in trace.unreadable:
        return []
    return [f"the recording is unreadable: {trace.unreadable}"]


def _written(output: str) -> int:
    counts = re.findall(r"(\d+) messages written", output)
    return int(counts[-1]) if counts else 0


def _disk_failed(trace: Trace) -> bool:
    return any(event.kind == "disk" for event in trace.events)


def end_is_recorded(trace: Trace) -> list[str]:
    """Why the plant has ended is in the recording, if nothing kept it from there."""
    storm, record = trace.storm, trace.record
    if storm is None or record is None or trace.mode == "free":
        return []
    if any(event.kind not in HARMLESS_TO_THE_END or event.node == RECORDER for event in storm.events):
        return []
    cut = [note for note in record.notes if "cut off" in note]
    return [f"the plant ended, and the recording says: {cut[0]}"] if cut else []


def recording_keeps_what_was_flushed(trace: Trace) -> list[str]:
    """A recorder that is killed has kept what came before its last flush."""
    storm, record = trace.storm, trace.record
    if storm is None or trace.mode == "lockstep":
        return []
    kills = [done for done in trace.timeline if done.kind == "killed" and done.node == RECORDER]
    others = [event for event in storm.events if (event.kind, event.node) not in (("killed", RECORDER), ("clock", ""))]
    hurt = any(event.node in ("", RECORDER) and KINDS[event.kind].group != "foreign" for event in others)
    if len(kills) != 1 or hurt or may_be_replaced(trace):
        return []
    at = kills[0].tick
    last_flushed = at - int(FLUSHED_S * trace.case.run.frame_rate) - 1
    last = -1 if record is None else int(record.ticks[-1])
    return (
        [f"the recording ends with tick {last}, but the recorder was killed at tick {at}"]
        if last < last_flushed
        else []
    )


def equals_in_process(trace: Trace) -> list[str]:
    """A lockstep graph that reaches its end records, bit for bit, the run in process with the same changes."""
    record, case = trace.record, trace.case
    if trace.mode != "lockstep" or record is None or trace.reason or record.notes:
        return []
    if any(kind_of(controller).own for controller in case.controllers):
        return []
    computed, last = changes.rerun(case, record.changes), int(record.ticks[-1])
    if any(event.kind in ("lost", "late") for event in trace.events):
        last -= 1  # nothing shows that the last message was lost, or came after the end
    differ = [name for name in ARRAYS if _until(record, name, last) != _until(computed, name, last)]
    return [f"the recording differs from the run in process: {', '.join(differ)}"] if differ else []


def _until(record: Record, name: str, last: int) -> bytes:
    """Bytes of a table up to a tick."""
    table = getattr(record, name)
    ticks = table["tick"] if table.dtype.names and "tick" in table.dtype.names else record.ticks
    return canonical(table[ticks <= last]).tobytes()


def replay_is_exact(trace: Trace) -> list[str]:
    """A replay of what was recorded gives the recorded setpoints, estimates and supervision."""
    record = trace.record
    own_code = [kind_of(controller).own for controller in trace.case.controllers]
    if record is None or not record.configuration or not own_code or any(own_code) or may_be_replaced(trace):
        return []
    if record.ticks[0] > 0:  # what its controllers had learnt before is not known
        return []
    if trace.lost - {RECORDER}:  # docs/replay.md: what the recorder has and a node lost counts as late
        return []
    try:
        case = replay.case_of(record, "recording", None, [])
        fitted = replay.fitted(record, case)
        played = replay.play(case, fitted)
    except FactsDampingError as error:
        return [] if record.notes else [f"the recording cannot be replayed: {one_line(error)}"]
    first = replay.first_difference(fitted, played.issued)
    differing = [] if first is None else [f"setpoints from {first}"]
    for what, tick in (
        ("estimates", replay.first_estimate(fitted, played.estimates)),
        ("learning", replay.first_learning(fitted, played.learning)),
        ("supervision", replay.first_supervised(fitted, played)),
    ):
        differing += [f"{what} from tick {tick}"] if tick is not None else []
    return [f"the replay differs in {', '.join(differing)}"] if differing else []
