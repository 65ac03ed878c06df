"""How good a controller is on draws of a training ensemble, beside a reference on the same draws.

    score = max_i mean_d log(I_id / I_id of the reference)      i: ITAE, IAE, ITSE, ISE (4.108); d: draws, or the worst
            + UNDAMPED (share of draws whose oscillation grows, or is a limit cycle)
            + PRICE max(0, mean_d(effort - effort of the reference)),  effort = mean |u| / u_max

The reference is LLC-tuned, or no control. 0 is as good as it, and below 0 all four indices are better, as geometric
means over the draws. With a share of the draws the first mean is over the worst of each index alone (conditional value
at risk, Rockafellar and Uryasev 2000): much that is gained in a few draws makes up for nothing in others. By medians
the first term is instead the largest median of any index in any group of draws; a group has the same value of every
axis of the study that is not drawn. A run that loses synchronism counts LOST and more, the earlier the more; then no
further draw is run.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from facts_damping.analysis.indices import THESIS_INDICES, performance_indices
from facts_damping.analysis.measures import columns, event_times, setpoint_limits, speed_differences
from facts_damping.analysis.verdict import GROWING, LIMIT_CYCLE, judge
from facts_damping.case.controllers import tuned
from facts_damping.case.loading import make_case
from facts_damping.errors import FactsDampingError, InputError
from facts_damping.parameters.files import shipped
from facts_damping.parameters.profile import DEFAULT_PROFILE
from facts_damping.parameters.run import Controller
from facts_damping.studies.sweeps import sweep
from facts_damping.studies.sweeps.axes import drawn_columns
from facts_damping.studies.sweeps.batch import closed_loop, make, names
from facts_damping.studies.sweeps.enumerated_axes import NONE, SCENARIO

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray

    from facts_damping.case.model import Case
    from facts_damping.signals import Record

LOST, UNDAMPED, PRICE = 10.0, 1.0, 0.1
REFERENCE = "LLC-tuned"
INLINE = "custom"  # the scenario of draws that have events of their own


class Figures(NamedTuple):
    """What is judged of a run."""

    lasted: float  # share of its duration in synchronism
    indices: dict[str, float]
    effort: float  # mean share of the devices' limits
    damped: bool  # it neither grows nor is it a limit cycle


class Draw(NamedTuple):
    """A run of the ensemble without controllers, everything inline, and the figures of the reference in it."""

    content: dict[str, Any]
    reference: Figures
    group: tuple[Any, ...] = ()  # the values of the study's axes that are not drawn; the nominal run has none


class Score(NamedTuple):
    """A score and what it is made of; of a controller that loses synchronism the score alone."""

    value: float
    ratios: dict[str, float]  # geometric mean of an index over that of the reference
    undamped: float  # share of draws


def figures(record: Record) -> Figures:
    """Figures of a run; of one that loses synchronism only how long it lasted."""
    if not record.in_synchronism.all():
        duration = float(record.configuration["duration"])
        return Figures(min(float(record.time_s[-1]) / duration, 1.0 - 1e-9), {}, 0.0, damped=False)
    t, deviations = record.time_s, columns(speed_differences(record))
    limits = setpoint_limits(record.configuration)
    share = np.abs(record.devices["setpoint"]) / np.array([limits[name] for name in record.device_names])
    verdict = judge(t, deviations, (event_times(record) or [0.0])[-1]).verdict
    dies = verdict not in (GROWING, LIMIT_CYCLE)  # what is undecided is nobody's fault: the last event was late
    return Figures(1.0, performance_indices(t, deviations), float(share.mean()), dies)


def draws(
    system: str,
    link: str | None,
    number: int,
    study: str | None = None,
    profile: str = DEFAULT_PROFILE,
    reference: str = REFERENCE,
) -> list[Draw]:
    """The first draws of an ensemble; where its scenario is `training`, the run of that as it is before them.

    Draws in which the reference loses synchronism, or that have no power flow, are left out: there is nothing to count
    from. `link`: instead of the ensemble's. Raises `InputError` where the system has no such ensemble, the reference is
    not tuned, or there are too few draws.
    """
    made = ensemble(system, study, profile)
    if reference == REFERENCE and (REFERENCE, None) not in tuned(system, ["speed"], ["sssc"]):
        given = f"SYSTEM: '{system}' given, for which LLC-tuned is not tuned"
        raise InputError(f"{given}; allowed: one for which it is, or --against none")
    more = {} if link is None else {"link": link}
    base = made.base._replace(set={**made.base.set, **more})
    told = names(base, made.points[0].changes)
    if told["scenario"] != SCENARIO:
        found = []
    else:
        plain = {name: value for name, value in base.set.items() if name in ("profile", "link")}
        plain |= {name: told[name] for name in ("system", "scenario")}
        found = [_draw(make(base._replace(set=plain, content={}), {}), reference)]
    drawn = {name for axis in made.study.sweep for name in drawn_columns(axis)}
    for point in made.points:
        if len(found) >= number:
            break
        group = tuple(value for name, value in point.columns.items() if name not in drawn)
        try:
            found.append(_draw(make(base, point.changes), reference, group))
        except FactsDampingError:
            continue
    if len(found) < number:
        raise InputError(f"{made.base.source}: {len(found)} draws in synchronism given; allowed: at least {number}")
    return found


def ensemble(system: str, study: str | None = None, profile: str = DEFAULT_PROFILE) -> sweep.Plan:
    """The draws of a system in a profile; of a shipped one all have the scenario of training, or events of their own.

    `study`: whose they are; none: `search_SYSTEM` in the profile thesis, in another one `search_SYSTEM_PROFILE`.
    """
    end, systems = "" if profile == DEFAULT_PROFILE else f"_{profile}", shipped("systems")
    if study is None:
        studies = shipped("studies")
        known = [name for name in systems if f"search_{name}{end}" in studies]
        if system not in known:
            given = f"SYSTEM: '{system}' given without --study"
            raise InputError(f"{given}; allowed: {', '.join(known)}, or a study with training cases by --study")
    made = sweep.plan(study or f"search_{system}{end}", [f"profile={profile}"] if end else [])
    for point in made.points:
        told = names(made.base, point.changes)
        if told["system"] not in (system, INLINE):
            raise InputError(
                f"{made.base.source}: system: '{told['system']}' given; allowed: '{system}', as is searched"
            )
        if system in systems and told["scenario"] not in (SCENARIO, INLINE):
            raise InputError(
                f"{made.base.source}: scenario: '{told['scenario']}' given; allowed: {SCENARIO} of {system}, or events"
            )
    return made


def trained_on(system: str, study: str | None, profile: str) -> Any:
    """The scenario of training: the name, or what the study of a user's own system has."""
    if study is None or system in shipped("systems"):
        return SCENARIO
    base = ensemble(system, study, profile).base
    return {**base.content, **base.set}.get("scenario", SCENARIO)


