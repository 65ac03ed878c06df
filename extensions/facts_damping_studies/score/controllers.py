"""What is scored: rows of controllers from what a user names."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from facts_damping.case.loading import read_run
from facts_damping.control.table import CONTROLLERS
from facts_damping.errors import InputError
from facts_damping.parameters.files import read_table, shipped

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from facts_damping_studies.score.cases.sets import Set

LINEAR = (".npz", ".mat")
LAWS = ("A", "num", "zeros")  # keys of a YAML file with a linear law
KEPT = ("link", "namespace")  # fields of a run's controllers that belong to its deployment


def candidates(case_set: Set, controller: Any, against: Sequence[str] | None) -> dict[str, list[dict[str, Any]]]:
    """Name: rows, of what is given and of those beside it, by default the set's; None given: all of the set.

    Raises `InputError`.
    """
    if controller is None:
        if against is not None:
            raise InputError("--against: given without CONTROLLER; allowed: beside one")
        return case_set.content.controllers
    known = case_set.content.controllers
    others = [controllers_of(other, "--against", known) for other in against or known]
    return dict([controllers_of(controller, known=known), *others])


def controllers_of(
    controller: Any, where: str = "CONTROLLER", known: Mapping[str, list[dict[str, Any]]] | None = None
) -> tuple[str, list[dict[str, Any]]]:
    """Name, and rows of controllers, of what is given: text, a row, or a list of rows.

    Text may be a name in `known`, in `facts-damping list controllers` or of a run, `module:Class` or `file.py:Class`, a
    run file, an FMU, or a linear law. `where`: the argument, for errors. Raises `InputError`.
    """
    if isinstance(controller, dict):
        return str(controller.get("name", "controller")), [controller]
    if not isinstance(controller, str):
        return " + ".join(str(row.get("name", "controller")) for row in controller), list(controller)
    if controller in (known or {}):
        return controller, (known or {})[controller]
    if controller in CONTROLLERS:
        return controller, [{"name": controller}]
    return controller, _of_text(controller, where)


def _of_text(text: str, where: str) -> list[dict[str, Any]]:
    path = Path(text)
    if ":" in text and not path.exists():
        return [{"name": text.rpartition(":")[2], "policy": text}]
    if path.suffix == ".fmu":
        return [{"name": path.stem, "fmu": text}]
    if path.suffix in LINEAR or (path.suffix in (".yaml", ".yml") and path.is_file() and _is_law(path)):
        return [{"name": path.stem, "linear": text}]
    if path.suffix not in (".yaml", ".yml") and text not in shipped("runs"):
        allowed = "a controller, module:Class, file.py:Class, a run, an .fmu, .npz or .mat file"
        raise InputError(f"{where}: '{text}' given; allowed: {allowed}")
    content, source = read_run(text)
    rows = content.get("controllers") or []
    if not rows:
        raise InputError(f"{source}: no controllers; allowed: a run with controllers")
    return [{name: value for name, value in row.items() if name not in KEPT} for row in rows]


def _is_law(path: Path) -> bool:
    return any(name in read_table(path) for name in LAWS)
