"""Pictures that compare an identifier's estimate of the plant's Jacobian with the true one."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.figure import Figure

from facts_damping.analysis.plotting.plots import COLOURS
from facts_damping.simulation import loop
from facts_damping.studies.pages import save
from facts_damping.studies.sweeps.true_jacobian import follow

if TYPE_CHECKING:
    from pathlib import Path

    from facts_damping.case.model import Case
    from facts_damping.signals import Record

MINIMUM = 1e-9  # lower limit of logarithmic axes


def draw(case: Case, horizon: int, path: Path) -> None:
    """One PNG of a run: estimated and true derivatives, learning rates, Lyapunov functions.

    `horizon`: frames of a second true derivative, in addition to the identifier's own horizon.
    """
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
            rates.plot(time_s, np.maximum(rows["rate"], MINIMUM), color=colour, lw=1.0, label=f"{who}, output {output}")
        rows = own[(own["output"] == 0) & (own["group"] == 0)]
        lyapunov.plot(
            record.time_s[rows["tick"]], np.maximum(rows["lyapunov"], MINIMUM), color=COLOURS[2 * identifier], label=who
        )
    rates.set(xlabel="time [s]", ylabel="learning rate", yscale="log")
    lyapunov.set(xlabel="time [s]", ylabel="Lyapunov function [-]", yscale="log")
    for axis in (rates, lyapunov):
        axis.legend(fontsize="x-small", loc="upper right")
