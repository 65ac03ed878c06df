"""Score of a controller on draws of a training ensemble, relative to a reference on the same draws.

    score = max_i mean_d log(I_id / I_id of the reference)      i: ITAE, IAE, ITSE, ISE (4.108); d: draws, or the worst
            + UNDAMPED (fraction of draws whose oscillation grows, or is a limit cycle)
            + PRICE max(0, mean_d(effort - effort of the reference)),  effort = mean |u| / u_max

The reference is LLC-tuned, or no control. A score of 0 equals the reference; below 0 all four indices are better, as
geometric means over the draws. If only a fraction of the draws counts, the first mean is over the worst draws of each
index (conditional value at risk, Rockafellar and Uryasev 2000), so that large gains in a few draws do not compensate
losses in others. With medians, the first term is the largest median of any index in any group of draws; the draws of
a group have equal values on all axes of the study that are not random. A run that loses synchronism scores LOST or
more, the earlier the loss the more, and no further draw is run.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from facts_damping.analysis.indices import THESIS_INDICES, performance_indices
from facts_damping.analysis.judging import judge_run
from facts_damping.analysis.measures import device_limits
from facts_damping.analysis.response import swings_of
from facts_damping.analysis.verdict import GROWING, LIMIT_CYCLE
from facts_damping.case.loading import make_case
from facts_damping.case.tuned import tuned
from facts_damping.errors import FactsDampingError, InputError, one_line
from facts_damping.monitor_table import TRIPPED
from facts_damping.output.tables import with_counts
from facts_damping.output.terminal import note
from facts_damping.parameters.files import shipped
from facts_damping.parameters.profile import DEFAULT_PROFILE
from facts_damping.parameters.run import Controller
from facts_damping.simulation import loop
from facts_damping.simulation.twins import twin
from facts_damping_studies.sweeps import sweep
from facts_damping_studies.sweeps.axes import drawn_columns
from facts_damping_studies.sweeps.batch import CUSTOM, make, names
from facts_damping_studies.sweeps.enumerated_axes import NONE, SCENARIO

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from facts_damping.analysis.response import Twin
    from facts_damping.case.model import Case
    from facts_damping.record import Record

LOST, UNDAMPED, PRICE = 10.0, 1.0, 0.1
REFERENCE = "LLC-tuned"


class Figures(NamedTuple):
    """Figures of a run that the score uses."""

    lasted: float  # fraction of its duration in synchronism
    indices: dict[str, float]
    effort: float  # mean setpoint relative to the devices' limits
    damped: bool  # neither growing nor a limit cycle
    tripped: bool = False  # whether a supervisor tripped a controller


class Draw(NamedTuple):
    """A run of the ensemble without controllers, all content inline, and the reference's figures in it."""

    content: dict[str, Any]
    reference: Figures
    group: tuple[Any, ...] = ()  # values of the study's axes that are not random; empty for the nominal run


class Score(NamedTuple):
    """A score and its parts; for a controller that loses synchronism the score alone."""

    value: float
    ratios: dict[str, float]  # geometric mean of each index relative to the reference
    undamped: float  # fraction of draws
    tripped: float = 0.0  # fraction of draws in which a supervisor trips a controller


def mean_effort(record: Record) -> float:
    """Mean of all setpoints relative to their limits, 0 to 1. All devices must have a limit in the configuration."""
    limits = device_limits(record.configuration)
    return float((np.abs(record.devices["setpoint"]) / np.array([limits[name] for name in record.device_names])).mean())


def figures(record: Record, twin_run: Twin | None = None) -> Figures:
    """Figures of a run with its twin; for a run that loses synchronism only how long it lasted."""
    trip = bool((record.supervision["state"] == TRIPPED).any())
    if not record.in_synchronism.all():
        duration = float(record.configuration["duration"])
        return Figures(min(float(record.time_s[-1]) / duration, 1.0 - 1e-9), {}, 0.0, damped=False, tripped=trip)
    swings = swings_of(record, twin_run)
    verdict = judge_run(record, twin_run, swings).judgement.verdict
    dies = verdict not in (GROWING, LIMIT_CYCLE)  # an undecided verdict is no failure: the last event was late
    return Figures(1.0, performance_indices(record.time_s, swings.own), mean_effort(record), dies, trip)


def draws(
    system: str,
    link: str | None,
    number: int,
    study: str | None = None,
    profile: str = DEFAULT_PROFILE,
    reference: str = REFERENCE,
) -> list[Draw]:
    """The first draws of an ensemble; if its scenario is `training`, preceded by the nominal run.

    Draws in which the reference loses synchronism, or without a power flow solution, are left out, as they give no
    reference. `link` replaces the ensemble's link. Raises `InputError` if the system has no such ensemble, if the
    reference is not tuned, or if there are too few draws.
    """
    plan = ensemble(system, study, profile)
    if reference == REFERENCE and (REFERENCE, None) not in tuned(system, ["speed"], ["sssc"]):
        allowed = "a system for which it is, or --against none"
        raise InputError(f"SYSTEM: '{system}' given, for which LLC-tuned is not tuned; allowed: {allowed}")
    base = plan.base if link is None else plan.base._replace(set={**plan.base.set, "link": link})
    run_names, ensemble_draws = names(base, plan.points[0].changes), list[Draw]()
    if run_names.scenario == SCENARIO:
        plain = {name: value for name, value in base.set.items() if name in ("profile", "link")}
        plain |= {"system": run_names.system, "scenario": run_names.scenario}
        ensemble_draws.append(_draw(make(base._replace(set=plain, content={}), {}), reference))
    random, left_out = {name for axis in plan.study.sweep for name in drawn_columns(axis)}, list[str]()
    for point in plan.points:
        if len(ensemble_draws) >= number:
            break
        group = tuple(value for name, value in point.columns.items() if name not in random)
        try:
            ensemble_draws.append(_draw(make(base, point.changes), reference, group))
        except FactsDampingError as error:
            left_out.append(one_line(error))
    if left_out:
        note(f"{plan.base.source}: draws left out, as they give no reference: {'; '.join(with_counts(left_out))}")
    if len(ensemble_draws) < number:
        raise InputError(
            f"{plan.base.source}: {len(ensemble_draws)} draws in synchronism given; allowed: at least {number}"
        )
    return ensemble_draws


