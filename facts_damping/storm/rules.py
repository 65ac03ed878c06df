"""Rules that must hold in every storm: functions of what was seen of the graph, each of which returns its violations.

A rule needs the record alone where it can, so that it also judges recordings of graphs on DDS.
"""

from __future__ import annotations

import re
import traceback
from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from facts_damping.case.names import served, setpoint_topics
from facts_damping.control.table import kind_of
from facts_damping.digest import canonical
from facts_damping.errors import FactsDampingError, one_line
from facts_damping.monitor_table import TRIPPED
from facts_damping.nodes.attacker import SWING
from facts_damping.nodes.launching.graph import PLANT, RECORDER, REFUSED
from facts_damping.recording.events import FAILED, STOPPED
from facts_damping.simulation import changes, replay
from facts_damping.storm.events import KINDS
from facts_damping.storm.stage import MARK
from facts_damping.studies.campaigns import invariants

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from facts_damping.signals import Record
    from facts_damping.storm.running import Trace

QUEUE = 20_000  # messages; more in a queue of a node that responds means that it never takes them
SENDS = {"controller": "issued", "link": "applied"}  # table with the setpoints of a role
ENDS = "the run has ended: "
LEAVE = ("reset", "disarm", "start")  # after a trip; a supervisor that starts again knows of none, and is in shadow
# Kinds of events after which the end of a run must be in its recording.
HARMLESS_TO_THE_END = (
    *("service", "command", "parameter", "forged", "replayed", "malformed", "older", "clock", "late", "terminated"),
)
FLUSHED_S = 1.0  # wall time within which a recorder writes what it received to disk: twice its interval
KNOWN = 2  # tick from which all nodes know the publishers of their topics
ARRAYS = ("time_ns", "frames", "delivered", "issued", "applied", "devices", "supervised", "supervision", "estimates")


def nothing_foreign_acts(trace: Trace) -> list[str]:
    """No forged setpoint is passed on, applied or in force, no forged frame delivered, no forged end believed."""
    record, found = trace.record, list[str]()
    if record is None or _may_be_replaced(trace):
        return []
    forged = [trace.case.system.device(name).setpoint_max * MARK for name in trace.case.run.devices]
    for what in ("issued", "supervised", "applied"):
        rows = getattr(record, what)
        if len(rows) and np.isclose(np.abs(rows["value"]), np.array(forged)[rows["device"]], rtol=1e-14, atol=0).any():
            found.append(f"a forged setpoint is {what}")
    if forged and np.isclose(np.abs(record.devices["setpoint"]), forged, rtol=1e-14, atol=0).any():
        found.append("a forged setpoint is in force")
    if len(record.delivered) and np.all(np.abs(record.delivered["values"]) == SWING, axis=1).any():
        found.append("a forged frame is delivered")
    ends = {text for _, name, _, text in trace.logs if name == PLANT} | {STOPPED}
    told = {text.removeprefix(ENDS) for _, _, _, text in trace.logs if text.startswith(ENDS)}
    if trace.mode != "free":
        found += [f"nodes believe that the run has ended: {text}" for text in sorted(told - ends) if FAILED not in text]
    return found


def _may_be_replaced(trace: Trace, *, signed: bool = True) -> bool:
    """Whether a foreign node may take a node's place: without the key it may in an unsigned graph that is paced.

    docs/operate.md says so: it begins before the node, or when the node is gone. `signed`: whether signed graphs sign
    the messages that are asked about.
    """
    if trace.storm is None:
        return False
    kinds = {one.kind for one in trace.storm.events}
    if trace.mode == "lockstep" and not any(one.tick < 1 and one.kind.startswith("forged") for one in trace.timeline):
        return False
    foreign = any(KINDS[kind].group == "foreign" and kind != "second_plant" for kind in kinds)
    return "forged_with_key" in kinds or (foreign and not (signed and trace.storm.signed))


def device_is_released(trace: Trace) -> list[str]:
    """A device is at zero within time-out and ramp after the last setpoint that its watchdog accepted."""
    if trace.record is None or _plant_changed(trace.record) or _may_be_replaced(trace):
        return []
    late = 0 if trace.mode == "lockstep" else 3 + _pauses(trace.record)
    return [] if invariants.lets_go(trace.case, trace.record, late) else ["a device keeps its setpoint"]


