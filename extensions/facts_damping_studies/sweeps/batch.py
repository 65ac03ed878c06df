"""One run of a sweep: from its changed fields to its row.

The figures equal those of `facts-damping simulate` bit for bit.
"""

from __future__ import annotations

import json
from dataclasses import replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from facts_damping.analysis import convergence
from facts_damping.analysis.indices import INDICES
from facts_damping.analysis.judging import AT_LIMITS
from facts_damping.analysis.latency import ages_ms
from facts_damping.analysis.summary import AUTO, summarise
from facts_damping.analysis.supervision import tripping, trips
from facts_damping.caching import shared
from facts_damping.case import loading
from facts_damping.errors import FactsDampingError, InputError, one_line
from facts_damping.findings import NO_CONTROL, uncontrolled
from facts_damping.parameters.run import Run
from facts_damping.simulation import loop, twins
from facts_damping_studies.margins import criteria
from facts_damping_studies.sweeps import true_jacobian
from facts_damping_studies.sweeps.sweep_rows import (
    IDENTITY,
    LATENCIES,
    QUANTILES,
    FirstTrip,
    HalfStep,
    Interarea,
    RunFigures,
    SweepRow,
)

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from facts_damping.analysis.summary import Summary
    from facts_damping.case.model import Case
    from facts_damping.record import Record

INTERAREA_HZ = 0.9  # a ringdown mode below this frequency is the interarea mode
CUSTOM = "custom"  # name of inline content
NAMED = ("system", "scenario", "link")

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
    return loading.changed_case(base.content, base.source, values)


def refusal(base: Base, task: RunRequest) -> tuple[str, str | None]:
    """Key of a run, and why its input is refused when its loop is built; None: it is not."""
    try:
        loop.build_loop(make(base, task.changes))
    except InputError as error:
        return task.key, one_line(error)
    except Exception:  # noqa: BLE001 (whatever else comes is told by its row)
        return task.key, None
    return task.key, None


def one_run(base: Base, task: RunRequest) -> tuple[str, SweepRow]:
    """Key and row of a run; a failed run has a row too, with the reason in `error`."""
    row = SweepRow({**dict.fromkeys(IDENTITY), **names(base, task.changes)._asdict(), **task.columns}, error=None)
    try:
        case = make(base, task.changes)
        row = replace(row, columns={**row.columns, **identity(case), **task.columns}, horizon_s=case.duration)
        record, finer = loop.run(case), None
        summary = summarise(record, method=AUTO if base.modes else None, twin=twins.twin(case, record))
        if task.check_step:
            half = loop.with_half_step(case)
            finer_record = loop.run(half)
            finer = summarise(finer_record, method=None, twin=twins.twin(half, finer_record))
        row = replace(
            row,
            figures=figures(record, summary),
            half_step=None if finer is None else half_step(summary, finer),
            interarea=interarea(summary) if base.modes else None,
            first_trip=first_trip(summary),
            at_limits=summary.verdict_because == AT_LIMITS,
        )
        row = replace(row, asked=criterion_figures(case, record, summary, base.criteria))
        if base.jacobian is not None:
            compared = true_jacobian.figures(case, true_jacobian.follow(case, record, base.jacobian))
            row = replace(row, asked={**row.asked, **compared})
    except FactsDampingError as error:
        row = replace(row, error=one_line(error))
    except Exception as error:  # noqa: BLE001 (whatever a run dies of, the others go on)
        row = replace(row, error=f"{type(error).__name__}: {one_line(error)}")
    return task.key, row


def criterion_figures(case: Case, record: Record, summary: Summary, wanted: Sequence[str]) -> dict[str, float | None]:
    """Fields of `CriterionFigures` that the criteria of a margin need."""
    judged: dict[str, float | None] = {}
    if "damping" in wanted:
        judged["lowest_damping_ratio"] = criteria.lowest_damping_ratio(summary.modes)
    if "worse" in wanted:
        plant = {name: value for name, value in record.configuration.items() if name not in ("link", *NO_CONTROL)}
        free = shared(_free, json.dumps(plant, default=str), lambda: _summary(uncontrolled(record.configuration)))
        judged["ITAE_ratio"] = criteria.itae_ratio(summary, free)
    if "linear" in wanted:
        judged["linear_growth_per_s"] = criteria.linear_growth(case)
    return judged


def _summary(case: Case) -> Summary:
    record = loop.run(case)
    return summarise(record, method=None, twin=twins.twin(case, record))


class Names(NamedTuple):
    """Names of what a run consists of."""

    system: str
    scenario: str
    link: str


def names(base: Base, changes: Mapping[str, Any]) -> Names:
    """Names of system, scenario and link as given; `custom` for inline content."""
    values = {**{name: Run.model_fields[name].default for name in NAMED}, **base.content, **base.set, **changes}
    return Names(*(values[name] if isinstance(values[name], str) else CUSTOM for name in NAMED))


def identity(case: Case) -> dict[str, Any]:
    """Columns that identify a run in every study, in addition to the names; without the fallback controller."""
    controllers = [c for c in case.controllers if c.fallback_of is None]
    schemes = dict.fromkeys(c.scheme for c in controllers if c.scheme)
    name = "+".join(c.name for c in controllers) or "none"
    return {"controller": name, "scheme": "+".join(schemes) or None, "seed": case.run.seed}


def figures(record: Record, summary: Summary) -> RunFigures:
    """The figures of a run."""
    growth = summary.growth_per_s
    return RunFigures(
        stable=summary.stable is True,
        verdict=summary.verdict,
        damped=summary.damped,
        instability=summary.instability,
        duration_s=summary.duration_s,
        indices={**dict.fromkeys(INDICES), **(summary.indices or {})},
        ITAE_of_response=(summary.indices_of_response or {}).get("ITAE"),
        settling_time_s=summary.settling_time_s,
        roughness=summary.roughness,
        max_injected_voltage_pu=summary.max_injected_voltage_pu,
        saturation_duty=max(summary.saturation_duty.values(), default=None),
        latency=_latency(record),
        frames_lost=summary.frames_lost,
        trips=len(trips(summary.supervision)),
        growth_per_s=growth and growth.value,
        growth_low_per_s=growth and growth.low,
        growth_high_per_s=growth and growth.high,
        warnings="; ".join(summary.warnings) or None,
    )


def first_trip(summary: Summary) -> FirstTrip | None:
    """The first trip of a run; None: there is none."""
    changes = [change for _, change in tripping(summary.supervision)]
    first = min(changes, key=lambda change: change.time_s, default=None)
    return None if first is None else FirstTrip(*first[1:])


def half_step(summary: Summary, finer: Summary) -> HalfStep:
    """What changes with half the integration step, whose summary is `finer`."""
    compared = convergence.compare(summary, finer)
    changes = compared.step_change or {}
    return HalfStep(compared.converged, max(changes[index] for index in INDICES), finer.verdict)


def interarea(summary: Summary) -> Interarea:
    """The interarea mode of a run's ringdown."""
    slow = next((mode for mode in summary.modes if mode.frequency_hz < INTERAREA_HZ), None)
    return Interarea(slow.frequency_hz, slow.damping_ratio) if slow else Interarea(None, None)


def _latency(record: Record) -> dict[str, float | None]:
    """Mean and quantiles of the latency from measurement to device."""
    ages = ages_ms(record)
    ages = ages[np.isfinite(ages)]
    if not len(ages):
        return dict.fromkeys(LATENCIES)
    return dict(zip(LATENCIES, map(float, [ages.mean(), *np.percentile(ages, QUANTILES)]), strict=True))
