"""The comparison of controllers: every scenario of a system with each of them, in process."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Any

from facts_damping.analysis.indices import INDICES
from facts_damping.analysis.summary import summarise
from facts_damping.case.controllers import tuned
from facts_damping.case.loading import load_case
from facts_damping.control.table import kind
from facts_damping.parameters import files
from facts_damping.simulation import loop
from facts_damping.studies.pages import at
from facts_damping.studies.pool import run_all
from facts_damping.studies.tune import SCENARIO, Scheme, rows
from facts_damping.terminal import table

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from facts_damping.parameters.run import Controller

# Columns of the table: title, path into a row, format.
COLUMNS = (
    ("damped", ("damped",), ""),
    *((name, ("indices", name), ".4g") for name in INDICES),
    ("smoothness", ("smoothness",), ".4g"),
    ("settling [s]", ("settling_time_s",), ".2f"),
    ("max v [p.u.]", ("max_injected_voltage_pu",), ".4f"),
)
NONE = "none"
BARE = ("scenario=[]", "controllers.0.name=ANFTSC")  # a run whose signals and devices may be asked for
SYSTEMS = ("two_area", "smib")


def contenders(system: str, names: Sequence[str], own: Controller) -> list[tuple[str, Scheme]]:
    """No control, LLC and LLC-tuned, and every controller and scheme asked for (no names: all).

    LLC-tuned is left out where it is not tuned for the signals and devices of `own`.
    """
    others = [name for name in names if name not in (NONE, "LLC")]
    asked = rows(others) if others or not names else []
    plain: list[tuple[str, Scheme]] = [(NONE, None), ("LLC", None)]
    known = ("LLC-tuned", None) in tuned(system, own.signals[:1], own.devices)
    return plain + [one for one in asked if one not in plain and (one[0] != "LLC-tuned" or known)]


def scenarios(system: str) -> list[str]:
    """The scenarios of a system that are judged: all but the one for training."""
    found = [name.removeprefix(f"{system}/") for name in files.shipped("scenarios") if name.startswith(f"{system}/")]
    return [name for name in found if name != SCENARIO]


def everybody(system: str, sets: Sequence[str]) -> Controller:
    """A controller with the signals and devices that changes of a run give to all controllers."""
    kept = ("devices=", "controllers.0.signals=", "controllers.0.devices=")
    return load_case(None, [f"system={system}", *BARE, *(s for s in sets if s.startswith(kept))]).run.controllers[0]


def changes(sets: Sequence[str], own: Controller, name: str, scheme: Scheme) -> list[str]:
    """The changes that make a run one of a contender.

    Those of `controllers` are for networks alone, but for signals and devices, of which each takes as many as it can.
    """
    if scheme is not None:
        return [f"controllers.0.name={name}", f"controllers.0.scheme={scheme}", *sets]
    plain = [text for text in sets if not text.startswith("controllers.")]
    if name == NONE:
        return ["controllers=[]", *plain]
    given = [f"controllers.0.signals={own.signals[: kind(name).signals]}", f"controllers.0.devices={own.devices}"]
    return [f"controllers.0.name={name}", *plain, *given]


def one_run(system: str, sets: Sequence[str], own: Controller, what: tuple[str, str, Scheme]) -> dict[str, Any]:
    """The figures of one run; `what`: scenario, controller, scheme."""
    scenario, name, scheme = what
    case = load_case(None, [f"system={system}", f"scenario={scenario}", *changes(sets, own, name, scheme)])
    result = summarise(loop.run(case))
    keep = ("stable", "instability", "damped", "indices", "smoothness", "settling_time_s", "max_injected_voltage_pu")
    return {
        "system": system,
        "scenario": scenario,
        "controller": name,
        "scheme": scheme,
        **{key: result[key] for key in keep},
    }


def compare(
    system: str, names: Sequence[str], sets: Sequence[str], jobs: int, progress: Callable[[int, int], None]
) -> list[dict[str, Any]]:
    """A row for each scenario and contender, in this order."""
    files.find("systems", system)
    own = everybody(system, sets)
    asked = contenders(system, names, own)
    todo = [(scenario, *one) for scenario in scenarios(system) for one in asked]
    return run_all(partial(one_run, system, list(sets), own), todo, jobs, progress)


def page(found: Sequence[dict[str, Any]]) -> list[str]:
    """The page of a comparison."""
    return [
        "# Comparison of the controllers",
        "",
        "Made by `facts-damping compare --out docs/comparison.md`, as it came out; parameters: `config/controllers`,",
        "chosen on the scenarios `training` alone (docs/controllers.md). Indices are those of (4.108) from t = 0;",
        "`smoothness` is (5.34) over dt^2. A row that says no or names an instability is one that fails.",
        "",
        *comparison_tables(found),
    ]


def comparison_tables(found: Sequence[dict[str, Any]]) -> list[str]:
    """Tables in Markdown, one a scenario."""
    lines = []
    for system, scenario in dict.fromkeys((row["system"], row["scenario"]) for row in found):
        own = [row for row in found if (row["system"], row["scenario"]) == (system, scenario)]
        cells = [[row["controller"], row["scheme"] or "", *_cells(row)] for row in own]
        titles = ["controller", "scheme", *(title for title, _, _ in COLUMNS)]
        lines += [f"### {system}, {scenario}", "", *table(titles, cells, left=2, markdown=True), ""]
    return lines


def _cells(row: dict[str, Any]) -> list[str]:
    if not row["stable"]:
        return [str(row["instability"]), *[""] * (len(COLUMNS) - 1)]
    return [_cell(at(row, path), form) for _, path, form in COLUMNS]


def _cell(value: Any, form: str) -> str:
    if value is None:
        return "-"
    return ("yes" if value else "no") if isinstance(value, bool) else format(value, form)
