"""One run of a sweep: from its changed fields to a flat row of figures.

The figures equal those of `facts-damping simulate` bit for bit.
"""

from __future__ import annotations

import json
from copy import deepcopy
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from facts_damping.analysis import convergence
from facts_damping.analysis.indices import INDICES
from facts_damping.analysis.latency import ages_ms
from facts_damping.analysis.summary import AUTO, summarise
from facts_damping.analysis.supervision import trips
from facts_damping.caching import shared
from facts_damping.case import loading
from facts_damping.errors import FactsDampingError, one_line
from facts_damping.findings import NO_CONTROL, uncontrolled
from facts_damping.parameters.run import Run
from facts_damping.simulation import loop, twins
from facts_damping_studies.margins import criteria
from facts_damping_studies.sweeps import true_jacobian

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from facts_damping.analysis.summary import Summary
    from facts_damping.case.model import Case
    from facts_damping.record import Record

INTERAREA_HZ = 0.9  # a ringdown mode below this frequency is the interarea mode
QUANTILES = (0, 1, 5, 10, 25, 50, 75, 90, 95, 99, 100)  # %, of the latency
LATENCIES = ("latency_mean_ms", *(f"latency_p{q}_ms" for q in QUANTILES[:-1]), "latency_max_ms")
SUMMED = ("settling_time_s", "roughness", "max_injected_voltage_pu")
OUTCOME = ("verdict", "damped", "instability", "duration_s")
RESPONSE_INDEX = "ITAE_of_response"  # of runs with noise
GROWTH = {"value": "growth_per_s", "low": "growth_low_per_s", "high": "growth_high_per_s"}
# Results with half the integration step; the second is the relative change of the index that changes most.
CHECKED = ("converged", "step_change", "verdict_half_step")
INTERAREA = ("interarea_hz", "interarea_damping_ratio")
CUSTOM = "custom"  # name of inline content
NAMED = ("system", "scenario", "link")
IDENTITY = ("system", "scenario", "controller", "scheme", "link", "seed")  # columns of every study

_free: dict[str, Summary] = {}  # summaries without control


class Base(NamedTuple):
    """Common data of all runs of a study: content of the run file, its origin, and the fields set in it.

    `modes`, `jacobian`: additional results, as in the study; `criteria`: of its margin.
    """

    content: dict[str, Any]
    source: str
    set: dict[str, Any]
    modes: bool
    jacobian: int | None = None
    criteria: tuple[str, ...] = ()


class RunRequest(NamedTuple):
    """A run: its key in the journal, the fields that it sets, and its columns in the table.

    `check_step`: repeat it with half the integration step.
    """

    key: str
    changes: dict[str, Any]
    columns: dict[str, Any]
    check_step: bool = False


def make(base: Base, changes: Mapping[str, Any]) -> Case:
    """The case of a run. Raises `InputError` that begins with the `--set` at fault.

    If a change removes all controllers, fields below them are not set.
    """
    values = {**base.set, **changes}
    if changes.get("controllers") == []:
        values = {path: value for path, value in values.items() if not path.startswith("controllers.")}
    return loading.changed_case(deepcopy(base.content), base.source, values)


def one_run(base: Base, task: RunRequest) -> tuple[str, dict[str, Any]]:
    """Key and row of a run; a failed run has a row too, with the reason in `error`."""
    row: dict[str, Any] = {**dict.fromkeys(IDENTITY), **names(base, task.changes), **task.columns}
    try:
        case = make(base, task.changes)
        row |= {**identity(case), **task.columns, "horizon_s": case.duration}
        record, finer = loop.run(case), None
        summary = summarise(record, method=AUTO if base.modes else None, twin=twins.twin(case, record))
        if task.check_step:
            half = loop.with_half_step(case)
            finer_record = loop.run(half)
            finer = summarise(finer_record, method=None, twin=twins.twin(half, finer_record))
        row |= figures(record, summary, finer, modes=base.modes)
        row |= criterion_columns(case, record, summary, base.criteria)
        if base.jacobian is not None:
            row |= true_jacobian.figures(case, true_jacobian.follow(case, record, base.jacobian))
        row["error"] = None
    except FactsDampingError as error:
        row["error"] = one_line(error)
    except Exception as error:  # noqa: BLE001 (whatever a run dies of, the others go on)
        row["error"] = f"{type(error).__name__}: {one_line(error)}"
    return task.key, row


