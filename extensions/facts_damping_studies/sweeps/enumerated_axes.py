"""Axes over `every`: all scenarios of a system, or all controllers of the table, as rows."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from facts_damping.case.tuned import tuned
from facts_damping.control.table import CONTROLLERS, kind
from facts_damping.errors import InputError
from facts_damping.parameters import files
from facts_damping_studies.parameters import Axis, Study
from facts_damping_studies.sweeps.batch import CUSTOM, Base, make, names

if TYPE_CHECKING:
    from collections.abc import Sequence

    from facts_damping.case.model import Case

Scheme = Literal["direct", "indirect"] | None  # of a controller; None: it has no scheme
SCENARIO = "training"  # scenario for tuning and choosing controllers
NONE = "none"
ANY = "ANFTSC"  # accepts any signals and devices
RESTS_ON = ("system", "devices", "profile")  # fields of a run that determine the available scenarios and controllers
COLUMNS = {"scenario": "scenario", "controller": "kind", "network": "kind"}  # column of an axis without a name


def expand_axis(study: Study, base: Base) -> Study:
    """Expand each axis over `every` into rows. Raises `InputError` if another axis sets a field of `RESTS_ON`."""
    asked = [axis.every for axis in study.sweep if axis.every is not None]
    if not asked:
        return study
    for path in (path for axis in study.sweep for row in axis.rows or [axis.factors] for path in row):
        if path in RESTS_ON:
            raise InputError(f"sweep: '{path}' beside an axis over every {asked[0]}; allowed: --set {path}=...")
    case = make(base, {"scenario": [], "controllers.*.name": ANY})
    system = names(base, {}).system
    if system == CUSTOM:
        raise InputError(f"sweep: a system inline beside an axis over every {asked[0]}; allowed: a name, or a file")
    return study.model_copy(update={"sweep": [_rows(axis, system, case) for axis in study.sweep]})


def _rows(axis: Axis, system: str, case: Case) -> Axis:
    """Expand an axis over `every` into rows with labels; return any other axis unchanged."""
    if axis.every is None:
        return axis
    if axis.every == "scenario":
        rows = {name: {"scenario": name} for name in scenarios(system)}
    else:
        rows = candidates(system, case) if axis.every == "controller" else networks()
    return Axis(name=axis.name or COLUMNS[axis.every], labels=list(rows), rows=list(rows.values()))


def scenarios(system: str) -> list[str]:
    """The evaluation scenarios of a system: all except the training scenario.

    For a system given by path, they are the files in its folder that have `events`.
    """
    path, known = files.find("systems", system), files.shipped("scenarios")
    scenario_names = [name.removeprefix(f"{system}/") for name in known if name.startswith(f"{system}/")]
    if path not in files.shipped("systems").values():
        beside = sorted(file for file in path.parent.iterdir() if file.suffix in (".yaml", ".yml"))
        scenario_names = [str(file) for file in beside if file != path and _is_scenario(file)]
    judged = [name for name in scenario_names if Path(name).stem != SCENARIO]
    if not judged:
        raise InputError(f"sweep: no scenario for {system}; allowed: a system with scenarios, or files beside its own")
    return judged


def _is_scenario(path: Path) -> bool:
    """Whether a file has events; not if it is unreadable."""
    try:
        return "events" in files.read_table(path)
    except InputError:
        return False


def candidates(system: str, case: Case) -> dict[str, dict[str, Any]]:
    """Fields of a run by name: for no control, and for each controller of the table in each scheme.

    Each controller takes as many signals as it can. LLC-tuned is left out if it is not tuned for them.
    """
    first = case.run.controllers[0]
    known = ("LLC-tuned", None) in tuned(system, first.signals[:1], first.devices, profile=case.run.tuning)
    fields_by_label: dict[str, dict[str, Any]] = {NONE: {"controllers": []}}
    for label, fields in _named(
        [controller_name for controller_name in CONTROLLERS if controller_name != "LLC-tuned" or known]
    ).items():
        maximum = kind(fields["controllers.*.name"]).signals
        signals = {f"controllers.{i}.signals": controller.signals for i, controller in enumerate(case.run.controllers)}
        fields_by_label[label] = fields | {
            path: signal_names[:maximum] for path, signal_names in signals.items() if len(signal_names) > maximum
        }
    return fields_by_label


def networks() -> dict[str, dict[str, Any]]:
    """The neuro-fuzzy controllers of the table in both schemes, in the form of `candidates`."""
    return _named([name for name, row in CONTROLLERS.items() if row.network])


def _named(controller_names: list[str]) -> dict[str, dict[str, Any]]:
    """Name and scheme of all controllers of a run, by a label, for each scheme of these kinds."""
    return {
        f"{name} {scheme}" if scheme else name: {"controllers.*.name": name}
        | ({"controllers.*.scheme": scheme} if scheme else {})
        for name, scheme in every_scheme(controller_names)
    }


def every_scheme(controller_names: Sequence[str]) -> list[tuple[str, Scheme]]:
    """Controllers with their schemes: networks in both, a lead-lag without one."""
    schemes: dict[bool, tuple[Scheme, ...]] = {True: ("direct", "indirect"), False: (None,)}
    return [
        (name, scheme) for name in controller_names for scheme in schemes[kind(name, "CONTROLLER").network is not None]
    ]
