"""What a robust design shows and writes: text, JSON, a picture of the damping, and a run's file."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.figure import Figure

from facts_damping.output.picture_files import save_picture
from facts_damping.output.tables import table
from facts_damping.output.writing import write_whole
from facts_damping.parameters.profile import DEFAULT_PROFILE
from facts_damping.parameters.yaml_text import dump
from facts_damping_grids.text import rows_text
from facts_damping_studies.robust.certificate import charted
from facts_damping_studies.robust.robust_design import violations

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from facts_damping_studies.design.design import Task
    from facts_damping_studies.robust.grid_run import GridRun
    from facts_damping_studies.robust.robust_design import RobustDesign

SHOWN = 8  # scenarios in the table
DIGITS = 8  # of a law's matrices


def text(design: RobustDesign) -> Iterator[str]:
    """Lines of what was designed, for the terminal."""
    grids, chosen = design.scenarios, design.chosen
    outages = sum(each.line is not None for each in grids.all)
    drifts = len(grids.all) - outages - 1
    low, high = (f"{1e3 * design.delays[i]:.0f}" for i in (0, -1))
    yield f"devices {', '.join(design.task.case.run.devices)}; signals {', '.join(design.signals)}"
    yield f"scenarios: intact, {outages} of {grids.outages} outages, {drifts} drifts; delays {low} to {high} ms"
    if grids.impossible:
        yield f"  without a power flow: {', '.join(grids.impossible)}"
    yield "\nlaws, tuned for all scenarios and delays; index: mean over them, without control 1"
    rows = [
        [
            each.structure.name,
            "-" if not np.isfinite(each.judged.log_ratio) else f"{np.exp(each.judged.log_ratio):.3f}",
            "kept" if each.kept else f"violated by {each.violation:.2g}",
            "taken" if each is chosen else "",
        ]
        for each in design.results
    ]
    yield from ("  " + line for line in table(["law", "index", "demands", ""], rows, left=1, rule=False))
    yield from _certificate(design)


def _certificate(design: RobustDesign) -> Iterator[str]:
    worst = design.worst
    yield f"\ncertificate of {design.chosen.structure.name}, exact for frames, hold, delay and filters"
    yield (
        f"  least damping ratio {worst.damping:.4f} ({worst.hertz:.2f} Hz): {worst.scenario}, "
        f"{1e3 * worst.delay:.0f} ms; without control {worst.without:.4f}"
    )
    yield from (
        "  " + line for line in table(["scenario", "without", *_heads(design)], _worst_rows(design), rule=False)
    )
    for each in design.margins:
        low, high = each.gain
        yield (
            f"  margins, {each.scenario}: delay to {1e3 * each.delay:.0f} ms, gain {low:.2g} to {high:.3g}, "
            f"disc {each.disc:.2f}"
        )
    yield f"  noise of the PMUs moves setpoints by {100 * design.effort:.2g} % of their limits, rms"
    for name, devices in design.chosen.inverted.items():
        acting = ", ".join(design.task.case.run.devices[d] for d in devices)
        bad = min((row for row in design.rows if row.scenario == name), key=lambda row: row.damping)
        yield (
            f"  NOT COVERED: {name}, {acting} acts the other way round: damping ratio {bad.damping:.4f}, "
            f"without control {bad.without:.4f}; no law of one sign damps both"
        )
    for sentence in violations(design):
        yield f"  NOT KEPT: {sentence}"
    for check in design.checks:
        result = "synchronism lost" if check.ratio is None else f"index {check.ratio:.2f} of that without control"
        both = ", without control as well" if check.lost_without else ""
        yield f"  nonlinear run, {check.scenario}, {check.event}: {result}{both}"
    error = max(each.modal.error for each in design.scenarios.all)
    yield f"  not covered: other outages, outages of units, further drifts; modes left out change gains by {error:.1%}"


def _heads(design: RobustDesign) -> list[str]:
    return [f"{1e3 * delay:.0f} ms" for delay in design.delays]


def _worst_rows(design: RobustDesign) -> list[list[str]]:
    """Least damping ratios of the worst scenarios at all delays."""
    by_name: dict[str, list[Any]] = {}
    for row in design.counted:
        by_name.setdefault(row.scenario, []).append(row)
    names = sorted(by_name, key=lambda name: min(row.damping for row in by_name[name]))[:SHOWN]
    return [
        [name, f"{by_name[name][0].without:.4f}", *(f"{row.damping:.4f}" for row in by_name[name])] for name in names
    ]


def document(design: RobustDesign) -> dict[str, Any]:
    """The JSON of a robust design (docs/results_json.md)."""
    return {
        "devices": list(design.task.case.run.devices),
        "signals": design.signals,
        "delays_s": design.delays,
        "laws": [
            {
                "name": each.structure.name,
                "states": each.structure.states,
                "index": float(np.exp(each.judged.log_ratio)) if np.isfinite(each.judged.log_ratio) else None,
                "kept": each.kept,
                "taken": each is design.chosen,
            }
            for each in design.results
        ],
        "law": design.row,
        "scenarios": [row._asdict() for row in design.rows],
        "margins": [each._asdict() for each in design.margins],
        "inverted": design.chosen.inverted,
        "noise": design.effort,
        "checks": [each._asdict() for each in design.checks],
        "outages": design.scenarios.outages,
        "impossible": design.scenarios.impossible,
    }


def plot(design: RobustDesign, path: Path) -> Path:
    """A picture of the damping of each mode over all scenarios, without control and with the law at all delays."""
    figure = Figure(figsize=(8.0, 4.5), layout="constrained")
    axis: Any = figure.subplots()
    before = [pair for each in design.scenarios.all for pair in charted(np.r_[each.modal.values, each.modal.still])]
    after = [pair for row in design.counted for pair in row.modes]
    for pairs, colour, size, label in ((after, "C0", 10, "with the law"), (before, "C3", 14, "without control")):
        hertz, ratio = (np.array([pair[i] for pair in pairs]) for i in range(2))
        faces = colour if colour == "C0" else "none"
        axis.scatter(hertz, 100.0 * ratio, s=size, facecolors=faces, edgecolors=colour, linewidths=0.7, label=label)
    axis.axhline(0.0, color="0.4", linewidth=0.8)
    axis.set_xlabel("frequency [Hz]")
    axis.set_ylabel("damping ratio [%]")
    name, many = design.task.case.system.name, len(design.scenarios.all)
    axis.set_title(f"{name}: modes in {many} scenarios at {len(design.delays)} delays", fontsize=10)
    axis.legend(loc="best", fontsize=8)
    return save_picture(figure, path, dpi=130)


def write(design: RobustDesign, task: Task, run: GridRun, folder: Path) -> list[Path]:
    """Write the run, and the system if it is not one that GRID names."""
    case, row = design.task.case, design.row
    row["linear"] = {
        name: [[float(f"{x:.{DIGITS}g}") for x in line] for line in rows] for name, rows in row["linear"].items()
    }
    written, system = [], task.system
    if not run.named:
        system = "system.yaml"
        content = case.system.model_dump(by_alias=True, exclude_defaults=True)
        write_whole(folder / system, rows_text(content))
        written.append(folder / system)
    fields = {"description": run.content["description"], "system": system}
    if task.profile != DEFAULT_PROFILE:
        fields["profile"] = task.profile
    link = {"link": run.content["link"]} if isinstance(run.content["link"], dict) else {}
    content = {**fields, "scenario": [], "devices": list(case.run.devices), "controllers": [row], **link}
    write_whole(folder / "run.yaml", dump(content))
    return [*written, folder / "run.yaml"]
