"""The runs behind the tables: who is run on what, as studies that the sweep carries out."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from facts_damping.analysis.indices import THESIS_INDICES
from facts_damping.control.table import kind
from facts_damping.output.terminal import Progress
from facts_damping.parameters import files
from facts_damping.parameters.field_errors import check
from facts_damping.parameters.yaml_text import dump
from facts_damping_reproduction.agreement import ComparedRun, name
from facts_damping_reproduction.printed import LLC, ROUGHNESS, SCENARIOS, ControllerId
from facts_damping_studies.parameters import Study
from facts_damping_studies.search.structures import PORTS
from facts_damping_studies.sweeps import sweep
from facts_damping_studies.sweeps.enumerated_axes import NONE

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping, Sequence
    from pathlib import Path

    from facts_damping_reproduction.printed import Cell

    Row = dict[str, Any]
    More = Callable[[ControllerId], dict[str, Any]]  # fields of a run that differ for a controller

# Devices and signals of each; what takes fewer signals is given the first ones.
ARCHITECTURES = {
    architecture: (list(devices), PORTS[devices]) for architecture, devices in zip(("MISO", "MIMO"), PORTS, strict=True)
}
FILE = "run"  # in the place of an architecture: the controllers of a run file
NOBODY, TUNED, BOUND = (ControllerId("MISO", baseline, None) for baseline in (NONE, "LLC-tuned", "LQG"))
LINEAR = (LLC, TUNED, BOUND)
BASELINES = (NOBODY, *LINEAR)
FIGURES = (*THESIS_INDICES, ROUGHNESS)


def whos(cells: Iterable[Cell], system: str) -> list[ControllerId]:
    """The controllers behind the cells of a system, after the baselines that are always beside them."""
    system_cells = [cell for cell in cells if cell.system == system]
    asked = [who for cell in system_cells for who in (cell.who, cell.against) if who is not None]
    both = any(who.architecture == "MIMO" for who in asked)
    beside = [who._replace(architecture="MIMO") for who in LINEAR] if both else []
    return list(dict.fromkeys([*(BASELINES if system_cells else ()), *beside, *asked]))


def changes(who: ControllerId) -> dict[str, Any]:
    """The fields of a run that make it a controller's."""
    if who.architecture == FILE:
        content = files.read_table(files.find("runs", who.controller))
        return {field: content[field] for field in ("devices", "controllers") if field in content}
    devices, signals = ARCHITECTURES[who.architecture]
    if who.controller == NONE:
        return {"devices": devices, "controllers": []}
    row = {"name": who.controller, "devices": devices, "signals": signals[: kind(who.controller).signals]}
    return {"devices": devices, "controllers": [row if who.scheme is None else {**row, "scheme": who.scheme}]}


def nominal(
    system: str, asked: Sequence[ControllerId], more: More | None = None, *, check_step: bool = False, **fields: Any
) -> Study:
    """Every scenario of a system, as it is, with everybody; `fields` of the run differ, `more` for a controller.

    `check_step`: each also with half the integration step.
    """
    scenarios = {"field": "scenario", "values": list(SCENARIOS[system].values())}
    content = {"run": {"system": system}, "set": fields, "sweep": [scenarios, _everybody(asked, more)], "modes": False}
    return check(Study, {**content, "check_step": check_step}, f"reproduce {system}")


def ensemble(
    system: str, scenario: str, asked: Sequence[ControllerId], draws: int | None = None, **fields: Any
) -> Study:
    """The ensemble of a scenario (config/studies) with everybody; `draws`: how many, none: as in the file."""
    return shipped(f"ensemble_{system}_{scenario}", _everybody(asked, None), draws, fields)


def shipped(
    run_name: str,
    everybody: dict[str, Any],
    draws: int | None = None,
    fields: Mapping[str, Any] | None = None,
    **more: Any,
) -> Study:
    """A shipped study with the axis of everybody behind its own.

    `draws`: how many, none: as in its file; `fields` of the run and `more` of the study differ.
    """
    path = files.find("studies", run_name)
    content = files.read_table(path)
    drawn = next(axis["draws"] for axis in content["sweep"] if "draws" in axis)
    drawn["number"] = draws or drawn["number"]
    content |= {"set": {**content.get("set", {}), **(fields or {})}, "sweep": [*content["sweep"], everybody], **more}
    return check(Study, content, str(path))


def _everybody(asked: Sequence[ControllerId], more: More | None) -> dict[str, Any]:
    """The axis of controllers."""
    rows = [{**changes(who), **(more(who) if more else {})} for who in asked]
    return {"name": "who", "labels": [name(who) for who in asked], "rows": rows}


def carry_out(study: Study, title: str, folder: Path, jobs: int) -> list[Row]:
    """The rows of a study; what its journal in the folder holds is not run again."""
    plan = sweep.planned(study, title, title, dump(study.model_dump(exclude_defaults=True)))
    progress = Progress(title, "runs")
    try:
        states = sweep.run(plan, folder / f"{title}-{plan.fingerprint[:12]}", jobs, None, progress)
    finally:
        progress.close()
    return [row.cells for row in sweep.rows(states)]


def figures(rows: Iterable[Row], asked: Sequence[ControllerId]) -> dict[ComparedRun, dict[str, float] | None]:
    """Indices and roughness of each run of a system; none where it lost synchronism."""
    by_name = {name(who): who for who in asked}
    return {
        ComparedRun(row["system"], row["scenario"], by_name[row["who"]]): {figure: row[figure] for figure in FIGURES}
        if row["error"] is None and row["stable"]
        else None
        for row in rows
    }


def not_converged(rows: Iterable[Row], asked: Sequence[ControllerId]) -> set[ComparedRun]:
    """The runs of a system whose figures half the integration step changes."""
    by_name = {name(who): who for who in asked}
    return {
        ComparedRun(row["system"], row["scenario"], by_name[row["who"]])
        for row in rows
        if row.get("converged") is False
    }


def reached(
    run_figures: Mapping[ComparedRun, Mapping[str, float] | None], run: ComparedRun, index: str
) -> float | None:
    """How much of the way from LLC to the bound a controller's index has come, %: 100 (LLC - own) / (LLC - bound)."""
    candidate, llc, bound = (run_figures.get(run._replace(who=who)) for who in (run.who, LLC, BOUND))
    if candidate is None or llc is None or bound is None or llc[index] == bound[index]:
        return None
    return 100 * (llc[index] - candidate[index]) / (llc[index] - bound[index])
