"""The grids of the study, and their modes over share, place and kind of inverters, and over their constants."""

from __future__ import annotations

from copy import deepcopy
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import yaml

from facts_damping.case.changes import as_sets, change
from facts_damping.case.loading import changed_case
from facts_damping.errors import InputError
from facts_damping.small_signal.modal_tables import Modal, analyse

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from facts_damping.case.model import Case
    from facts_damping.small_signal.eigenmodes import Eigenmode

Rows = list[dict[str, Any]]
PLAN = Path(__file__).with_name("inverters.yaml")
SSSC = "sssc"  # in the tie in all runs
STILL = 1e-2  # 1/s: angles and speeds that all have in common, and round-off


@cache
def plan() -> dict[str, Any]:
    """The plan."""
    content: dict[str, Any] = yaml.safe_load(PLAN.read_text(encoding="utf-8"))
    return content


def grid(kind: str, share: float, place: Sequence[int] = (1, 1)) -> dict[str, Any]:
    """Fields of a grid whose areas have a share of inverters of a kind; `place`: 1 for each area that has."""
    rows = zip(plan()["kinds"][kind], place, strict=True)
    replaced = {f"system.inverter_shares.{row}.share": float(share * there) for row, there in rows}
    return {"system.inverter_shares.*.share": 0.0, **replaced}


def made(sets: dict[str, Any], rows: Sequence[dict[str, Any]] = (), devices: Sequence[str] = ()) -> Case:
    """A case with fields set, controllers, and devices beside the SSSC."""
    common = {**plan()["set"], "devices": [SSSC, *(name for name in devices if name != SSSC)]}
    content: dict[str, Any] = {"controllers": deepcopy(list(rows))}
    change(content, common, as_sets(common))
    return changed_case(content, "inverters", sets)


def interarea(modes: Iterable[Eigenmode]) -> Eigenmode | None:
    """The least damped interarea mode; none where all inertia is in one area."""
    return min((m for m in modes if m.label == "interarea"), key=lambda m: m.damping_ratio, default=None)


def modal(sets: dict[str, Any]) -> Modal:
    """The modes of a grid without control."""
    case = made({**sets, "scenario": []})
    return analyse(case.system, case.run.devices)


def _figures(sets: dict[str, Any]) -> dict[str, Any]:
    """Interarea mode, least damped swing in the band, and the fastest growth; nothing without a source of an angle."""
    low, high = plan()["modes"]["band"]
    try:
        modes = modal(sets).modes
    except InputError:
        return dict.fromkeys(("interarea", "interarea_hz", "least", "least_hz", "growth", "growth_hz"))
    between = interarea(modes)
    swings = [m for m in modes if m.swings and low <= m.frequency_hz <= high]
    least = min(swings, key=lambda m: m.damping_ratio, default=None)
    fastest = max((m for m in modes if abs(m.eigenvalue) > STILL), key=lambda m: m.eigenvalue.real)
    return {
        "interarea": between and between.damping_ratio,
        "interarea_hz": between and between.frequency_hz,
        "least": least and least.damping_ratio,
        "least_hz": least and least.frequency_hz,
        "growth": float(fastest.eigenvalue.real),
        "growth_hz": fastest.frequency_hz,
    }


def modes() -> Rows:
    """Modes over share, place and kind, with stabilisers and without."""
    asked = plan()["modes"]
    return [
        {
            "stabilisers": name,
            "kind": kind,
            "place": place,
            "share": share,
            **_figures({**grid(kind, share, at), **off}),
        }
        for name, off in asked["stabilisers"].items()
        for kind in plan()["kinds"]
        for place, at in asked["places"].items()
        for share in asked["shares"]
    ]


def constants() -> Rows:
    """Modes over the constants of inverters that form the grid, one after the other, in half of both areas."""
    return [
        {
            "kind": kind,
            "constant": name,
            "value": value,
            **_figures({**grid(kind, plan()["share"]), **_each(kind, name, value)}),
        }
        for kind, tables in plan()["constants"].items()
        for name, values in tables["inverter"].items()
        for value in values
    ]


def _each(kind: str, name: str, value: float) -> dict[str, Any]:
    return {f"system.inverter_shares.{row}.inverter.{name}": value for row in plan()["kinds"][kind]}
