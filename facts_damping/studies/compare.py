"""The comparison of controllers as a study: every scenario of some systems with every controller of the table."""

from __future__ import annotations

import re
from itertools import product
from typing import TYPE_CHECKING, Any

from facts_damping.analysis.indices import INDICES
from facts_damping.case.controllers import tuned
from facts_damping.case.loading import load_case
from facts_damping.control.table import CONTROLLERS, kind
from facts_damping.errors import InputError
from facts_damping.parameters import files
from facts_damping.parameters.files import parse_set, read_value
from facts_damping.parameters.study import Axis, Study, Tables
from facts_damping.parameters.yaml_text import dump
from facts_damping.studies import sweep
from facts_damping.studies.tune import SCENARIO, Scheme, every_scheme

if TYPE_CHECKING:
    from collections.abc import Sequence

    from facts_damping.parameters.run import Controller

SYSTEMS = ("two_area", "smib")
NONE = "none"
TABLES = Tables(figures=["verdict", *INDICES, "smoothness", "settling_time_s", "max_injected_voltage_pu"])
BARE = ("scenario=[]", "controllers.0.name=ANFTSC")  # a run whose signals and devices may be asked for
OF_ALL = re.compile(r"profile=|devices=|controllers\.(0|\*)\.(signals|devices)=")  # not of networks alone


def plan(systems: Sequence[str], names: Sequence[str], sets: Sequence[str], *, check_step: bool = False) -> sweep.Plan:
    """The study of these systems (none: `SYSTEMS`) and controllers (none: all), with `--set` for all runs.

    What it says below `controllers` is for networks alone, but for signals and devices: of them each controller takes
    as many as it can. `check_step`: each also with half the integration step.
    """
    for text in sets:
        if text.startswith("controllers="):
            raise InputError(f"--set {text}: given; allowed: fields below controllers.0, for every controller compared")
    rows: list[dict[str, Any]] = []
    labels: list[str | int | float] = []
    for system in systems or SYSTEMS:
        for scenario, (label, row) in product(scenarios(system), contenders(system, names, sets).items()):
            rows.append({"system": system, "scenario": scenario, **row})
            labels.append(f"{system} {scenario} {label}")
    axis = Axis(name="run", labels=labels, rows=rows)
    description = "every scenario with every controller"
    study = Study(description=description, sweep=[axis], tables=TABLES, check_step=check_step)
    common = [text for text in sets if not text.startswith("controllers.")]
    return sweep.planned(study, "comparison", "compare", dump(study.model_dump(exclude_defaults=True)), common)


def scenarios(system: str) -> list[str]:
    """The scenarios of a system that are judged: all but the one for training."""
    files.find("systems", system)
    found = [name.removeprefix(f"{system}/") for name in files.shipped("scenarios") if name.startswith(f"{system}/")]
    return [name for name in found if name != SCENARIO]


def contenders(system: str, names: Sequence[str], sets: Sequence[str]) -> dict[str, dict[str, Any]]:
    """What makes a run one of no control, of LLC, of each controller and scheme asked for: fields of the run, by name.

    LLC-tuned is left out where it is not tuned for the signals and devices that all are given.
    """
    given = [text for text in sets if OF_ALL.match(text)]
    case = load_case(None, [f"system={system}", *BARE, *given])
    own = case.run.controllers[0]
    known = ("LLC-tuned", None) in tuned(system, own.signals[:1], own.devices, profile=case.run.tuning)
    asked = every_scheme([name for name in names or CONTROLLERS if name != NONE])
    kept = [one for one in asked if one[0] != "LLC" and (one[0] != "LLC-tuned" or known)]
    pairs = [parse_set(text) for text in sets if text.startswith("controllers.") and not OF_ALL.match(text)]
    changes = {key: read_value(value, f"--set {key}={value}") for key, value in pairs}
    rows: dict[str, dict[str, Any]] = {NONE: {"controllers": []}}
    for name, scheme in [("LLC", None), *kept]:
        label = f"{name} {scheme}" if scheme else name
        rows[label] = {"controllers": [_controller(name, scheme, own)], **(changes if scheme else {})}
    return rows


def _controller(name: str, scheme: Scheme, own: Controller) -> dict[str, Any]:
    found = {"name": name, "signals": own.signals[: kind(name).signals], "devices": own.devices}
    return found if scheme is None else {**found, "scheme": scheme}
