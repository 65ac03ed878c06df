"""Further figures of `analyze`: regions of the indices, latency per hop, improvement over a baseline."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from facts_damping.analysis.indices import INDICES, improvement, index_curves, regions
from facts_damping.analysis.latency import HOPS, alike, hops_ms, statistics
from facts_damping.analysis.measures import columns, speed_differences
from facts_damping.analysis.modes.oscillation import is_stable
from facts_damping.analysis.modes.ringdown import COVERED
from facts_damping.output.tables import table

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

    from facts_damping.analysis.indices import Regions
    from facts_damping.analysis.latency import Statistics
    from facts_damping.analysis.summary import ModeFit, Summary
    from facts_damping.record import Record

JUDGED = (*INDICES, "roughness")  # figures that improvement is computed for
PARTS = ("up", "wait", "down")  # hops; the summary has the whole way


class Details(NamedTuple):
    """Figures of a run beyond its summary.

    `regions`: bends of each index over time (figure 4.4), None if the index stays 0; empty unless stable.
    `latency_hops_ms`: by hop and name, see `hops_ms`. `improvement_percent`: see `improvements`.
    """

    regions: dict[str, Regions | None]
    latency_hops_ms: dict[str, dict[str, Statistics]]
    improvement_percent: dict[str, float | None] | None = None


def details(record: Record) -> Details:
    """Details of a run, without its improvement."""
    bends = {}
    if is_stable(record):
        time, curves = index_curves(record.time_s, columns(speed_differences(record)))
        bends = {name: regions(time, curve) for name, curve in curves.items()}
    hops = {hop: {who: statistics(values) for who, values in parts.items()} for hop, parts in hops_ms(record).items()}
    return Details(bends, hops)


def improvements(summaries: Sequence[Summary], baseline: int) -> list[dict[str, float | None] | None]:
    """Improvement of each run over the baseline, percent (4.109).

    It covers the indices and the roughness; None if one of the two runs is not stable.
    """
    judged = [s.indices and {**s.indices, "roughness": s.roughness} for s in summaries]
    first = judged[baseline]
    return [improvement(first, other) if first and other else None for other in judged]


def lines(
    names: Sequence[str], summaries: Sequence[Summary], details: Sequence[Details], baseline: int
) -> Iterator[str]:
    """Text: modes with intervals, saturation, latency per hop and, with several runs, improvement."""
    yield ""
    yield "modes, half the width of their intervals of 95 %, and how often setpoints are at their limits"
    for name, summary in zip(names, summaries, strict=True):
        fit = summary.ringdown
        text = "no modes" if fit is None else f"{fit.order} poles, {fit.snr_db:.1f} dB over the residual"
        duty = (f"{device} {100 * part:.1f} % of the frames" for device, part in summary.saturation_duty.items())
        yield from (f"{name}:", f"  {'; '.join([text, *duty])}")
        yield from (f"  {_mode(mode)}" for mode in summary.modes)
    for name, detail in zip(names, details, strict=True):
        hops = [(f"{hop}, {HOPS[hop]}", alike(detail.latency_hops_ms[hop])) for hop in PARTS]
        rows = [[f"{hop}, {together(who)}", *_figures(values)] for hop, parts in hops for values, who in parts.items()]
        if rows:
            yield f"\n{name}" if len(names) > 1 else ""
            yield from table(["latency by hop [ms]", "mean", "50 %", "99 %", "max"], rows)
    better = [detail.improvement_percent or {} for detail in details]
    if len(details) > 1 and any(better):
        cells = [[figure, *_figures(part.get(figure) for part in better)] for figure in JUDGED]
        yield ""
        yield from table([f"improvement on {names[baseline]} [%]", *names], cells)
    elif len(details) > 1:
        yield f"\nno improvement on {names[baseline]}: that needs two runs in synchronism to their ends"


def together(names: Sequence[str]) -> str:
    """One label for names that have the same latencies."""
    return f"{names[0]} and {len(names) - 1} more" if len(names) > 1 else names[0]


def _mode(mode: ModeFit) -> str:
    """Frequency and damping ratio with half the width of their 95 % intervals."""
    frequency = f"frequency {mode.frequency_hz:.4f} Hz{_width(mode.frequency_error_hz)}"
    return f"{frequency}, damping ratio {mode.damping_ratio:.4f}{_width(mode.damping_ratio_error)}"


def _width(error: float | None) -> str:
    return "" if error is None else f" ± {COVERED * error:.1g}"


def _figures(values: Iterable[float | None]) -> list[str]:
    return ["-" if value is None else f"{value:.2f}" for value in values]
