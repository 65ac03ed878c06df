"""Runs draws of a fault campaign as real graphs, with faults in real nodes, and compares them with runs in process.

`campaign` defines a draw, `fault_injection` injects its fault into a graph, and this module combines both.
"""

from __future__ import annotations

import shutil
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import replace
from threading import Event, Lock
from typing import TYPE_CHECKING

from facts_damping.errors import FactsDampingError, one_line
from facts_damping.interruption import clean_up_first
from facts_damping.output.writing import write_whole
from facts_damping.parameters.files import new_folder
from facts_damping.parameters.security import add_key
from facts_damping.simulation import loop
from facts_damping_studies.campaigns import campaign, fault_injection, faults
from facts_damping_studies.campaigns.draw_rows import DrawRow, GraphRun, GraphStart
from facts_damping_studies.campaigns.invariants import late_ticks
from facts_damping_studies.sweeps.journal import Journal

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from facts_damping.case.model import Case
    from facts_damping.output.terminal import Progress
    from facts_damping.record import Record
    from facts_damping_studies.campaigns.campaign import CampaignPlan, Draw
    from facts_damping_studies.campaigns.fault_injection import FaultedRun

JOURNAL, FOLDER = "graphs.jsonl", "graphs"
AT_ONCE = 2  # graphs at a time: each has five or more processes and may run in real time
KEYS = "keys.yaml"
_computing = Lock()  # runs in process share what they compile
SAME = ("time_ns", "delivered", "issued", "supervised", "supervision", "applied", "machines", "devices")


def graphs(plan: CampaignPlan, folder: Path, jobs: int, progress: Progress) -> list[DrawRow]:
    """Rows of the draws that run as graphs, the first ones of the campaign; only missing ones are run.

    Graphs that violate a condition are kept below `folder`, with their runs as files. Raises `InputError` if the folder
    belongs to another campaign, `RunError` if the graphs cannot continue.
    """
    clean_up_first()
    count, place, ended = plan.campaign.graphs, new_folder(folder), Event()
    with (
        Journal(place / JOURNAL, plan.fingerprint, DrawRow.read) as journal,
        ThreadPoolExecutor(min(jobs, AT_ONCE)) as each,
    ):
        todo = [number for number in range(count) if str(number) not in journal.rows]
        progress.resume(count - len(todo))
        progress(count - len(todo), max(1, count))
        under_way = [each.submit(one_graph, plan, place, number, lambda: not ended.is_set()) for number in todo]
        try:
            for done, future in enumerate(as_completed(under_way), count - len(todo) + 1):
                journal.append(*future.result())
                progress(done, count)
        finally:
            ended.set()
            each.shutdown(cancel_futures=True)
        rows = [journal.rows[str(number)] for number in range(count)]
    for row in rows:
        if not row.holds:
            text = campaign.run_file(plan, campaign.draw(plan, row.number, real=True))
            write_whole(new_folder(folder / campaign.FAILED) / f"graph-{row.number}.yaml", text)
    return rows


def one_graph(plan: CampaignPlan, folder: Path, number: int, wanted: Callable[[], bool]) -> tuple[str, DrawRow]:
    """Key and row of a draw run as a graph; if it fails, the row has the reason in `error`.

    Runs in a thread of its own: graphs run in processes and share the one that nodes are forked from.
    """
    row = DrawRow(number, graph=True, error=None)
    place = folder / FOLDER / str(number)
    shutil.rmtree(place, ignore_errors=True)  # left by an interrupted run
    try:
        draw = campaign.draw(plan, number, real=True)
        row = replace(row, drawn=campaign.identity(draw))
        row = _run(plan, draw, place, wanted, row)
    except FactsDampingError as error:
        row = replace(row, error=one_line(error))
    except Exception as error:  # noqa: BLE001 (whatever a graph dies of, the others go on)
        row = replace(row, error=f"{type(error).__name__}: {one_line(error)}")
    if row.holds:
        shutil.rmtree(place, ignore_errors=True)
    return str(number), row


