"""Further figures of `analyze`: regions of the indices, latency per hop, improvement over a baseline."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from facts_damping.analysis.indices import INDICES, improvement, index_curves, regions
from facts_damping.analysis.latency import HOPS, alike, hops_ms, statistics
from facts_damping.analysis.measures import columns, speed_differences
from facts_damping.analysis.modes.oscillation import is_stable
from facts_damping.analysis.modes.ringdown import COVERED
from facts_damping.output.tables import table

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from facts_damping.record import Record

JUDGED = (*INDICES, "roughness")  # figures that improvement is computed for
PARTS = ("up", "wait", "down")  # hops; the summary has the whole way


def details(record: Record) -> dict[str, Any]:
    """Figures of a run beyond `summarise`, ready for JSON.

    `regions`: for each index over time (figure 4.4) `cliff_from_s`, `cliff_to_s` and `slope`, None if the index stays
    0; empty unless stable. `latency_hops_ms`: {hop: {name: mean, p50, p99, max}}, see `hops_ms`.
    """
    bends: dict[str, Any] = {}
    if is_stable(record):
        time, curves = index_curves(record.time_s, columns(speed_differences(record)))
        found = {name: regions(time, curve) for name, curve in curves.items()}
        bends = {name: region and region._asdict() for name, region in found.items()}
    hops = {hop: {who: statistics(values) for who, values in parts.items()} for hop, parts in hops_ms(record).items()}
    return {"regions": bends, "latency_hops_ms": hops}


def compare(results: Sequence[dict[str, Any]], baseline: int) -> None:
    """Add to each result its `improvement_percent` over the baseline's (4.109).

    It covers the indices and the roughness; None if one of the two runs is not stable.
    """
    first = _judged(results[baseline])
    for result in results:
        other = _judged(result)
        result["improvement_percent"] = improvement(first, other) if first and other else None


def lines(names: Sequence[str], results: Sequence[Mapping[str, Any]], baseline: int) -> Iterator[str]:
    """Text: modes with intervals, saturation, latency per hop and, with several runs, improvement."""
    yield ""
    yield "modes, half the width of their intervals of 95 %, and how often setpoints are at their limits"
    for name, result in zip(names, results, strict=True):
        fit = result["ringdown"]
        text = "no modes" if fit is None else "{order} poles, {snr_db:.1f} dB over the residual".format(**fit)
        duty = (f"{device} {100 * part:.1f} % of the frames" for device, part in result["saturation_duty"].items())
        yield f"{name}: {'; '.join([text, *duty])}"
        yield from (f"  {_mode(mode)}" for mode in result["modes"])
    rows = [
        [f"{name}: {hop}, {HOPS[hop]}, {together(who)}", *(f"{value:.2f}" for value in values)]
        for name, result in zip(names, results, strict=True)
        for hop in PARTS
        for values, who in alike({key: (*row.values(),) for key, row in result["latency_hops_ms"][hop].items()}).items()
    ]
    if rows:
        yield ""
        yield from table(["latency by hop [ms]", "mean", "50 %", "99 %", "max"], rows)
    if len(results) > 1:
        improvements = [result["improvement_percent"] or {} for result in results]
        cells = [[figure, *(_percent(row.get(figure)) for row in improvements)] for figure in JUDGED]
        yield ""
        yield from table([f"improvement on {names[baseline]} [%]", *names], cells)


def _judged(result: Mapping[str, Any]) -> dict[str, float] | None:
    return result["indices"] and {**result["indices"], "roughness": result["roughness"]}


def together(names: Sequence[str]) -> str:
    """One label for names that have the same latencies."""
    return f"{names[0]} and {len(names) - 1} more" if len(names) > 1 else names[0]


def _mode(mode: Mapping[str, Any]) -> str:
    """Frequency and damping ratio with half the width of their 95 % intervals."""
    texts = []
    for label, name, unit in (("frequency", "frequency", "_hz"), ("damping ratio", "damping_ratio", "")):
        error = mode[f"{name}_error{unit}"]
        width = "" if error is None else f" ± {COVERED * error:.1g}"
        texts.append(f"{label} {mode[name + unit]:.4f}{' Hz' if unit else ''}{width}")
    return ", ".join(texts)


def _percent(value: float | None) -> str:
    return "-" if value is None else f"{value:.2f}"
