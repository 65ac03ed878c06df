"""A controller's card: measured in all cases of a set, compared with no control and with other controllers.

    change = 100 (exp mean_k mean_c r_c - 1),  r_c = log(measure / measure without control)

in percent: k over the kinds of cases, c over the cases of a kind. Where one of the two loses synchronism, r_c is LOST
or -LOST; where both do it is 0; it is LOST at most. Its 95 % interval is a bootstrap by resampling cases within kinds
(B. Efron, R. J. Tibshirani, An Introduction to the Bootstrap, 1993, 13). The score is what can be claimed: the
reduction in percent at the worse end of the interval. No control has a score of 0.
"""

from __future__ import annotations

import hashlib
import json
from copy import deepcopy
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from facts_damping.case.changes import as_sets, change
from facts_damping.case.loading import changed_case
from facts_damping.errors import FactsDampingError, InputError, check_known, one_line
from facts_damping.parameters.field_errors import check
from facts_damping.parameters.files import find, read_table
from facts_damping.simulation.loop import build_loop
from facts_damping_studies.campaigns.invariants import HARM
from facts_damping_studies.score.case_set import CaseSet
from facts_damping_studies.score.measure import Measured, measure
from facts_damping_studies.score.score_card import KindScore, ScoreCard
from facts_damping_studies.score.statistics import Estimate
from facts_damping_studies.sweeps.pool import workers

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from numpy.typing import NDArray

    Controllers = Sequence[dict[str, Any]]

NONE = "no control"
LOST = float(np.log(10.0))
RESAMPLES, CONFIDENCE = 2000, 0.95
NOTICED = 1.0  # %; a smaller change is none
DIGITS = 4  # of all figures of a card


class Set(NamedTuple):
    """A set of cases with its name, with its version, and the digest of its content."""

    name: str
    content: CaseSet
    digest: str


def read_set(name: str) -> Set:
    """A set of cases by name or path. Raises `InputError`."""
    path = find("case_sets", name)
    return set_of(path.stem.rpartition("_")[0] or path.stem, read_table(path), str(path))


def set_of(name: str, content: dict[str, Any], source: str) -> Set:
    """A set of cases from the content of its file, with its kinds as cards call them. Raises `InputError`.

    The digest is of the cases; what their kinds are called on cards is no part of it.
    """
    checked = check(CaseSet, content, source)
    for kind in checked.called:
        check_known(f"{source}: called", kind, list(checked.kinds))
    text = json.dumps(checked.model_dump(mode="json", exclude={"called"}), sort_keys=True)
    return Set(f"{name} {checked.version}", _as_called(checked), hashlib.sha256(text.encode()).hexdigest()[:16])


def _as_called(content: CaseSet) -> CaseSet:
    """The set with the names of its kinds on cards."""
    kinds = {content.called.get(kind, kind): text for kind, text in content.kinds.items()}
    cases = [case.model_copy(update={"kind": content.called.get(case.kind, case.kind)}) for case in content.cases]
    return content.model_copy(update={"kinds": kinds, "cases": cases, "called": {}})


def run_set(
    case_set: Set,
    controllers: Mapping[str, Controllers],
    jobs: int,
    progress: Callable[[int, int], None],
) -> dict[str, list[Measured]]:
    """Measure controllers, and no control, in all cases: name: a `Measured` for each case.

    Raises `InputError` for a controller that cannot be built, before any run, and with the first case that cannot be
    made.
    """
    every = {NONE: (), **controllers}
    tasks = [(name, rows, i) for name, rows in every.items() for i in range(len(case_set.content.cases))]
    measured_by_name: dict[str, dict[int, Measured]] = {name: {} for name in every}
    for rows in controllers.values():
        build_loop(case_of(case_set, rows, 0))
    with workers(jobs) as each:
        for done, (name, i, measured) in enumerate(each(partial(_one, case_set), tasks)):
            if isinstance(measured, str):
                raise InputError(f"{case_set.name}, case {i} with {name}: {measured}")
            measured_by_name[name][i] = measured
            progress(done + 1, len(tasks))
    return {name: [rows[i] for i in sorted(rows)] for name, rows in measured_by_name.items()}


def _one(case_set: Set, task: tuple[str, Controllers, int]) -> tuple[str, int, Measured | str]:
    name, rows, i = task
    try:
        return name, i, measure(case_of(case_set, rows, i), case_set.content.after)
    except FactsDampingError as error:
        return name, i, one_line(error)