def _run(plan: CampaignPlan, draw: Draw, folder: Path, wanted: Callable[[], bool], row: DrawRow) -> DrawRow:
    """Run a draw as a graph in its own domain, and also in process and without control; its row, more of `row`."""
    real, lasts = faults.FAULTS[draw.fault].real, draw.chosen["lasts"]
    fault = fault_injection.GraphFault(real, draw.start, float(lasts) if lasts else None)
    # An attacker's messages must change nothing: no bit in lockstep; in real time no more than timing does.
    paced = fault.kind in ("kill", "stop") or (fault.kind == "forge" and draw.number % 2 == 1)
    mode, more = fault_injection.REALTIME if paced else fault_injection.LOCKSTEP, {}
    if real.endswith("signed"):
        add_key(new_folder(folder) / KEYS)
        more = {"security": {"keys": str(folder / KEYS)}}
    case = campaign.case_of(plan, campaign.healthy(plan, draw) if real else draw, more)
    with _computing:
        computed = loop.run(case)  # also compiles the kernels that the nodes need
        reference = campaign.uncontrolled(plan, draw)
    with fault_injection.own_domain() as domain:
        faulted = fault_injection.run_with_fault(case, mode, folder, fault, domain, wanted)
    outcome, record = faulted.outcome, faulted.record
    late = late_ticks(record, outcome.deadline_misses)
    done = GraphRun(
        begun_s=faulted.begun_s,
        back_s=faulted.back_s,
        wall_s=outcome.wall_s,
        deadline_misses=outcome.deadline_misses,
        nodes_ended=outcome.fallen,
        forged=sum(faulted.forged.values()),
        refused=sum(outcome.messages_refused.values()),
        notes=record.notes,
        conditions={name: holds(case, faulted, computed, paced, fault.kind) for name, holds in CONDITIONS.items()},
    )
    judgement = campaign.judged(case, record, reference, draw, late)
    start = GraphStart(mode, real)
    return replace(row, law=campaign.law_of(case), graph_start=start, judgement=judgement, graph_run=done)


def recorded(case: Case, faulted: FaultedRun, _computed: Record, _paced: bool, kind: str) -> bool:
    """Whether all is recorded, to the end or to the loss of synchronism.

    A node that does not come back may lack ticks, as may those that it serves.
    """
    record, away = faulted.record, kind in ("kill", "stop") and faulted.back_s is None
    notes = [note for note in record.notes if not (away and "ticks are missing" in note)]
    whole = len(record.time_ns) == case.ticks or not record.in_synchronism[-1]
    return bool(whole) and not notes and faulted.outcome.messages_lost == 0


def as_computed(_case: Case, faulted: FaultedRun, computed: Record, paced: bool, _kind: str) -> bool | None:
    """Whether, in lockstep, the recording equals the run in process bit for bit."""
    if paced:
        return None
    pairs = ((getattr(faulted.record, name), getattr(computed, name)) for name in SAME)
    return all(a.shape == b.shape and a.tobytes() == b.tobytes() for a, b in pairs)


def nothing_forged_acts(_case: Case, faulted: FaultedRun, _computed: Record, _paced: bool, kind: str) -> bool | None:
    """Whether only setpoints from supervisors act, and every attacker's message was refused, also by the recorder."""
    if kind != "forge":
        return None
    record, refused = faulted.record, faulted.outcome.messages_refused
    keys = ("device", "issued_ns", "value")
    passed = set(zip(*(record.supervised[key].tolist() for key in keys), strict=True))
    acts = set(zip(*(record.applied[key].tolist() for key in keys), strict=True))
    counted = {topic.lstrip("/"): n for (node, _, topic, _), n in refused.items() if node == "recorder"}
    causes = {cause for _, cause, _, _ in refused}
    return acts <= passed and counted == faulted.forged and causes <= {"publisher"}


CONDITIONS: dict[str, Callable[[Case, FaultedRun, Record, bool, str], bool | None]] = {
    "recorded": recorded,
    "as_computed": as_computed,
    "nothing_forged_acts": nothing_forged_acts,
}  # by the names of OF_GRAPHS; None: not applicable
