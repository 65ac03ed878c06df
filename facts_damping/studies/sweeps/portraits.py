"""Pictures of neuro-fuzzy controllers: memberships before and after a run, and the response beside the baselines."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from matplotlib.figure import Figure

from facts_damping.analysis.measures import speed_differences
from facts_damping.analysis.plotting.plots import COLOURS
from facts_damping.control.bank import controller_network
from facts_damping.neurofuzzy.network import Network, forward, passes
from facts_damping.simulation import loop
from facts_damping.studies.pages import save

if TYPE_CHECKING:
    from pathlib import Path

    from matplotlib.axes import Axes
    from numpy.typing import NDArray

    from facts_damping.case.model import Case
    from facts_damping.signals import Record

INPUTS = ("e / scale", "de / change scale")
BASELINES = {"none": ("#999999", 1.0), "LLC": ("#56B4E9", 1.2), "LLC-tuned": ("#009E73", 1.2)}
STYLES = ("--", ":", "-")  # before, during, after
MIDST_S = 2.0  # s after the first event
RULES = COLOURS[:2]  # of the two rules


class Portrait(NamedTuple):
    """A run of a controller: its record, and the parameters of its network before, during and after."""

    record: Record
    net: Network
    moments: dict[str, NDArray[np.float64]]
    reach: float  # limit of the inputs


def portrait(case: Case) -> Portrait:
    """Run a neuro-fuzzy controller and keep its learnt parameters, also two seconds after the first event."""
    net, first = (
        controller_network(case.controllers[0]),
        min([event.time for event in case.scenario.events], default=0.0),
    )
    built = loop.build_loop(case)
    theta = built.control.bank_state.learner.theta[0, : net.size]
    before = theta.copy()
    record = loop.finish(case, built)
    part = replace(case, run=case.run.model_copy(update={"duration": first + MIDST_S}))
    midst = loop.build_loop(part)
    loop.finish(part, midst)
    moments = {
        "before": before,
        f"{MIDST_S:g} s after the event": midst.control.bank_state.learner.theta[0, : net.size],
    }
    reach = case.controllers[0].number("range")
    return Portrait(record, net, {**moments, "after": theta}, reach)


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


def draw(case: Case, baselines: dict[str, Case], path: Path) -> None:
    """One PNG of a run: memberships of both inputs, the output of the network, the response beside the baselines."""
    one = portrait(case)
    figure = Figure(figsize=(13.0, 3.2), layout="constrained")
    axes: Any = figure.subplots(1, 4, width_ratios=[1, 1, 1, 1.8])
    x = np.linspace(-one.reach, one.reach, 601)
    for (moment, theta), style in zip(one.moments.items(), STYLES, strict=True):
        degrees, output = surface(one.net, theta, x)
        for i in range(len(INPUTS)):
            for j, colour in enumerate(RULES):
                axes[i].plot(x, degrees[:, i, j], style, color=colour, lw=1.2)
        axes[2].plot(x, np.clip(output, -1.0, 1.0), style, color="black", lw=1.2, label=moment)
    for i, label in enumerate(INPUTS):
        axes[i].set(xlabel=label, ylim=(-0.05, 1.08))
    axes[0].set_ylabel("degree of membership")
    axes[2].set(xlabel=INPUTS[0], ylabel="setpoint / limit, de = 0", ylim=(-1.1, 1.1))
    c = case.controllers[0]
    _response(axes[3], one.record, c.name, {name: loop.run(own) for name, own in baselines.items()})
    figure.legend(*axes[2].get_legend_handles_labels(), loc="outside lower center", ncols=len(STYLES))
    figure.suptitle(f"{c.name} {c.scheme} on {case.run.system}, {case.run.scenario}", x=0.01, ha="left")
    save(figure, path)


def _response(axes: Axes, record: Record, name: str, baselines: dict[str, Record]) -> None:
    """The last monitored speed difference (the interarea one if it exists), 1e-3 p.u."""
    differences = speed_differences(record)
    shown = list(differences)[-1]
    for label, (colour, width) in BASELINES.items():
        if label in baselines:
            axes.plot(
                baselines[label].time_s,
                1e3 * speed_differences(baselines[label])[shown],
                color=colour,
                lw=width,
                label=label,
            )
    axes.plot(record.time_s, 1e3 * differences[shown], color=COLOURS[1], lw=1.5, label=name)
    span = 1.6e3 * float(np.max(np.abs(differences[shown])))
    axes.set(xlabel="time [s]", ylabel=f"{shown} [1e-3 p.u.]", xlim=(0, record.time_s[-1]), ylim=(-span, span))
    axes.legend(fontsize="x-small", loc="upper right")