def _plant_changed(record: Record) -> bool:
    """Whether an operator replaced the plant's state, so that what came before counts no longer."""
    return any(one.kind in ("reset", "rearm", "release") for one in record.changes)


def _pauses(record: Record) -> int:
    """Ticks by which setpoints may act late, as the plant was paused."""
    return len(record.ticks) if any(one.kind in ("pause", "step") for one in record.changes) else 0


def setpoints_are_limited(trace: Trace) -> list[str]:
    """Setpoints and references stay within the device's limit, authority and rate."""
    if trace.record is None or _plant_changed(trace.record) or _may_be_replaced(trace):
        return []
    return [] if invariants.limits(trace.case, trace.record) else ["a setpoint or a reference exceeds its limits"]


def trips_hold(trace: Trace) -> list[str]:
    """What was tripped stays tripped, and passes nothing but its ramp, until an operator resets or disarms it."""
    record, found = trace.record, []
    if record is None or trace.case.supervision is None or _may_be_replaced(trace):
        return []
    ramp = trace.case.supervision.arming.trip_ramp
    for c in np.unique(record.supervision["controller"]).tolist():
        asked = {(one.index, one.tick) for one in record.changes if one.role == "supervisor" and one.kind in LEAVE}
        rows = record.supervision[record.supervision["controller"] == c]
        passed = record.supervised[record.supervised["controller"] == c]
        left = np.flatnonzero((rows["state"][:-1] == TRIPPED) & (rows["state"][1:] != TRIPPED))
        for at in left.tolist():
            begin, end = int(rows["tick"][at]), int(rows["tick"][at + 1])
            if not any(index == c and begin < tick <= end for index, tick in asked):
                found.append(f"supervisor {c} leaves its trip at tick {end} although no one asked")
        found += _acts_after_trip(rows, passed, ramp, record.frame_rate, c)
    return found


def _acts_after_trip(rows: NDArray[np.void], passed: NDArray[np.void], ramp: float, rate: int, c: int) -> list[str]:
    tripped = rows["tick"][rows["state"] == TRIPPED]
    if not len(tripped):
        return []
    since = np.array([_since(tripped, tick) for tick in passed["tick"].tolist()])
    late = (since > ramp * rate + 2) & (passed["value"] != 0.0)
    ticks = passed["tick"][late]
    return [f"supervisor {c} passes a setpoint at tick {int(ticks[0])}, though tripped"] if late.any() else []


def _since(tripped: NDArray[np.int64], tick: int) -> int:
    """For how many ticks without a break it has been tripped at a tick; -1: it is not."""
    at = int(np.searchsorted(tripped, tick))
    if at == len(tripped) or tripped[at] != tick:
        return -1
    run = tripped[: at + 1]
    breaks = np.flatnonzero(np.diff(run) != 1)
    return tick - int(run[breaks[-1] + 1] if len(breaks) else run[0])


def time_goes_on(trace: Trace) -> list[str]:
    """No node waits for ever: the graph ends by itself, and its plant gives up before the program that runs it does."""
    if trace.overdue:
        return [f"the graph does not end: {trace.world_s:.0f} s"]
    events = trace.storm.events if trace.storm is not None else []
    given_up = "no progress within" in trace.reason and all(one.node != PLANT for one in events)
    return [f"the plant waits for ever: {trace.reason}"] if given_up else []


def ends_are_named(trace: Trace) -> list[str]:
    """Each node ends with status 0 or with one line that says why, without a traceback."""
    found = []
    for node in trace.nodes:
        lines = node.errors.strip().splitlines()
        if "Traceback" in node.errors:
            found.append(f"{node.name}: traceback: {lines[-1]}")
        elif node.status and node.status > 0 and len(lines) != 1:
            found.append(f"{node.name} ends with status {node.status} and {len(lines)} lines: {' | '.join(lines[:3])}")
        elif node.status == 1 and re.match(r"\w*(Error|Exception)\b", lines[0].split(": ", 1)[-1]):
            found.append(f"{node.name} ends by an error that is not its own: {lines[0]}")
        elif node.status is None or (node.status < 0 and not (node.killed or trace.overdue)):
            found.append(f"{node.name} ends with status {node.status}, though no one killed it")
    return found