def ensemble(system: str, study: str | None = None, profile: str = DEFAULT_PROFILE) -> sweep.SweepPlan:
    """The draws of a system in a profile; for a shipped system all have the training scenario or their own events.

    `study`: the ensemble; None: `search_SYSTEM` in the profile thesis, `search_SYSTEM_PROFILE` in other profiles.
    """
    end, systems = "" if profile == DEFAULT_PROFILE else f"_{profile}", shipped("systems")
    if study is None:
        studies = shipped("studies")
        known = [name for name in systems if f"search_{name}{end}" in studies]
        if system not in known:
            allowed = f"{', '.join(known)}, or a study with training cases by --study"
            raise InputError(f"SYSTEM: '{system}' given without --study; allowed: {allowed}")
    plan = sweep.plan(study or f"search_{system}{end}", [f"profile={profile}"] if end else [])
    for point in plan.points:
        run_names, source = names(plan.base, point.changes), plan.base.source
        if run_names.system not in (system, CUSTOM):
            raise InputError(f"{source}: system: '{run_names.system}' given; allowed: '{system}', the SYSTEM")
        if system in systems and run_names.scenario not in (SCENARIO, CUSTOM):
            allowed = f"{SCENARIO} of {system}, or events"
            raise InputError(f"{source}: scenario: '{run_names.scenario}' given; allowed: {allowed}")
    return plan


def trained_on(system: str, study: str | None, profile: str) -> Any:
    """The training scenario: its name, or the scenario in the study of a user's own system."""
    if study is None or system in shipped("systems"):
        return SCENARIO
    base = ensemble(system, study, profile).base
    return {**base.content, **base.set}.get("scenario", SCENARIO)


def _draw(case: Case, reference: str, group: tuple[Any, ...] = ()) -> Draw:
    """A draw made from its case. Raises `InputError` if the reference loses synchronism."""
    content = {**case.document(), "asked": None}
    reference_figures = run(content, None if reference == NONE else Controller(name=reference))
    if reference_figures.lasted < 1.0:
        raise InputError(f"{reference} loses synchronism")
    return Draw(content, reference_figures, group)


def run(content: Mapping[str, Any], controller: Controller | None) -> Figures:
    """The figures of a controller in a draw with its devices installed; None: without control."""
    fields: dict[str, Any] = {"controllers": []}
    if controller is not None:
        fields = {"devices": controller.devices, "controllers": [controller.model_dump()]}
    case = make_case({**content, **fields}, "search")
    record = loop.run(case)
    return figures(record, twin(case, record))


def score(controller: Controller, against: Sequence[Draw], worst: int = 100, *, medians: bool = False) -> Score:
    """The score of a controller on draws.

    `worst`: percentage of draws that count, the worst for each index. `medians`: use medians of groups, not means.
    """
    all_figures: list[Figures] = []
    for draw in against:
        run_figures = run(draw.content, controller)
        if run_figures.lasted < 1.0:
            trips = [*(each.tripped for each in all_figures), run_figures.tripped]
            lost = LOST * (2.0 - (len(all_figures) + run_figures.lasted) / len(against))
            return Score(lost, {}, 1.0, float(np.mean(trips)))
        all_figures.append(run_figures)
    pairs = list(zip(all_figures, (draw.reference for draw in against), strict=True))
    logs = np.array([[np.log(a.indices[name] / b.indices[name]) for a, b in pairs] for name in THESIS_INDICES])
    if medians:  # of the draws of each group
        groups = [draw.group for draw in against]
        each = [[other_group == group for other_group in groups] for group in dict.fromkeys(groups)]
        counted = np.column_stack([np.median(logs[:, chosen], axis=1) for chosen in each])
    else:
        counted = np.sort(logs)[:, -math.ceil(worst * len(pairs) / 100) :].mean(axis=1)
    effort = float(np.mean([a.effort - b.effort for a, b in pairs]))
    undamped = float(np.mean([not each_figures.damped for each_figures in all_figures]))
    value = float(counted.max()) + UNDAMPED * undamped + PRICE * max(0.0, effort)
    ratios = np.exp(logs.mean(axis=1))
    ratio_by_name = {name: float(ratio) for name, ratio in zip(THESIS_INDICES, ratios, strict=True)}
    return Score(value, ratio_by_name, undamped, float(np.mean([each.tripped for each in all_figures])))
