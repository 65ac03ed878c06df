"""Pictures of single points of a study; the runs are repeated for them."""

from __future__ import annotations

import re
from functools import partial
from typing import TYPE_CHECKING, Any

from facts_damping.errors import FactsDampingError
from facts_damping.studies.sweeps import jacobians, portraits
from facts_damping.studies.sweeps.batch import Base, make, names
from facts_damping.studies.sweeps.enumerated_axes import candidates
from facts_damping.studies.sweeps.pool import run_all
from facts_damping.terminal import Progress

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from facts_damping.studies.sweeps.axes import Point
    from facts_damping.studies.sweeps.sweep import Plan

HORIZON = 10  # frames, for a picture of a Jacobian if the study sets none


def draw(plan: Plan, folder: Path, jobs: int) -> list[Path]:
    """Draw all pictures of all feasible points, named by the swept values: `jacobian_large_ANFTSC.png`."""
    todo = [(kind, point) for point in plan.points for kind in plan.study.pictures]
    if not todo:
        return []
    progress = Progress("pictures", "pictures")
    try:
        drawn = run_all(partial(_one, plan.base, folder), todo, jobs, progress)
    finally:
        progress.close()
    return [path for path in drawn if path is not None]


def _one(base: Base, folder: Path, what: tuple[str, Point]) -> Path | None:
    kind, point = what
    told = "_".join([kind, *(str(value) for value in point.columns.values())])
    path = folder / f"{re.sub('[^A-Za-z0-9.+-]+', '_', told)}.png"
    try:
        DRAWN[kind](base, point.changes, path)
    except FactsDampingError:  # the row of this run has the reason
        return None
    return path


def _jacobian(base: Base, changes: dict[str, Any], path: Path) -> None:
    jacobians.draw(make(base, changes), base.jacobian or HORIZON, path)


def _portrait(base: Base, changes: dict[str, Any], path: Path) -> None:
    """Draw a portrait beside the available baselines: the run without control and the lead-lags."""
    case = make(base, changes)
    others = candidates(names(base, changes)["system"], case)
    own: dict[str, Any] = {"controllers.*.scheme": None, "controllers.*.parameters": {}}
    beside = {name: make(base, {**changes, **own, **others[name]}) for name in portraits.BASELINES if name in others}
    portraits.draw(case, beside, path)


DRAWN: dict[str, Callable[[Base, dict[str, Any], Path], None]] = {"jacobian": _jacobian, "portrait": _portrait}