def graph_survives(trace: Trace) -> list[str]:
    """What must not end a graph does not."""
    if trace.storm is None or not trace.reason:
        return []
    kinds = {one.kind for one in trace.storm.events}
    if trace.storm.signed and "clock" in kinds:  # docs/operate.md: the clocks of hosts must agree then
        return []
    if any(one.external for one in trace.case.controllers):  # a user's node may fail by a foreign message
        return []
    if all(trace.mode in KINDS[kind].harmless for kind in kinds) and _begins_undisturbed(trace):
        return [f"the graph ends early: {trace.reason}"]
    return []


def _begins_undisturbed(trace: Trace) -> bool:
    """Whether no foreign node was there before the nodes knew each other: it would count as another graph."""
    return all(one.tick >= KNOWN for one in trace.timeline if KINDS[one.kind].group == "foreign")


def restarted_nodes_are_disarmed(trace: Trace) -> list[str]:
    """A controller or link that was started again, with `join`, sends no setpoint until an operator arms it."""
    record, storm = trace.record, trace.storm
    if record is None or storm is None or _may_be_replaced(trace):
        return []
    killed_at = {f"/{one.node}": one.tick for one in reversed(trace.timeline) if one.kind == "restarted"}
    found = []
    for one in [one for one in record.changes if one.kind == "start" and one.role in SENDS]:
        if one.value != "disarmed":
            if one.tick > killed_at.get(one.node, 10**9):
                found.append(f"{one.node} starts again at tick {one.tick}, and is armed")
            continue
        later = [row.tick for row in record.changes if row.node == one.node and row.kind in ("arm", "start")]
        end = min([tick for tick in later if tick > one.tick], default=10**9)
        rows = getattr(record, SENDS[one.role])
        own = [one.index] if one.role == "controller" else served(trace.case, one.index)
        sent = np.isin(rows["controller"], own) & (rows["tick"] >= one.tick) & (rows["tick"] < end)
        found += [f"{one.node} sends setpoints, though disarmed since tick {one.tick}"] if sent.any() else []
    return found


def equals_in_process(trace: Trace) -> list[str]:
    """A lockstep graph that reaches its end records, bit for bit, the run in process with the same changes."""
    record, case = trace.record, trace.case
    if trace.mode != "lockstep" or record is None or trace.reason or record.notes:
        return []
    if any(kind_of(controller).own for controller in case.controllers):
        return []
    computed, last = changes.rerun(case, record.changes), int(record.ticks[-1])
    if trace.storm is not None and any(one.kind == "lost" for one in trace.storm.events):
        last -= 1  # nothing shows that the last message was lost
    differ = [name for name in ARRAYS if _until(record, name, last) != _until(computed, name, last)]
    return [f"the recording differs from the run in process: {', '.join(differ)}"] if differ else []


def _until(record: Record, name: str, last: int) -> bytes:
    """Bytes of a table up to a tick."""
    table = getattr(record, name)
    ticks = table["tick"] if table.dtype.names and "tick" in table.dtype.names else record.ticks
    return canonical(table[ticks <= last]).tobytes()


def refusals_are_counted(trace: Trace) -> list[str]:
    """Each node tells a cause of refusal once in its log, and counts up."""
    found = []
    told = Counter((name, text) for _, name, _, text in trace.logs if text.startswith("refused a message"))
    begun = Counter(node.name.rpartition("/")[2] for node in trace.nodes)
    for (name, text), count in told.items():
        if count > begun[name.rpartition(".")[2]] * (2 if trace.mode == "free" else 1):
            found.append(f"{name} says {count} times: {text}")
    for node in trace.nodes:
        counts: dict[tuple[str, ...], int] = {}
        for count, *how in REFUSED.findall(node.output):
            if int(count) < counts.get(tuple(how), 0) and trace.mode != "free":
                found.append(f"{node.name}: count of {tuple(how)} falls to {count}")
            counts[tuple(how)] = int(count)
    return found


def refusals_are_complete(trace: Trace) -> list[str]:
    """The recorder has counted each foreign message that it received, as far as nothing else was wrong."""
    storm, found = trace.storm, []
    if storm is None or trace.mode == "free" or trace.reason or storm.discovery or not _begins_undisturbed(trace):
        return []
    if any(KINDS[one.kind].group not in ("foreign", "operator") or one.kind == "second_plant" for one in storm.events):
        return []
    output = next(node.output for node in trace.nodes if node.name == RECORDER)
    newest = {how: int(count) for count, *rest in REFUSED.findall(output) if (how := tuple(rest))[2] == "/outsider"}
    signed = setpoint_topics(trace.case)
    for topic, sent in trace.sent.items():
        if _may_be_replaced(trace, signed=topic in signed or "pmu/" in topic):
            continue
        counted = sum(count for how, count in newest.items() if how[1].lstrip("/") == topic.lstrip("/"))
        if counted != sent:
            found.append(f"{counted} refusals counted on {topic}, {sent} messages sent")
    return found


