"""What is shown of a comparison: tables for a terminal, JSON, a picture."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from facts_damping.output.picture_files import save_picture
from facts_damping.output.tables import table
from facts_damping_bench import grid
from facts_damping_bench.figures import EQUAL_ERROR, at_equal_error, ratio
from facts_damping_bench.grid import SHOWN
from facts_damping_bench.programs import OURS

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence
    from pathlib import Path

    from facts_damping_bench.figures import Result
    from facts_damping_bench.grid import Shown
    from facts_damping_bench.ticks import Rate

NOTHING = "-"
MARKS = ["o", "s", "^", "D", "v", "P"]


def case(shown: Shown) -> str:
    """What is run, and what an error is."""
    return (
        f"{grid.DURATION:g} s of {shown.text}, {shown.event}, one core. error: of a swing over the largest swing, "
        f"against the same program with a step {shown.finer} times finer than its finest here."
    )


def ladder(results: Iterable[Result]) -> list[str]:
    """Every program at every step."""
    rows = [
        [result.title, f"{1e3 * x.step_s:g}", f"{x.error:.1e}", _s(x.wall_s), _times(grid.DURATION / x.wall_s)]
        for result in results
        for x in result.rungs
    ]
    return table(["program", "step ms", "error", "run s", "times real time"], rows)


def summary(results: Sequence[Result]) -> list[str]:
    """A row a program: at equal error, in a sweep, and what differs from ours."""
    titles = ["program", "version", f"s at {EQUAL_ERROR:g}", "times ours", "with step ms", "set-up s"]
    titles += ["sweep runs/s", "ours over it", "from ours"]
    return table(titles, [_row(result, results[0]) for result in results], left=2)


def _row(result: Result, ours: Result) -> list[str]:
    if result.failed and not result.rungs:
        return [result.title, result.version or NOTHING, *[NOTHING] * 7]
    equal, beside = at_equal_error(result.rungs), at_equal_error(ours.rungs)
    cells = [NOTHING] * 3
    if equal is not None:
        times = ratio(equal.at_error_s, None if beside is None else beside.at_error_s)
        cells = [_s(equal.at_error_s), _times(times), f"{1e3 * equal.step_s:g}"]
    cells.append(_s(result.rungs[0].setup_s))
    if result.sweep is None or ours.sweep is None:
        cells += [NOTHING, NOTHING]
    else:
        cells += [f"{1.0 / result.sweep.run_s:.3g}", _times(result.sweep.run_s / ours.sweep.run_s)]
    return [result.title, result.version, *cells, NOTHING if result.name == OURS else f"{100 * result.from_ours:.2g} %"]


def _s(value: float) -> str:
    return f"{value:.4f}" if value < 0.1 else f"{value:.3f}"


def _times(value: float) -> str:
    if math.isnan(value):
        return NOTHING
    return f"{value:.0f}" if value >= 100.0 else f"{value:.3g}"


def exchange(rates: Sequence[Rate]) -> list[str]:
    """Ticks a second of ours beside another."""
    rows = [
        [rate.title, NOTHING if rate.failed else f"{rate.per_s:.0f}", _times(ratio(rate.per_s, rates[0].per_s))]
        for rate in rates
    ]
    return table(["in step", "ticks/s", "ratio"], rows)


def notes(results: Iterable[Result]) -> list[str]:
    """What each is, and why one is missing."""
    return [f"{result.title}: {result.failed or result.note}" for result in results]


def text(results: Sequence[Result], rates: Sequence[Rate], shown: Shown = SHOWN) -> list[str]:
    """Everything for a terminal."""
    lines = []
    if results:
        lines += [case(shown), "", *ladder(results), "", *summary(results), "", *notes(results)]
    if rates:
        lines += ["", *exchange(rates), "", *(f"{rate.title}: {rate.failed or rate.note}" for rate in rates)]
    return lines


def document(results: Sequence[Result], rates: Sequence[Rate]) -> dict[str, Any]:
    """The same as JSON (docs/results_json.md)."""
    return {"equal_error": EQUAL_ERROR, "programs": [_document(result, results[0]) for result in results]} | {
        "lockstep": [{**rate._asdict(), "failed": rate.failed or None} for rate in rates]
    }


def _document(result: Result, ours: Result) -> dict[str, Any]:
    equal, beside = at_equal_error(result.rungs), at_equal_error(ours.rungs)
    costs = None if equal is None else equal.at_error_s
    return {
        "name": result.name,
        "version": result.version or None,
        "failed": result.failed or None,
        "note": result.note,
        "steps": [x._asdict() for x in result.rungs],
        "reference_step_s": result.reference_step_s,
        "from_ours": result.from_ours,
        "at_equal_error": None if equal is None else equal._asdict(),
        "ratio": ratio(costs, None if beside is None else beside.at_error_s),
        "sweep": None if result.sweep is None else {**result.sweep._asdict(), "runs_per_s": 1.0 / result.sweep.run_s},
    }


def plot(results: Iterable[Result], path: Path, of: Shown = SHOWN) -> Path:
    """Error over the time of a run, log-log, a line a program, a marker a step, as PNG."""
    figure = Figure(figsize=(4.5, 4.2), layout="constrained")  # read at 400 px
    axes = figure.add_subplot()
    shown = [result for result in results if result.rungs]
    steps = sorted({x.step_s for result in shown for x in result.rungs}, reverse=True)
    marks = dict(zip(steps, MARKS * len(steps), strict=False))
    for result in shown:
        (line,) = axes.loglog([x.wall_s for x in result.rungs], [x.error for x in result.rungs], label=result.title)
        for x in result.rungs:
            axes.plot(x.wall_s, x.error, marks[x.step_s], color=line.get_color(), ms=6)
    axes.axhline(EQUAL_ERROR, color="black", lw=0.8, ls="--")
    axes.set(xlabel=f"time of {grid.DURATION:g} s of {of.name} on one core [s]", ylabel="error over largest swing")
    axes.grid(visible=True, which="both", alpha=0.3)
    axes.add_artist(axes.legend(fontsize=8, loc="lower right"))
    kinds = [Line2D([], [], color="black", ls="", marker=marks[step], label=f"{1e3 * step:g} ms") for step in steps]
    axes.legend(handles=kinds, fontsize=8, loc="lower center", title="step")
    return save_picture(figure, path, dpi=180)