def case_of(case_set: Set, rows: Controllers, i: int) -> Any:
    """A case of the set with controllers."""
    alone = {} if rows else {"supervision": None, "arm_at": None}
    return changed_case(run_of(case_set, rows), case_set.name, {**case_set.content.cases[i].set, **alone})


def run_of(case_set: Set, rows: Controllers) -> dict[str, Any]:
    """The run of all cases of the set with controllers."""
    content = case_set.content
    usual = {"devices": content.devices, "signals": content.signals}
    run = deepcopy(content.run) | {"controllers": [{**usual, **row} for row in rows]}
    change(run, content.set, as_sets(content.set))  # before the case's, which may change what these add
    return run


def log_ratio(index: float | None, reference: float | None) -> float:
    """The logarithm of a measure relative to a reference in the same case; None: synchronism is lost."""
    if index is None or reference is None:
        return LOST * ((index is None) - float(reference is None))
    return min(LOST, float(np.log(index / reference)))


def logs(measured_runs: Sequence[Measured], reference: Sequence[Measured]) -> NDArray[np.float64]:
    """Log ratio of the measure in each case, (cases,)."""
    return np.array([log_ratio(a.measure, b.measure) for a, b in zip(measured_runs, reference, strict=True)])


def estimate(values: NDArray[np.float64], kinds: Sequence[str]) -> Estimate:
    """Mean over kinds of the means over their cases, as a change in percent, with its interval."""
    random = np.random.default_rng(len(values))
    names = dict.fromkeys(kinds)
    groups = [values[[kind == name for kind in kinds]] for name in names]
    drawn = np.mean(
        [
            kind_values[random.integers(len(kind_values), size=(RESAMPLES, len(kind_values)))].mean(axis=1)
            for kind_values in groups
        ],
        axis=0,
    )
    tail = (1.0 - CONFIDENCE) / 2.0
    low, high = np.quantile(drawn, [tail, 1.0 - tail])
    middle = np.mean([kind_values.mean() for kind_values in groups])
    return Estimate(*(_rounded(100.0 * (np.exp(x) - 1.0)) for x in (middle, low, high)))


def _plain(measured_run: Measured) -> Measured:
    floats: dict[str, Any] = {
        name: _rounded(value) for name, value in measured_run._asdict().items() if isinstance(value, float)
    }
    return measured_run._replace(**floats)


def _rounded(value: float) -> float:
    return float(f"{value:.{DIGITS}g}") + 0.0  # no negative zero


def card(case_set: Set, name: str, measured_runs: Mapping[str, Sequence[Measured]]) -> ScoreCard:
    """The card of a controller, from what `run_set` found."""
    kinds = [case.kind for case in case_set.content.cases]
    measured_cases, none = measured_runs[name], measured_runs[NONE]
    ratios = logs(measured_cases, none)
    by_kind: dict[str, KindScore] = {}
    for kind in case_set.content.kinds:
        at = [i for i, case_kind in enumerate(kinds) if case_kind == kind]
        by_kind[kind] = KindScore(
            cases=len(at),
            change=estimate(ratios[at], [kind] * len(at)),
            lost=sum(measured_cases[i].lost_s is not None for i in at),
            lost_without_control=sum(none[i].lost_s is not None for i in at),
            tripped=sum(measured_cases[i].tripped for i in at),
        )
    whole = estimate(ratios, kinds)
    others = {other: rows for other, rows in measured_runs.items() if other not in (name, NONE)}
    return ScoreCard(
        controller=name,
        set=case_set.name,
        set_digest=case_set.digest,
        score=_rounded(-whole.high),
        change=whole,
        kinds=by_kind,
        against={other: estimate(logs(measured_cases, rows), kinds) for other, rows in others.items()},
        effort=_rounded(float(np.mean([measured.effort for measured in measured_cases]))),
        saturated=_rounded(float(np.mean([measured.saturated for measured in measured_cases]))),
        cases=[(kind, _plain(measured)) for kind, measured in zip(kinds, measured_cases, strict=True)],
        does_harm=[kind for kind, row in by_kind.items() if row.change.low > 100.0 * (HARM - 1.0)],
    )


def cards_of(
    case_set: Set, controllers: Mapping[str, Controllers], jobs: int, progress: Callable[[int, int], None]
) -> list[ScoreCard]:
    """The cards of controllers, each beside the others, in their order. Raises `InputError`."""
    measured_runs = run_set(case_set, controllers, jobs, progress)
    return [card(case_set, name, measured_runs) for name in controllers]


def ranking(cards: Sequence[ScoreCard]) -> list[ScoreCard]:
    """Cards, the best score first."""
    return sorted(cards, key=lambda card: -card.score)
