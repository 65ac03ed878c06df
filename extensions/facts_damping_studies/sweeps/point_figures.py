"""Pictures of single points of a study, for which the runs are repeated.

One compares an identifier's estimate of the plant's Jacobian with the true one. The other, of a neuro-fuzzy controller,
has the memberships before and after the run, and the response beside the baselines.
"""

from __future__ import annotations

import re
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from matplotlib.figure import Figure

from facts_damping.analysis.measures import speed_differences
from facts_damping.analysis.plotting.plots import COLOURS
from facts_damping.control.bank import controller_network
from facts_damping.errors import FactsDampingError
from facts_damping.neurofuzzy.network import Network, forward, passes
from facts_damping.output.terminal import Progress
from facts_damping.simulation import loop
from facts_damping_studies.pages import save
from facts_damping_studies.sweeps.batch import Base, make, names
from facts_damping_studies.sweeps.enumerated_axes import candidates
from facts_damping_studies.sweeps.pool import run_all
from facts_damping_studies.sweeps.true_jacobian import follow

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from matplotlib.axes import Axes
    from numpy.typing import NDArray

    from facts_damping.case.model import Case
    from facts_damping.record import Record
    from facts_damping_studies.sweeps.axes import Point
    from facts_damping_studies.sweeps.sweep import SweepPlan

HORIZON = 10  # frames, for a picture of a Jacobian if the study sets none
MINIMUM = 1e-9  # lower limit of logarithmic axes
INPUTS = ("e / scale", "de / change scale")
BASELINES = {"none": ("#999999", 1.0), "LLC": ("#56B4E9", 1.2), "LLC-tuned": ("#009E73", 1.2)}
STYLES = ("--", ":", "-")  # before, during, after
MIDST_S = 2.0  # s after the first event
RULES = COLOURS[:2]  # of the two rules


def plot(plan: SweepPlan, folder: Path, jobs: int) -> list[Path]:
    """Draw all pictures of all feasible points, named by the swept values: `jacobian_large_ANFTSC.png`."""
    todo = [(kind, point) for point in plan.points for kind in plan.study.pictures]
    if not todo:
        return []
    progress = Progress("pictures", "pictures")
    try:
        paths = run_all(partial(_one, plan.base, folder), todo, jobs, progress)
    finally:
        progress.close()
    return [path for path in paths if path is not None]


def _one(base: Base, folder: Path, what: tuple[str, Point]) -> Path | None:
    kind, point = what
    name = "_".join([kind, *(str(value) for value in point.columns.values())])
    path = folder / f"{re.sub('[^A-Za-z0-9.+-]+', '_', name)}.png"
    try:
        DRAWN[kind](base, point.changes, path)
    except FactsDampingError:  # the row of this run has the reason
        return None
    return path


def plot_jacobian(case: Case, horizon: int, path: Path) -> None:
    """One PNG of a run: estimated and true derivatives, learning rates, Lyapunov functions.

    `horizon`: frames of a second true derivative, in addition to the identifier's own horizon.
    """
    record = loop.run(case)
    followed, c = follow(case, record, horizon), case.controllers[0]
    p, q = len(c.signals), len(c.devices)
    figure = Figure(figsize=(13.0, 2.3 * (p + 1)), layout="constrained")
    axes: Any = figure.subplots(p + 1, max(q, 2), squeeze=False, sharex=True)
    for i, signal in enumerate(c.signals):
        for d, device in enumerate(c.devices):
            axis = axes[i, d]
            axis.plot(followed.time_s, followed.true[:, i, d], color=COLOURS[0], lw=1.4, label="true, same horizon")
            axis.plot(
                followed.time_s, followed.stated[:, i, d], color=COLOURS[2], lw=1.0, label=f"true, {horizon} frames"
            )
            axis.plot(followed.time_s, followed.estimate[:, i, d], color=COLOURS[1], lw=1.2, label="identified")
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
        learning_rows = record.learning[
            (record.learning["controller"] == 0) & (record.learning["identifier"] == identifier)
        ]
        for output in np.unique(learning_rows["output"]):
            rows = learning_rows[(learning_rows["output"] == output) & (learning_rows["group"] == 0)]
            time_s, colour = record.time_s[rows["tick"]], COLOURS[2 * identifier + output % 2]
            rates.plot(time_s, np.maximum(rows["rate"], MINIMUM), color=colour, lw=1.0, label=f"{who}, output {output}")
        rows = learning_rows[(learning_rows["output"] == 0) & (learning_rows["group"] == 0)]
        time_s, values = record.time_s[rows["tick"]], np.maximum(rows["lyapunov"], MINIMUM)
        lyapunov.plot(time_s, values, color=COLOURS[2 * identifier], label=who)
    rates.set(xlabel="time [s]", ylabel="learning rate", yscale="log")
    lyapunov.set(xlabel="time [s]", ylabel="Lyapunov function [-]", yscale="log")
    for axis in (rates, lyapunov):
        axis.legend(fontsize="x-small", loc="upper right")


