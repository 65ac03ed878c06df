"""How well identifiers know the plant's Jacobian: tables over scenarios and controllers, pictures of runs."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.figure import Figure

from facts_damping.analysis.plots import COLOURS
from facts_damping.case.loading import load_case
from facts_damping.control.table import kind
from facts_damping.errors import InputError
from facts_damping.neurofuzzy.table import VARIANTS
from facts_damping.simulation import loop
from facts_damping.studies.compare import scenarios
from facts_damping.studies.pages import save
from facts_damping.studies.pool import run_all
from facts_damping.studies.true_jacobian import figures, follow
from facts_damping.terminal import table

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path

    from facts_damping.case.model import Case
    from facts_damping.signals import Record

SYSTEM, RUN = "two_area", "two_area_centralised"
LEAST = 1e-9  # on logarithmic axes
DRAWN = "large"  # the scenario of the pictures
HEAD = [
    "# Identified and true Jacobians",
    "",
    "Made by `facts-damping jacobian`, as it came out (docs/mimo.md). Looks are ten a second. sign: at how many of",
    "them the estimate has the sign of the true derivative over the identifier's own horizon (frames), of those at",
    "which the device answers at all: the true one is a hundredth of its root mean square or more; error: median of",
    "the difference between the two, over that; sign at: against the true one over the horizon that was asked for.",
    "",
]


def names(asked: Sequence[str]) -> list[str]:
    """The controllers asked for (none: all with a network). Raises `InputError` for one without identifier."""
    for name in asked:
        if kind(name, "CONTROLLER").network is None:
            raise InputError(f"CONTROLLER: '{name}' given, which has no identifier; allowed: {', '.join(VARIANTS)}")
    return list(asked) or list(VARIANTS)


def scene(scenario: str, name: str, sets: Sequence[str]) -> Case:
    """A run of a centralised controller with an identifier."""
    return load_case(RUN, [f"scenario={scenario}", f"controllers.0.name={name}", "link=ideal", *sets])


def one_run(horizon: int, sets: Sequence[str], what: tuple[str, str]) -> dict[str, Any]:
    """A row: how the Jacobian was identified in one run; `what`: scenario, controller."""
    scenario, name = what
    case = scene(scenario, name, sets)
    record = loop.run(case)
    found = figures(follow(case, record, horizon))
    c = case.controllers[0]
    return {
        "system": SYSTEM,
        "scenario": scenario,
        "controller": name,
        "stable": bool(record.in_synchronism.all()),
        "horizon": int(c.number("identifier_horizon")),
        "stated_horizon": horizon,
        "signals": c.signals,
        "devices": c.devices,
        **{key: value.tolist() for key, value in found.items()},
    }


def study(
    names: Sequence[str],
    horizon: int,
    sets: Sequence[str],
    jobs: int,
    progress: Callable[[int, int], None],
) -> list[dict[str, Any]]:
    """A row for each scenario and controller, in this order."""
    todo = [(scenario, name) for scenario in scenarios(SYSTEM) for name in names]
    return run_all(partial(one_run, horizon, list(sets)), todo, jobs, progress)


def jacobian_tables(found: Sequence[dict[str, Any]]) -> list[str]:
    """Tables in Markdown, one a scenario: a column a derivative, `signal/device`."""
    lines: list[str] = []
    for scenario in dict.fromkeys(row["scenario"] for row in found):
        rows = [row for row in found if row["scenario"] == scenario]
        first = rows[0]
        names = [f"{signal}/{device}" for signal in first["signals"] for device in first["devices"]]
        stated = first["stated_horizon"]
        titles = [f"{name}: sign, %" for name in names] + [f"{name}: error" for name in names]
        titles += [f"{name}: sign at {stated}, %" for name in names] + [f"{name}: answers, %" for name in names]
        made = []
        for row in rows:
            cells = [f"{100 * v:.0f}" for v in np.ravel(row["right_sign"])]
            cells += [f"{v:.2g}" for v in np.ravel(row["error"])]
            cells += [f"{100 * v:.0f}" for v in (*np.ravel(row["right_sign_stated"]), *np.ravel(row["answering"]))]
            made.append([row["controller"], str(row["horizon"]), *cells])
        shown = table(["controller", "horizon", *titles], made, markdown=True)
        lines += [f"### {first['system']}, {scenario}", "", *shown, ""]
    return lines


def draw(case: Case, horizon: int, path: Path) -> None:
    """One PNG of a run: every derivative with the true one, learning rates, Lyapunov functions."""
    record = loop.run(case)
    found, c = follow(case, record, horizon), case.controllers[0]
    p, q = len(c.signals), len(c.devices)
    figure = Figure(figsize=(13.0, 2.3 * (p + 1)), layout="constrained")
    axes: Any = figure.subplots(p + 1, max(q, 2), squeeze=False, sharex=True)
    for i, signal in enumerate(c.signals):
        for d, device in enumerate(c.devices):
            axis = axes[i, d]
            axis.plot(found.time_s, found.true[:, i, d], color=COLOURS[0], lw=1.4, label="true, same horizon")
            axis.plot(found.time_s, found.stated[:, i, d], color=COLOURS[2], lw=1.0, label=f"true, {horizon} frames")
            axis.plot(found.time_s, found.estimate[:, i, d], color=COLOURS[1], lw=1.2, label="identified")
            axis.axhline(0.0, color="black", lw=0.5)
            axis.set_ylabel(f"d {signal} / d {device} [-]")
    _learning(axes[p, 0], axes[p, 1], record)
    figure.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside upper right", ncols=3, fontsize="small")
    title = f"{c.name}, {case.scenario.name}: normalised Jacobian {int(c.number('identifier_horizon'))} frames ahead"
    figure.suptitle(title, x=0.01, ha="left", fontsize="medium")
    save(figure, path)


def _learning(rates: Any, lyapunov: Any, record: Record) -> None:
    """Learning rates and Lyapunov functions of controller and identifier."""
    for identifier, who in enumerate(("controller", "identifier")):
        own = record.learning[(record.learning["controller"] == 0) & (record.learning["identifier"] == identifier)]
        for output in np.unique(own["output"]):
            rows = own[(own["output"] == output) & (own["group"] == 0)]
            time_s, colour = record.time_s[rows["tick"]], COLOURS[2 * identifier + output % 2]
            rates.plot(time_s, np.maximum(rows["rate"], LEAST), color=colour, lw=1.0, label=f"{who}, output {output}")
        rows = own[(own["output"] == 0) & (own["group"] == 0)]
        lyapunov.plot(
            record.time_s[rows["tick"]], np.maximum(rows["lyapunov"], LEAST), color=COLOURS[2 * identifier], label=who
        )
    rates.set(xlabel="time [s]", ylabel="learning rate", yscale="log")
    lyapunov.set(xlabel="time [s]", ylabel="Lyapunov function [-]", yscale="log")
    for axis in (rates, lyapunov):
        axis.legend(fontsize="x-small", loc="upper right")
