"""Execution of a fault campaign: simulate each draw and check its invariants; any draw can be repeated alone."""

from __future__ import annotations

import hashlib
import json
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from facts_damping.caching import shared
from facts_damping.case.loading import changed_case, read_run
from facts_damping.errors import FactsDampingError, InputError, check_known, one_line
from facts_damping.input_files import read_text
from facts_damping.output.writing import write_whole
from facts_damping.parameters.field_errors import check
from facts_damping.parameters.files import find, new_folder, read_sets, read_table
from facts_damping.parameters.yaml_text import dump
from facts_damping.simulation import loop
from facts_damping.version import __version__
from facts_damping_studies.campaigns import actions, invariants
from facts_damping_studies.campaigns.draw_rows import DrawnFault, DrawRow, Intervention, Law
from facts_damping_studies.campaigns.faults import FAULTS, NOTHING, ONLY_REAL, Chance
from facts_damping_studies.campaigns.parameters import Campaign
from facts_damping_studies.margins.unsupervised import unsupervised
from facts_damping_studies.sweeps.journal import Journal
from facts_damping_studies.sweeps.pool import workers

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from facts_damping.case.model import Case
    from facts_damping.output.terminal import Progress
    from facts_damping.record import Record
    from facts_damping_studies.campaigns.faults import Source
    from facts_damping_studies.campaigns.parameters import BaseRun

JOURNAL, COPY, FAILED = "rows.jsonl", "campaign.yaml", "failed"
GRAPH_AFTER_S = 3.0  # s, shortest time from a graph's fault to its end
# Fields of a run that matter without control; the seed does only through the noise of loads.
OF_PLANT = ("system", "scenario", "devices", "duration", "frame_rate", "load_noise")
UNCONTROLLED: dict[str, Any] = {"controllers": [], "supervision": None, "arm_at": None}

_uncontrolled: dict[str, Record] = {}


class CampaignPlan(NamedTuple):
    """A campaign after reading, with the contents of its runs."""

    name: str
    text: str  # as YAML
    campaign: Campaign
    contents: dict[str, tuple[dict[str, Any], str]]  # of the base runs: content of the run, and its origin
    set: dict[str, Any]  # in all runs
    fingerprint: str


class Choice(NamedTuple):
    """What is chosen of a case before the size of its fault."""

    base_run: str
    chosen: dict[str, str]  # label of each list; without one the base run is as it is
    fault: str
    start: float  # s
    duration: float | None  # s; None: to the end
    seed: int | None  # None: that of the base run


class Draw(NamedTuple):
    """A draw: its number, the run's content, origin and changes, the fault, and the random choices."""

    number: int
    base_run: str
    changes: dict[str, Any]
    fault: str
    start: float
    chosen: dict[str, str]


def plan(name: str, sets: Sequence[str] = (), draws: int | None = None, graphs: int | None = None) -> CampaignPlan:
    """Read a campaign by name or path, with `--set` applied to its runs. Raises `InputError`, also for base runs."""
    path = find("campaigns", name)
    campaign = check(Campaign, read_table(path), str(path))
    asked = {"draws": draws, "graphs": graphs}
    campaign = campaign.model_copy(update={name: count for name, count in asked.items() if count is not None})
    for fault in campaign.faults:
        check_known(f"{path}: faults", fault, list(FAULTS))
    contents = {base_run: read_run(base.run) for base_run, base in campaign.base_runs.items()}
    changed, _ = read_sets(sets)
    campaign = _without_lists(campaign, changed)
    rests_on = [campaign.model_dump(exclude={"draws", "graphs"}), contents, changed, __version__]
    digest = hashlib.sha256(json.dumps(rests_on, sort_keys=True, default=str).encode()).hexdigest()
    campaign_plan = CampaignPlan(path.stem, read_text(path), campaign, contents, changed, digest)
    try:
        for base_run in campaign.base_runs:
            _check(campaign_plan, base_run)
    except InputError as error:
        raise InputError(str(error) if str(path) in str(error) else f"{path}: {error}") from error
    return campaign_plan


def _without_lists(campaign: Campaign, changed: dict[str, Any]) -> Campaign:
    """The campaign without the lists whose fields are all set by `--set`, which wins."""

    def chosen(choices: dict[str, dict[str, Any]]) -> bool:
        paths = [path for fields in choices.values() for path in fields]
        return not paths or any(
            all(path != set_path and not path.startswith(f"{set_path}.") for set_path in changed) for path in paths
        )

    base_runs = {
        name: base.model_copy(
            update={"choose": {of: choices for of, choices in base.choose.items() if chosen(choices)}}
        )
        for name, base in campaign.base_runs.items()
    }
    return campaign.model_copy(update={"base_runs": base_runs})