def end_is_recorded(trace: Trace) -> list[str]:
    """Why the plant has ended is in the recording, if nothing kept it from there."""
    storm, record = trace.storm, trace.record
    if storm is None or record is None or trace.mode == "free":
        return []
    if any(one.kind not in HARMLESS_TO_THE_END or one.node == RECORDER for one in storm.events):
        return []
    cut = [note for note in record.notes if "cut off" in note]
    return [f"the plant ended, and the recording says: {cut[0]}"] if cut else []


def recording_keeps_what_was_flushed(trace: Trace) -> list[str]:
    """A recorder that is killed has kept what came before its last flush."""
    storm, record = trace.storm, trace.record
    if storm is None or trace.mode == "lockstep":
        return []
    kills = [one for one in trace.timeline if one.kind == "killed" and one.node == RECORDER]
    others = [one for one in storm.events if (one.kind, one.node) not in (("killed", RECORDER), ("clock", ""))]
    hurt = any(one.node in ("", RECORDER) and KINDS[one.kind].group != "foreign" for one in others)
    if len(kills) != 1 or hurt or _may_be_replaced(trace):
        return []
    at = kills[0].tick
    kept = at - int(FLUSHED_S * trace.case.run.frame_rate) - 1
    last = -1 if record is None else int(record.ticks[-1])
    return [f"the recording ends with tick {last}, but the recorder was killed at tick {at}"] if last < kept else []


def queues_are_bounded(trace: Trace) -> list[str]:
    """No queue of a node that works grows without bound."""
    return [f"{trace.longest_queue} messages in a queue"] if trace.longest_queue > QUEUE else []


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
    found = re.findall(r"(\d+) messages written", output)
    return int(found[-1]) if found else 0


def _disk_failed(trace: Trace) -> bool:
    return trace.storm is not None and any(one.kind == "disk" for one in trace.storm.events)


def replay_is_exact(trace: Trace) -> list[str]:
    """A replay of what was recorded gives the recorded setpoints, estimates and supervision."""
    record = trace.record
    own = [kind_of(one).own for one in trace.case.controllers]
    if record is None or not record.configuration or not own or any(own) or _may_be_replaced(trace):
        return []
    if record.ticks[0] > 0:  # what its controllers had learnt before is not known
        return []
    try:
        case = replay.case_of(record, "recording", None, [])
        fitted = replay.fitted(record, case)
        played = replay.play(case, fitted)
    except FactsDampingError as error:
        return [] if record.notes else [f"the recording cannot be replayed: {one_line(error)}"]
    first = replay.first_difference(fitted, played.issued)
    found = [] if first is None else [f"setpoints from {first}"]
    for what, tick in (
        ("estimates", replay.first_estimate(fitted, played.estimates)),
        ("learning", replay.first_learning(fitted, played.learning)),
        ("supervision", replay.first_supervised(fitted, played)),
    ):
        found += [f"{what} from tick {tick}"] if tick is not None else []
    return [f"the replay differs in {', '.join(found)}"] if found else []


RULES: dict[str, Callable[[Trace], list[str]]] = {
    one.__name__: one
    for one in (
        *(nothing_foreign_acts, device_is_released, setpoints_are_limited, trips_hold, time_goes_on, ends_are_named),
        *(graph_survives, equals_in_process, refusals_are_counted, queues_are_bounded, recording_is_readable),
        *(refusals_are_complete, end_is_recorded, recording_keeps_what_was_flushed, restarted_nodes_are_disarmed),
        replay_is_exact,
    )
}


def violations(trace: Trace) -> list[tuple[str, str]]:
    """Violations of a trace: rule, text."""
    return [(name, text) for name in RULES for text in _applied(name, trace)]


def _applied(name: str, trace: Trace) -> list[str]:
    """Violations of a rule; an error of the library in what it asks for is one."""
    try:
        return RULES[name](trace)
    except Exception as error:  # noqa: BLE001 (whatever it is, it should not be)
        at = traceback.extract_tb(error.__traceback__)[-1]
        return [f"{type(error).__name__}: {error} ({Path(at.filename).name}:{at.lineno})"]
