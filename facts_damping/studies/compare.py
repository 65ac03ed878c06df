"""The comparison of controllers: every scenario of a system with each of them, in process."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Any

from facts_damping import files, loop
from facts_damping.analysis.summary import summarise
from facts_damping.configuration import load_case, tuned
from facts_damping.studies.pool import run_all
from facts_damping.studies.tune import SCENARIO, Scheme, rows

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

# Columns of the table: title, path into a row, format.
COLUMNS = (
    ("damped", ("damped",), ""),
    ("ITAE", ("indices", "ITAE"), ".4g"),
    ("IAE", ("indices", "IAE"), ".4g"),
    ("ITSE", ("indices", "ITSE"), ".4g"),
    ("ISE", ("indices", "ISE"), ".4g"),
    ("smoothness", ("smoothness",), ".4g"),
    ("settling [s]", ("settling_time_s",), ".2f"),
    ("max v [p.u.]", ("max_injected_voltage_pu",), ".4f"),
)
NONE = "none"
BARE = ("scenario=[]", "controllers.0.name=ANFTSC")  # a run whose signals and devices may be asked for
SYSTEMS = ("two_area", "smib")


def contenders(system: str, names: Sequence[str], sets: Sequence[str] = ()) -> list[tuple[str, Scheme]]:
    """No control, LLC and LLC-tuned, and every controller and scheme asked for (no names: all).

    LLC-tuned is left out where it is not tuned for the signals and devices that `sets` say.
    """
    own = load_case(None, [f"system={system}", *BARE, *everybody(sets)]).run.controllers[0]
    others = [name for name in names if name not in (NONE, "LLC")]
    asked = rows(others) if others or not names else []
    plain: list[tuple[str, Scheme]] = [(NONE, None), ("LLC", None)]
    known = ("LLC-tuned", None) in tuned(system, own.signals[:1], own.devices)
    return plain + [one for one in asked if one not in plain and (one[0] != "LLC-tuned" or known)]


def scenarios(system: str) -> list[str]:
    """The scenarios of a system that are judged: all but the one for training."""
    found = [name.removeprefix(f"{system}/") for name in files.shipped("scenarios") if name.startswith(f"{system}/")]
    return [name for name in found if name != SCENARIO]


def everybody(sets: Sequence[str]) -> list[str]:
    """The changes that hold for all controllers: devices and signals."""
    return [text for text in sets if text.startswith(("devices=", "controllers.0.signals=", "controllers.0.devices="))]


def one_run(system: str, sets: Sequence[str], what: tuple[str, str, str | None]) -> dict[str, Any]:
    """The figures of one run; `what`: scenario, controller, scheme.

    Changes of `controllers` are for networks alone, but for signals and devices.
    """
    scenario, name, scheme = what
    if scheme is None:
        plain = [text for text in sets if not text.startswith("controllers.")]
        own = load_case(None, [f"system={system}", *BARE, *everybody(sets)]).run.controllers[0]
        more = [f"controllers.0.signals={own.signals[:1]}", f"controllers.0.devices={own.devices}"]
        sets = [*plain, *(more if name != NONE else [])]  # a lead-lag takes the first signal
    controllers = ["controllers=[]"] if name == NONE else [f"controllers.0.name={name}"]
    if scheme is not None:
        controllers.append(f"controllers.0.scheme={scheme}")
    case = load_case(None, [f"system={system}", f"scenario={scenario}", *controllers, *sets])
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
    todo = [(s, *one) for s in scenarios(system) for one in contenders(system, names, sets)]
    return run_all(partial(one_run, system, list(sets)), todo, jobs, progress)


def page(found: Sequence[dict[str, Any]]) -> list[str]:
    """The page of a comparison."""
    return [
        "# Comparison of the controllers",
        "",
        "Made by `facts-damping compare --out docs/comparison.md`, as it came out; parameters: `config/controllers`,",
        "chosen on the scenarios `training` alone (docs/controllers.md). Indices are those of (4.108) from t = 0;",
        "`smoothness` is (5.34) over dt^2. A row that says no or names an instability is one that fails.",
        "",
        *text(found),
    ]


def text(found: Sequence[dict[str, Any]]) -> list[str]:
    """Tables in Markdown, one a scenario."""
    lines = []
    for system, scenario in dict.fromkeys((row["system"], row["scenario"]) for row in found):
        own = [row for row in found if (row["system"], row["scenario"]) == (system, scenario)]
        titles = ["controller", "scheme", *(title for title, _, _ in COLUMNS)]
        lines += [f"### {system}, {scenario}", "", line(titles), line(["---"] * 2 + ["--:"] * len(COLUMNS))]
        lines += [line([row["controller"], row["scheme"] or "", *_cells(row)]) for row in own]
        lines.append("")
    return lines


def _cells(row: dict[str, Any]) -> list[str]:
    if not row["stable"]:
        return [str(row["instability"]), *[""] * (len(COLUMNS) - 1)]
    return [_cell(row, path, form) for _, path, form in COLUMNS]


def _cell(row: dict[str, Any], path: Sequence[str], form: str) -> str:
    value: Any = row
    for key in path:
        value = value[key]
    if value is None:
        return "-"
    return ("yes" if value else "no") if isinstance(value, bool) else format(value, form)


def line(cells: Sequence[str]) -> str:
    """A row of a table in Markdown."""
    return f"| {' | '.join(cells)} |"