class Portrait(NamedTuple):
    """A run of a controller: its record, and the parameters of its network before, during and after."""

    record: Record
    net: Network
    moments: dict[str, NDArray[np.float64]]
    reach: float  # limit of the inputs


def portrait(case: Case) -> Portrait:
    """Run a neuro-fuzzy controller and keep its learnt parameters, also two seconds after the first event."""
    net, first = controller_network(case.controllers[0]), min([e.time for e in case.scenario.events], default=0.0)
    built = loop.build_loop(case)
    theta = built.control.bank_state.learner.theta[0, : net.size]
    before = theta.copy()
    record = loop.finish(case, built)
    part = replace(case, run=case.run.model_copy(update={"duration": first + MIDST_S}))
    midst = loop.build_loop(part)
    loop.finish(part, midst)
    later = midst.control.bank_state.learner.theta[0, : net.size]
    moments = {"before": before, f"{MIDST_S:g} s after the event": later, "after": theta}
    return Portrait(record, net, moments, case.controllers[0].number("range"))


def surface(
    net: Network, theta: NDArray[np.float64], x: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Memberships with all inputs at x, (values, inputs, rules), and the output with e = x and de = 0, (values,)."""
    degrees, output, p = np.zeros((len(x), net.inputs, net.rules)), np.zeros(len(x)), passes(net)
    for k, value in enumerate(x):
        forward(net, theta, np.full(net.inputs, value), p)
        degrees[k] = p.mu
        forward(net, theta, np.array([value, *[0.0] * (net.inputs - 1)]), p)
        output[k] = p.output[0]
    return degrees, output


def plot_portrait(case: Case, baselines: dict[str, Case], path: Path) -> None:
    """One PNG of a run: memberships of both inputs, the output of the network, the response beside the baselines."""
    run_portrait = portrait(case)
    figure = Figure(figsize=(13.0, 3.2), layout="constrained")
    axes: Any = figure.subplots(1, 4, width_ratios=[1, 1, 1, 1.8])
    x = np.linspace(-run_portrait.reach, run_portrait.reach, 601)
    for (moment, theta), style in zip(run_portrait.moments.items(), STYLES, strict=True):
        degrees, output = surface(run_portrait.net, theta, x)
        for i in range(len(INPUTS)):
            for j, colour in enumerate(RULES):
                axes[i].plot(x, degrees[:, i, j], style, color=colour, lw=1.2)
        axes[2].plot(x, np.clip(output, -1.0, 1.0), style, color="black", lw=1.2, label=moment)
    for i, label in enumerate(INPUTS):
        axes[i].set(xlabel=label, ylim=(-0.05, 1.08))
    axes[0].set_ylabel("degree of membership")
    axes[2].set(xlabel=INPUTS[0], ylabel="setpoint / limit, de = 0", ylim=(-1.1, 1.1))
    c = case.controllers[0]
    _response(axes[3], run_portrait.record, c.name, {name: loop.run(baseline) for name, baseline in baselines.items()})
    figure.legend(*axes[2].get_legend_handles_labels(), loc="outside lower center", ncols=len(STYLES))
    figure.suptitle(f"{c.name} {c.scheme} on {case.run.system}, {case.run.scenario}", x=0.01, ha="left")
    save(figure, path)


def _response(axes: Axes, record: Record, name: str, baselines: dict[str, Record]) -> None:
    """The last monitored speed difference (the interarea one if it exists), 1e-3 p.u."""
    differences = speed_differences(record)
    shown = list(differences)[-1]
    for label, (colour, width) in BASELINES.items():
        if label in baselines:
            difference = 1e3 * speed_differences(baselines[label])[shown]
            axes.plot(baselines[label].time_s, difference, color=colour, lw=width, label=label)
    axes.plot(record.time_s, 1e3 * differences[shown], color=COLOURS[1], lw=1.5, label=name)
    span = 1.6e3 * float(np.max(np.abs(differences[shown])))
    axes.set(xlabel="time [s]", ylabel=f"{shown} [1e-3 p.u.]", xlim=(0, record.time_s[-1]), ylim=(-span, span))
    axes.legend(fontsize="x-small", loc="upper right")


def _jacobian(base: Base, changes: dict[str, Any], path: Path) -> None:
    plot_jacobian(make(base, changes), base.jacobian or HORIZON, path)


def _portrait(base: Base, changes: dict[str, Any], path: Path) -> None:
    """Draw a portrait beside the available baselines: the run without control and the lead-lags."""
    case = make(base, changes)
    others = candidates(names(base, changes).system, case)
    plain_fields: dict[str, Any] = {"controllers.*.scheme": None, "controllers.*.parameters": {}}
    beside = {name: make(base, {**changes, **plain_fields, **others[name]}) for name in BASELINES if name in others}
    plot_portrait(case, beside, path)


DRAWN: dict[str, Callable[[Base, dict[str, Any], Path], None]] = {"jacobian": _jacobian, "portrait": _portrait}
