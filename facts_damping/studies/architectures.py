"""Architectures side by side: one centralised controller, one for each device, a single device."""

from __future__ import annotations

import json
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from matplotlib.figure import Figure

from facts_damping.analysis.plots import COLOURS
from facts_damping.analysis.summary import summarise
from facts_damping.case.loading import load_case
from facts_damping.control.table import CONTROLLERS, MIMO_GAIN, kind
from facts_damping.simulation import loop
from facts_damping.studies import compare
from facts_damping.studies.batch import INTERAREA_HZ
from facts_damping.studies.pages import at, save
from facts_damping.studies.pool import run_all
from facts_damping.studies.structures import PORTS
from facts_damping.studies.tune import Scheme, every_scheme
from facts_damping.terminal import table

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path

SYSTEM = "two_area"
# What a controller of one device is given (chapters 4, 6).
SIGNALS = {"sssc": PORTS["sssc",], "statcom": ["speed", "power"]}
TOGETHER = PORTS["sssc", "statcom"]  # what that of both is given
# Devices that are installed, and those of each controller.
ARCHITECTURES = {
    "centralised": [["sssc", "statcom"]],
    "decentralised": [["sssc"], ["statcom"]],
    "single SSSC": [["sssc"]],
    "single STATCOM": [["statcom"]],
}
MEASURES = {
    "ITAE": ("indices", "ITAE"),
    "smoothness": ("smoothness",),
    "damping ratio": ("interarea",),
    "IAE": ("indices", "IAE"),
    "ITSE": ("indices", "ITSE"),
    "ISE": ("indices", "ISE"),
}
USUAL = [name for name in CONTROLLERS if name != "LQG"]  # which reckons with no other controller beside it
MARKERS = ("o", "s", "^", "v")


class Contender(NamedTuple):
    """A run of the study."""

    scenario: str
    architecture: str
    name: str
    scheme: Scheme


def controllers(architecture: str, name: str, scheme: str | None) -> list[str]:
    """The changes to a run that make it one of an architecture, with the same kind of controller everywhere.

    Lead-lags take the first signal; LLC has appendix B's gains, 10 at the SSSC and 5 at the STATCOM.
    """
    groups = ARCHITECTURES[architecture]
    made = []
    for devices in groups:
        signals = TOGETHER if len(devices) > 1 else SIGNALS[devices[0]]
        own: dict[str, Any] = {"name": name, "devices": devices, "signals": signals[: kind(name).signals]}
        if scheme is not None:
            own["scheme"] = scheme
        if name == "LLC" and devices == ["statcom"]:
            own["parameters"] = {"gain": MIMO_GAIN}
        made.append(own)
    installed = [device for devices in groups for device in devices]
    return [f"devices={json.dumps(installed)}", f"controllers={json.dumps(made)}"]


def one_run(sets: Sequence[str], what: Contender) -> dict[str, Any]:
    """The figures of one run."""
    own = controllers(what.architecture, what.name, what.scheme)
    result = summarise(loop.run(load_case(None, [f"system={SYSTEM}", f"scenario={what.scenario}", *own, *sets])))
    keep = ("stable", "instability", "damped", "indices", "smoothness", "settling_time_s", "modes")
    swing = [mode["damping_ratio"] for mode in result["modes"] or () if mode["frequency_hz"] < INTERAREA_HZ]
    kept = {key: result[key] for key in keep}
    return {"system": SYSTEM, **what._asdict(), **kept, "interarea": min(swing, default=None)}


def study(
    names: Sequence[str], sets: Sequence[str], jobs: int, progress: Callable[[int, int], None]
) -> list[dict[str, Any]]:
    """A row for each scenario, controller and architecture, in this order."""
    todo = [
        Contender(scenario, architecture, name, scheme)
        for scenario in compare.scenarios(SYSTEM)
        for name, scheme in every_scheme(list(names) or USUAL)
        for architecture in ARCHITECTURES
    ]
    return run_all(partial(one_run, list(sets)), todo, jobs, progress)


def head(picture: str) -> list[str]:
    """The beginning of the page, with its picture's name."""
    return [
        "# Architectures",
        "",
        "Made by `facts-damping architectures --out docs/architectures.md`, as it came out (docs/mimo.md); parameters:",
        "`config/controllers`, chosen on the scenario `training` alone. Indices are those of (4.108) from t = 0,",
        "`smoothness` is (5.34) over dt^2, `damping ratio` that of the interarea mode in the ringdown at the end.",
        "",
        f"![ITAE of every controller in each scenario, a mark for each architecture]({picture})",
        "",
    ]


def architecture_tables(found: Sequence[dict[str, Any]]) -> list[str]:
    """Tables in Markdown: for each scenario and measure a row a controller, a column an architecture."""
    lines: list[str] = []
    for scenario in dict.fromkeys(row["scenario"] for row in found):
        rows = [row for row in found if row["scenario"] == scenario]
        lines += [f"### {SYSTEM}, {scenario}", ""]
        for measure, path in MEASURES.items():
            cells = []
            for name, scheme in dict.fromkeys((row["name"], row["scheme"]) for row in rows):
                own = [row for row in rows if (row["name"], row["scheme"]) == (name, scheme)]
                cells.append([name, scheme or "", *(_cell(row, path) for row in own)])
            titles = ["controller", "scheme", *ARCHITECTURES]
            lines += [f"{measure}:", "", *table(titles, cells, left=2, markdown=True), ""]
    return lines


def _cell(row: dict[str, Any], path: Sequence[str]) -> str:
    """A figure; in its place the instability, and beside it a note where the oscillation does not die."""
    if not row["stable"]:
        return str(row["instability"])
    value = at(row, path)
    shown = "-" if value is None else f"{value:.4g}"
    return shown + ("" if row["damped"] else " (not damped)")


def draw(found: Sequence[dict[str, Any]], path: Path) -> None:
    """A PNG: ITAE of every controller, a panel a scenario, a mark an architecture."""
    scenarios = list(dict.fromkeys(row["scenario"] for row in found))
    labels = list(dict.fromkeys((row["name"], row["scheme"]) for row in found))
    figure = Figure(figsize=(13.0, 1.5 + 0.24 * len(labels)), layout="constrained")
    axes: Any = figure.subplots(1, len(scenarios), sharey=True, squeeze=False)
    for axis, scenario in zip(axes[0], scenarios, strict=True):
        for colour, marker, architecture in zip(COLOURS, MARKERS, ARCHITECTURES, strict=False):
            own = [r for r in found if (r["scenario"], r["architecture"]) == (scenario, architecture)]
            places = [
                (row["indices"]["ITAE"], labels.index((row["name"], row["scheme"]))) for row in own if row["stable"]
            ]
            axis.plot(*np.array(places).reshape(-1, 2).T, marker, color=colour, ms=5, alpha=0.85, label=architecture)
        axis.set(xscale="log", xlabel="ITAE [p.u. s²]", title=scenario)
        axis.grid(visible=True, axis="both", lw=0.3)
    axes[0, 0].set_yticks(range(len(labels)), [f"{name} {scheme or ''}".strip() for name, scheme in labels])
    axes[0, 0].invert_yaxis()
    figure.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside lower center", ncols=len(ARCHITECTURES))
    save(figure, path)
