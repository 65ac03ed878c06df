"""Charts of a report: the pictures of `analysis` with all runs in each, and the modes."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from facts_damping.analysis.measures import event_times
from facts_damping.analysis.modes.ringdown import interval
from facts_damping.analysis.plotting.pictures import PICTURES, Picture, shown, title_of
from facts_damping.report.contents import Chart, Curve, Panel
from facts_damping.report.traces import detailed, steps

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from facts_damping.analysis.plotting import pictures as analysed
    from facts_damping.report.contents import ReportedRun

# Section and explanation of each picture, by its stem.
SENTENCES = {
    "speeds": "Speed of each machine against synchronous speed, as its PMU measures it: machines that swing against "
    "each other go up and down by turns.",
    "differences": "Speeds of machines or areas against each other: what the indices, the settling time and the modes "
    "are taken from. It should die out.",
    "tie_power": "Active power at the PMUs without a machine: over a tie it swings with the areas at its ends.",
    "voltage": "Magnitude of the voltage at the same PMUs.",
    "centre_of_angle": "Mean rotor angle of each area, weighted by inertia: areas that drift apart lose synchronism.",
    "injected_voltage": "What each device does: a series device injects a voltage, one at a bus moves its voltage "
    "reference. Dashed is the setpoint in force, dotted its limit.",
    "indices": "How each performance index grows over time. The circles bound the cliff, from 5 % to 95 % of the final "
    "value: before it is the error floor, after it the small error. The lower a curve ends, the better.",
    "jacobian": "How a signal answers a device's setpoint, as the identifier takes it to be: an adaptive controller "
    "learns by its sign and size.",
    "learning_rate": "How fast each network learns.",
    "supervision": "What each supervisor does with its controller: only in armed do the controller's setpoints act, in "
    "fallback those of another one, in all others zero.",
    "monitors": "What supervisors watch, beside its limit, which is 1: what came above 0.3 of it, drawn up to 3. What "
    "stays above the limit has the controller fall back, or trips it.",
    "latency": "Fraction of all frames or setpoints that took at most so long: a vertical line is a constant delay, a "
    "slope is jitter.",
}


def charts(runs: Sequence[ReportedRun], stems: Sequence[str]) -> list[Chart]:
    """The pictures with the given stems, of all runs; empty ones are left out."""
    pictures = {picture.stem: picture for picture in PICTURES}
    made = [_chart(pictures[stem], runs) for stem in stems]
    return [chart for chart in made if chart.panels]


def _chart(picture: Picture, runs: Sequence[ReportedRun]) -> Chart:
    """One picture: a panel for each name that any run has."""
    drawn = [{panel.name: panel for panel in picture.panels(run.record)} for run in runs]
    names = shown(picture, drawn)
    found = {name: [(index, one[name]) for index, one in enumerate(drawn) if name in one] for name in names}
    over_time = picture.over == Picture._field_defaults["over"]
    panels = [panel for panel in (_panel(*one, runs, over_time) for one in found.items()) if panel.curves]
    return Chart(
        picture.stem, title_of(picture, drawn, names), SENTENCES[picture.stem], picture.over, picture.label, panels,
        over_time, picture.logarithmic, picture.words,
    )  # fmt: skip


def _panel(
    name: str, parts: Sequence[tuple[int, analysed.Panel]], runs: Sequence[ReportedRun], over_time: bool
) -> Panel:
    """Curves of all runs in one panel."""
    curves: list[Curve] = []
    levels: dict[float, None] = {}
    for index, panel in parts:
        time_s, since = runs[index].record.time_s, min(event_times(runs[index].record), default=0.0)
        for label, one in panel.curves.items():
            x = time_s if one.x is None else one.x
            x, y = detailed(x, one.values, since) if over_time else steps(x, one.values)
            curves.append(Curve(index, x, y, name=label))
        if panel.dashed is not None:
            curves.append(Curve(index, *detailed(time_s, panel.dashed, since), "dashed", "setpoint"))
        if panel.regions is not None:
            at, whole = np.array(panel.regions[:2]), panel.curves[""]
            height = np.interp(at, time_s if whole.x is None else whole.x, whole.values)
            curves.append(Curve(index, at, height, "points"))
        levels |= dict.fromkeys(panel.limits)
    return Panel(" ".join(name.split()), [curve for curve in curves if np.isfinite(curve.y).any()], list(levels))


def modes(runs: Sequence[ReportedRun]) -> list[Chart]:
    """Frequency over damping ratio of each mode, with 95 % intervals; empty if no run has modes."""
    found = [(index, mode) for index, run in enumerate(runs) for mode in run.summary["modes"]]
    curves = [curve for index, mode in found for curve in _cross(index, mode)]
    sentence = (
        "Each circle is a mode of the mode table, its cross the interval of 95 %: the further right, the better "
        "damped; left of zero it grows."
    )
    panels = [Panel("", curves)]
    chart = Chart("modes", "Damping of the modes", sentence, "damping ratio [%]", "f [Hz]", panels, over_time=False)
    return [chart] if curves else []


def _cross(run: int, mode: Mapping[str, Any]) -> list[Curve]:
    """A mode and its intervals."""
    ratio, frequency = 100 * mode["damping_ratio"], mode["frequency_hz"]
    at = Curve(run, np.array([ratio]), np.array([frequency]), "points")
    errors = 100 * (mode["damping_ratio_error"] or 0.0), mode["frequency_error_hz"] or 0.0
    across, along = np.array(interval(ratio, errors[0])), np.array(interval(frequency, errors[1]))
    return [at, Curve(run, across, np.full(2, frequency)), Curve(run, np.full(2, ratio), along)]