def _draw(case: Case, reference: str, group: tuple[Any, ...] = ()) -> Draw:
    """A draw from its case. Raises `InputError` where the reference loses synchronism in it."""
    content = {**case.document(), "asked": None}
    found = run(content, None if reference == NONE else Controller(name=reference))
    if found.lasted < 1.0:
        raise InputError(f"{reference} loses synchronism")
    return Draw(content, found, group)


def run(content: Mapping[str, Any], controller: Controller | None) -> Figures:
    """The figures of a controller in a draw, its devices those installed; none: of no control."""
    own: dict[str, Any] = {"controllers": []}
    if controller is not None:
        own = {"devices": controller.devices, "controllers": [controller.model_dump()]}
    return figures(closed_loop(make_case({**content, **own}, "search")))


def score(controller: Controller, against: Sequence[Draw], worst: int = 100, *, medians: bool = False) -> Score:
    """The score of a controller on draws.

    `worst`: how many of them count, %: of each index the worst. `medians`: those of the groups count, instead of means.
    """
    found: list[Figures] = []
    for draw in against:
        one = run(draw.content, controller)
        if one.lasted < 1.0:
            return Score(LOST * (2.0 - (len(found) + one.lasted) / len(against)), {}, 1.0)
        found.append(one)
    pairs = list(zip(found, (draw.reference for draw in against), strict=True))
    logs = np.array([[np.log(a.indices[name] / b.indices[name]) for a, b in pairs] for name in THESIS_INDICES])
    if medians:
        counted = _medians(logs, [draw.group for draw in against])
    else:
        counted = np.sort(logs)[:, -math.ceil(worst * len(pairs) / 100) :].mean(axis=1)
    effort = float(np.mean([a.effort - b.effort for a, b in pairs]))
    undamped = float(np.mean([not one.damped for one in found]))
    value = float(counted.max()) + UNDAMPED * undamped + PRICE * max(0.0, effort)
    ratios = np.exp(logs.mean(axis=1))
    return Score(value, {name: float(ratio) for name, ratio in zip(THESIS_INDICES, ratios, strict=True)}, undamped)


def _medians(logs: NDArray[np.float64], groups: Sequence[tuple[Any, ...]]) -> NDArray[np.float64]:
    """Medians over the draws of each group, (indices, groups), of (indices, draws)."""
    each = [[one == group for one in groups] for group in dict.fromkeys(groups)]
    return np.column_stack([np.median(logs[:, chosen], axis=1) for chosen in each])
