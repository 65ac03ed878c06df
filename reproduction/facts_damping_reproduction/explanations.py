"""Why orders differ: the tables once more with one thing changed, each a run that anybody can repeat.

What the thesis leaves open, what it says otherwise than we do, and what our search of parameters adds.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from facts_damping.case.tuned import tuned
from facts_damping.neurofuzzy.table import VARIANTS, has_dilation
from facts_damping_reproduction import agreement, ranking
from facts_damping_reproduction.printed import SCENARIOS
from facts_damping_reproduction.runs import ARCHITECTURES

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

    from facts_damping.control.parameter_tables import Value
    from facts_damping_reproduction.agreement import Figures
    from facts_damping_reproduction.printed import Cell, ControllerId
    from facts_damping_reproduction.ranking import Ranking

    More = Callable[[str, ControllerId], dict[str, Any]]

PARAMETERS = "controllers.0.parameters"
GUARDS_OFF = {"controllers.0.profile": "thesis", f"{PARAMETERS}.leakage": 0.0}
INTERPOLATED = {"ANFBsC": "b-spline-interpolated+singleton", "HBsWC": "b-spline-interpolated+morlet"}


class Variant(NamedTuple):
    """A set-up that differs in one thing: what it is, fields of the run, and those of networks by system."""

    name: str
    what: str
    fields: dict[str, Any]
    more: More | None = None
    systems: tuple[str, ...] = tuple(SCENARIOS)


class Told(NamedTuple):
    """How a variant agrees with a table of improvements."""

    variant: str
    table: str
    signs: float  # fraction of the improvements with the thesis's sign
    rho: float | None  # mean rank correlation with the thesis
    rho_own: float | None  # the same with our own orders in the set-up of the tables
    same_best: int
    rankings: int
    unstable: int  # runs without figures


def _networks(fields: dict[str, Any]) -> More:
    """Fields for every network; for lead-lags nothing."""

    def more(_: str, who: ControllerId) -> dict[str, Any]:
        return fields if who.scheme else {}

    return more


def _off(_: str, who: ControllerId) -> dict[str, Any]:
    """All guards off, those too that the search has chosen."""
    if not who.scheme:
        return {}
    return {**GUARDS_OFF, **({f"{PARAMETERS}.identifier_leakage": 0.0} if who.scheme == "indirect" else {})}


def _untuned(_: str, who: ControllerId) -> dict[str, Any]:
    """The pair without its name, for which nothing was searched: all start alike."""
    if not who.scheme:
        return {}
    network = VARIANTS[who.controller]
    return {"controllers.0.name": f"{network.antecedent}+{network.consequent}"}


def _untuned_wide(system: str, who: ControllerId) -> dict[str, Any]:
    """The same with wavelets so wide that they keep their sign over the inputs' range."""
    wavelet = who.scheme and has_dilation(VARIANTS[who.controller].consequent)
    return {**_untuned(system, who), **({f"{PARAMETERS}.dilation": 5.0} if wavelet else {})}


def _searched(system: str, who: ControllerId) -> dict[str, Value]:
    """The parameters that the search has chosen for a controller."""
    devices, signals = ARCHITECTURES[who.architecture]
    return tuned(system, signals, devices)[who.controller, who.scheme].parameters


def _interpolated(system: str, who: ControllerId) -> dict[str, Any]:
    """B-splines as curves, with the parameters that were searched for the nearest control point."""
    if who.controller not in INTERPOLATED:
        return {}
    return {"controllers.0.name": INTERPOLATED[who.controller], PARAMETERS: _searched(system, who)}


def _gain(factor: float) -> More:
    """Input scales divided by a factor: so many times the gain for small signals."""

    def more(system: str, who: ControllerId) -> dict[str, Any]:
        if not who.scheme:
            return {}
        parameters = _searched(system, who)
        return {f"{PARAMETERS}.{name}": _divided(parameters[name], factor) for name in ("scale", "change_scale")}

    return more


def _divided(value: Value, by: float) -> Value:
    return [number / by for number in value] if isinstance(value, list) else float(value) / by


BASE = "as searched"
TABLE = (
    Variant(BASE, "the set-up of the tables", {}),
    Variant("equal start", "no search: every network starts from the same defaults", {}, _untuned),
    Variant("equal start, wide wavelets", "the same, dilation 5", {}, _untuned_wide),
    Variant("no adaptation", "eta 0: networks as they start", {}, _networks({f"{PARAMETERS}.eta": 0.0})),
    Variant("guards off", "as the thesis has it: no leakage, projection, clip, anti-windup", {}, _off),
    Variant(
        "rates by group",
        "best rate (4.39) of each group by itself, as printed",
        {},
        _networks({f"{PARAMETERS}.rate": "lyapunov-groups", f"{PARAMETERS}.eta": 1.0}),
    ),
    Variant(
        "joint rate",
        "the best rate of all groups together",
        {},
        _networks({f"{PARAMETERS}.rate": "lyapunov", f"{PARAMETERS}.eta": 1.0}),
    ),
    Variant("interpolated control points", "ANFBsC and HBsWC with curves for the nearest point", {}, _interpolated),
    *(Variant(f"gain x {factor:g}", "input scales divided by it", {}, _gain(factor)) for factor in (0.1, 0.3, 3.0)),
    Variant("30 frames/s", "half the rate at which controllers are called", {"frame_rate": 30}),
    Variant("120 frames/s", "twice the rate", {"frame_rate": 120}),
    Variant(
        "printed time constants",
        "T'd0 1.01 s, T''d0 0.053 s as printed in A.1",
        {"system.machines.0.Td01": 1.01, "system.machines.0.Td02": 0.053},
        systems=("smib",),
    ),
    Variant(
        "printed rate feedback",
        "KF 0.001 of A.2 at all exciters",
        {f"system.exciters.{i}.KF": 0.001 for i in range(4)},
        systems=("two_area",),
    ),
)


def told(variant: str, cells: Sequence[Cell], figures: Figures, base: Figures) -> list[Told]:
    """Agreement of a variant's figures with the tables of improvements among the cells, and with `base`, ours."""
    rows = []
    for table in dict.fromkeys(cell.table for cell in cells if cell.against is not None):
        table_cells = [cell for cell in cells if cell.table == table]
        compared = agreement.compare(table_cells, figures)
        signs = agreement.signs(agreement.statements(compared))[0]
        ranked = ranking.rankings(compared)
        ranks = ranking.totals(ranked)[0]
        before = {order[:4]: _places(order) for order in ranking.rankings(agreement.compare(table_cells, base))}
        like = [ranking.rho(_places(order), before[order[:4]]) for order in ranked]
        known = [rho for rho in like if rho is not None]
        unstable = sum(
            figures[run] is None for run in {agreement.ComparedRun(c.system, c.scenario, c.who) for c in table_cells}
        )
        rho_own = float(np.mean(known)) if known else None
        figures_told = (signs.fraction, ranks.mean_rho, rho_own, ranks.same_best, ranks.rankings, unstable)
        rows.append(Told(variant, table, *figures_told))
    return rows


def _places(order: Ranking) -> NDArray[np.float64]:
    """Our places, in the order of the controllers' names."""
    return np.array([place for _, place in sorted(zip(order.controllers, order.ours, strict=True))])