def criterion_columns(case: Case, record: Record, summary: Summary, wanted: Sequence[str]) -> dict[str, Any]:
    """Columns that the criteria of a margin need."""
    found: dict[str, Any] = {}
    if "damping" in wanted:
        found[criteria.LOWEST] = criteria.lowest_damping_ratio(summary.modes)
    if "worse" in wanted:
        plant = {name: value for name, value in record.configuration.items() if name not in ("link", *NO_CONTROL)}
        free = shared(_free, json.dumps(plant, default=str), lambda: _summary(uncontrolled(record.configuration)))
        found[criteria.RATIO] = criteria.itae_ratio(summary, free)
    if "linear" in wanted:
        found[criteria.LINEAR] = criteria.linear_growth(case)
    return found


def _summary(case: Case) -> Summary:
    record = loop.run(case)
    return summarise(record, method=None, twin=twins.twin(case, record))


def names(base: Base, changes: Mapping[str, Any]) -> dict[str, Any]:
    """Names of system, scenario and link as given; `custom` for inline content."""
    values = {**{name: Run.model_fields[name].default for name in NAMED}, **base.content, **base.set, **changes}
    return {name: values[name] if isinstance(values[name], str) else CUSTOM for name in NAMED}


def identity(case: Case) -> dict[str, Any]:
    """Columns that identify a run in every study, in addition to the names; without the fallback controller."""
    own = [c for c in case.controllers if c.fallback_of is None]
    schemes = dict.fromkeys(c.scheme for c in own if c.scheme)
    return {
        "controller": "+".join(c.name for c in own) or "none",
        "scheme": "+".join(schemes) or None,
        "seed": case.run.seed,
    }


def figure_names(*, modes: bool, check_step: bool = False) -> list[str]:
    """Columns of `figures`."""
    found = ["stable", *OUTCOME, *INDICES, RESPONSE_INDEX, *SUMMED, "saturation_duty"]
    found += [*LATENCIES, "frames_lost", "trips"]
    found += [*GROWTH.values(), "warnings", *(CHECKED if check_step else ())]
    return [*found, *INTERAREA] if modes else found


def figures(record: Record, summary: Summary, finer: Summary | None = None, *, modes: bool) -> dict[str, Any]:
    """The figures of a run, flat; None where undefined. `finer`: its summary with half the integration step."""
    found: dict[str, Any] = {
        "stable": summary.stable is True,
        **{name: getattr(summary, name) for name in OUTCOME},
        **(summary.indices or dict.fromkeys(INDICES)),
        RESPONSE_INDEX: (summary.indices_of_response or {}).get("ITAE"),
        **{name: getattr(summary, name) for name in SUMMED},
        "saturation_duty": max(summary.saturation_duty.values(), default=None),
        **_latency(record),
        "frames_lost": summary.frames_lost,
        "trips": len(trips(summary.supervision)),
        **{name: summary.growth_per_s and getattr(summary.growth_per_s, end) for end, name in GROWTH.items()},
        "warnings": "; ".join(summary.warnings) or None,
    }
    if finer is not None:
        compared = convergence.compare(summary, finer)
        maximum = max((compared.step_change or {})[index] for index in INDICES)
        found |= dict(zip(CHECKED, (compared.converged, maximum, finer.verdict), strict=True))
    if modes:
        slow = next((mode for mode in summary.modes if mode.frequency_hz < INTERAREA_HZ), None)
        values = (slow.frequency_hz, slow.damping_ratio) if slow else (None, None)
        found |= dict(zip(INTERAREA, values, strict=True))
    return found


def _latency(record: Record) -> dict[str, float | None]:
    """Mean and quantiles of the latency from measurement to device."""
    ages = ages_ms(record)
    ages = ages[np.isfinite(ages)]
    if not len(ages):
        return dict.fromkeys(LATENCIES)
    return dict(zip(LATENCIES, map(float, [ages.mean(), *np.percentile(ages, QUANTILES)]), strict=True))