def _check(campaign_plan: CampaignPlan, base_run: str) -> None:
    """Raise `InputError` if a base run is impossible with any single choice, with the first of all other lists."""
    lists = campaign_plan.campaign.base_runs[base_run].choose
    first = {name: next(iter(choices)) for name, choices in lists.items()}
    for labels in [first, *(first | {name: label} for name, choices in lists.items() for label in choices)]:
        changes = {**campaign_plan.set, **_chosen(campaign_plan.campaign.base_runs[base_run], labels)}
        if _case(campaign_plan, base_run, changes).supervision is None:
            raise InputError(f"base_runs.{base_run}: a run without supervision given; allowed: one with `supervision`")


def _case(campaign_plan: CampaignPlan, base_run: str, changes: dict[str, Any]) -> Case:
    content, source = campaign_plan.contents[base_run]
    return changed_case(content, source, {**campaign_plan.campaign.base_runs[base_run].set, **changes})


def _chosen(base_run: BaseRun, labels: dict[str, str]) -> dict[str, Any]:
    """Fields that labels set in a run, one label of each list."""
    return {
        path: value
        for name, choices in base_run.choose.items()
        if name in labels
        for path, value in choices[labels[name]].items()
    }


def weights(campaign: Campaign, *, real: bool = False) -> dict[str, float]:
    """Probability weight of each fault.

    For `real` graphs, faults applied to nodes are as likely as all others together; some apply to graphs only.
    """
    fault_weights = campaign.faults or {name: 1.0 for name in FAULTS if name != NOTHING}
    allowed_weights = {name: weight for name, weight in fault_weights.items() if real or name not in ONLY_REAL}
    if real:
        done = sum(weight for name, weight in allowed_weights.items() if FAULTS[name].real)
        others = sum(allowed_weights.values()) - done
        more = max(1.0, others / done) if done else 1.0
        allowed_weights = {
            name: weight * (more if FAULTS[name].real else 1.0) for name, weight in allowed_weights.items()
        }
    failing = sum(weight for name, weight in allowed_weights.items() if name != NOTHING)
    healthy = campaign.healthy / (1.0 - campaign.healthy) * failing if campaign.healthy < 1.0 else 1.0
    return (
        {NOTHING: healthy, **({} if campaign.healthy == 1.0 else allowed_weights)}
        if campaign.healthy
        else allowed_weights
    )


def draw(campaign_plan: CampaignPlan, number: int, *, real: bool = False) -> Draw:
    """A draw of a campaign by its number; always the same for the same number."""
    random = np.random.default_rng((campaign_plan.campaign.seed, number))
    return drawn(campaign_plan, number, choose(campaign_plan, random, real=real), random, real=real)


def choose(campaign_plan: CampaignPlan, random: Source, *, real: bool = False) -> Choice:
    """Choose base run, labels, fault, its time, and the seed."""
    campaign = campaign_plan.campaign
    base_run = list(campaign.base_runs)[int(random.integers(len(campaign.base_runs)))]
    lists = campaign.base_runs[base_run].choose
    chosen = {name: list(choices)[int(random.integers(len(choices)))] for name, choices in lists.items()}
    fault_weights = weights(campaign, real=real)
    fault = str(
        random.choice(list(fault_weights), p=np.array(list(fault_weights.values())) / sum(fault_weights.values()))
    )
    low, high = campaign.window
    high = max(low, min(high, campaign.graph_duration - GRAPH_AFTER_S)) if real else high
    start, lasts = round(random.uniform(low, high), 3), round(float(10 ** random.uniform(-1.0, 1.0)), 3)
    duration = None if random.random() < campaign.lasting else lasts
    return Choice(base_run, chosen, fault, start, duration, int(random.integers(2**31)))


def drawn(campaign_plan: CampaignPlan, number: int, choice: Choice, random: Source, *, real: bool = False) -> Draw:
    """The draw of a choice; `random` gives the sizes of its fault."""
    base_run, chosen, fault, start, duration, seed = choice
    changes = {**campaign_plan.set, **_chosen(campaign_plan.campaign.base_runs[base_run], chosen)}
    changes |= {} if seed is None else {"seed": seed}
    if real:
        changes["duration"] = campaign_plan.campaign.graph_duration
    case = _case(campaign_plan, base_run, changes)
    changes |= FAULTS[fault].draw(Chance(random, start, duration, case))
    lasts = {"lasts": "" if duration is None else f"{duration:g}"}
    return Draw(number, base_run, changes, fault, start, chosen | lasts)


def healthy(campaign_plan: CampaignPlan, sample: Draw) -> Draw:
    """A draw without its fault, which is applied to the nodes of a graph instead."""
    run_fields: dict[str, Any] = {name: sample.changes[name] for name in ("seed", "duration") if name in sample.changes}
    chosen = _chosen(campaign_plan.campaign.base_runs[sample.base_run], sample.chosen)
    return sample._replace(changes={**campaign_plan.set, **chosen, **run_fields})


