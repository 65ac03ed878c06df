"""The picture of the tutorial on 28 April 2025: `python -m facts_damping_reproduction.iberia PATH.png`.

Above, the forced oscillation with and without damping control, and its source switched off. Below, the mode of 0.2 Hz:
in AC emulation, at constant power, damped over the link, and with that link cut.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from matplotlib.figure import Figure

import facts_damping as fd
from facts_damping.analysis.plotting.plots import COLOURS
from facts_damping.output.picture_files import save_picture

if TYPE_CHECKING:
    from collections.abc import Mapping

NOMINAL_MHZ = 50e3
FORCED: dict[str, dict[str, Any]] = {
    "no control": {"controllers": []},
    "POD-P": {},
    "source switched off at 50 s": {"scenario": "switched_off"},
}
CUT = {"link.up.4.model": "bernoulli", "link.up.4.loss": 1.0, "link.up.4.start": 10.0}
SWING: dict[str, dict[str, Any]] = {
    "AC emulation": {"system": "iberia", "controllers": []},
    "constant power": {"controllers": []},
    "POD-P": {},
    "POD-P, its link cut at 10 s": CUT,
}
PANELS = (
    ("iberia_forced", FORCED, "0.63 Hz, forced by a plant", 70.0),
    ("iberia_swing", SWING, "0.2 Hz, a mode", 40.0),
)


def draw(axes: Any, run: str, cases: Mapping[str, Mapping[str, Any]], until_s: float) -> None:
    """Frequency of Madrid less that of France, mHz, of a run with each of some changes."""
    for (name, changes), colour in zip(cases.items(), COLOURS, strict=False):
        signals = fd.simulate(run, **{"duration": until_s, **changes}).arrays
        speeds = [signals[f"machine.{machine}.speed_deviation_pu"] for machine in ("MADRID", "FRANCE")]
        axes.plot(signals["time_s"], NOMINAL_MHZ * (speeds[0] - speeds[1]), color=colour, lw=1.0, label=name)
    axes.set_ylabel("Madrid less France [mHz]", fontsize=8)
    axes.grid(visible=True, color="0.92")
    axes.margins(y=0.15)
    axes.legend(fontsize=7, loc="upper right", ncols=2)


def plot(path: Path) -> Path:
    """Run all, and write the picture."""
    figure = Figure(figsize=(7.2, 5.6), layout="constrained")
    panels: Any = figure.subplots(len(PANELS), 1)
    for axes, (run, cases, title, until_s) in zip(panels, PANELS, strict=True):
        draw(axes, run, cases, until_s)
        axes.set_title(title, fontsize=9, loc="left")
    panels[-1].set_xlabel("time [s]", fontsize=9)
    return save_picture(figure, path, dpi=130, metadata={"Software": None})


if __name__ == "__main__":
    plot(Path(sys.argv[1]))