def case_of(campaign_plan: CampaignPlan, sample: Draw, more: dict[str, Any] | None = None) -> Case:
    """The case of a draw, with optional further changes."""
    return _case(campaign_plan, sample.base_run, {**sample.changes, **(more or {})})


def run_file(campaign_plan: CampaignPlan, sample: Draw, what: str = "Draw") -> str:
    """A draw as a run file: everything inline. `what`: how the number is called."""
    document = case_of(campaign_plan, sample).document()
    fields = {name: value for name, value in document.items() if value is not None and name != "asked"}
    return (
        f"# {what} {sample.number} of the campaign {campaign_plan.name}: {sample.fault} at {sample.start:g} s.\n"
        + dump(fields)
    )


def one_draw(campaign_plan: CampaignPlan, number: int) -> tuple[str, DrawRow]:
    """Key and row of a draw; a failed draw has a row too, with the reason in `error`."""
    row = DrawRow(number, error=None)
    try:
        drawn = draw(campaign_plan, number)
        row = replace(row, drawn=identity(drawn))
        case = case_of(campaign_plan, drawn)
        row = replace(row, law=law_of(case), horizon_s=case.duration)
        reference = uncontrolled(campaign_plan, drawn)
        row = replace(row, judgement=judged(case, loop.run(case), reference, drawn))
        if campaign_plan.campaign.unsupervised:
            free = invariants.beside(loop.run(unsupervised(case)), reference)
            row = replace(row, unsupervised=free.controlled)
    except FactsDampingError as error:
        row = replace(row, error=one_line(error))
    except Exception as error:  # noqa: BLE001 (whatever a draw dies of, the others go on)
        row = replace(row, error=f"{type(error).__name__}: {one_line(error)}")
    return str(number), row


def identity(sample: Draw) -> DrawnFault:
    """What was drawn; the controller is known by its name (`law_of`)."""
    fault, labels = FAULTS[sample.fault], {name: label for name, label in sample.chosen.items() if name != "controller"}
    return DrawnFault(sample.base_run, sample.fault, fault.group, fault.wrong, sample.start, labels)


def law_of(case: Case) -> Law:
    """The first controller of a case."""
    return Law(case.controllers[0].name, case.controllers[0].scheme)


def judged(case: Case, record: Record, reference: Record, sample: Draw, late: int = 0) -> Intervention:
    """Actions of the supervisor, invariants, and figures relative to no control.

    `late`: largest number of ticks by which setpoints acted too late (`invariants.late_ticks`).
    """
    did, effect = actions.doings(record, sample.start), invariants.beside(record, reference)
    return Intervention(did, effect, bool(record.devices["released"].any()), invariants.alone(case, record, late))


def uncontrolled(campaign_plan: CampaignPlan, sample: Draw) -> Record:
    """The same run without control: only the plant and its events matter."""
    plain = {path: value for path, value in sample.changes.items() if path.partition(".")[0] in OF_PLANT}
    key = json.dumps([campaign_plan.fingerprint, sample.base_run, plain], default=str, sort_keys=True)
    content, source = campaign_plan.contents[sample.base_run]
    whole = {"link": "ideal", "measurement": "ideal", **UNCONTROLLED}
    usual = campaign_plan.campaign.base_runs[sample.base_run].set
    usual_fields = {path: value for path, value in usual.items() if path.partition(".")[0] not in whole}
    changes = {**usual_fields, **whole, **plain}
    return shared(_uncontrolled, key, lambda: loop.run(changed_case(content, source, changes)))


def run(
    campaign_plan: CampaignPlan, folder: Path, jobs: int, scheduler: str | None, progress: Progress
) -> list[DrawRow]:
    """The rows of all draws; only those missing in the folder are made.

    Draws that violate an invariant are written as run files. Raises `InputError` if the folder belongs to another
    campaign, `RunError` if the draws cannot continue.
    """
    campaign = campaign_plan.campaign
    with (
        workers(jobs, scheduler) as each,
        Journal(new_folder(folder) / JOURNAL, campaign_plan.fingerprint, DrawRow.read) as journal,
    ):
        write_whole(folder / COPY, campaign_plan.text)
        todo = [number for number in range(campaign.draws) if str(number) not in journal.rows]
        progress.resume(len(journal.rows))
        progress(campaign.draws - len(todo), campaign.draws)
        for done, (key, row) in enumerate(each(partial(one_draw, campaign_plan), todo), campaign.draws - len(todo) + 1):
            journal.append(key, row)
            progress(done, campaign.draws)
        rows = [journal.rows[str(number)] for number in range(campaign.draws)]
    for row in rows:
        if not row.holds:
            text = run_file(campaign_plan, draw(campaign_plan, row.number))
            write_whole(new_folder(folder / FAILED) / f"{row.number}.yaml", text)
    return rows
