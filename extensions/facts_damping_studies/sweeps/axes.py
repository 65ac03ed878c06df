"""Conversion of a study's axes to its points: the fields that each sets in the run, and the columns of its row."""

from __future__ import annotations

from fnmatch import fnmatchcase
from itertools import product
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from scipy import stats

from facts_damping.errors import InputError, check_known

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from numpy.typing import NDArray

    from facts_damping_studies.parameters import Axis, Range, Study, Target, Variable

MAX_POINTS = 1_000_000
DIGITS = 12  # significant digits to which values are rounded: 3 * 0.1 is 0.3


class Point(NamedTuple):
    """A point of a sweep."""

    columns: dict[str, Any]  # of the table
    changes: dict[str, Any]  # of the run: path: value


# Quantile functions of the distributions before truncation.
DISTRIBUTIONS = {
    "uniform": lambda v: stats.uniform(v.low, v.high - v.low),
    "loguniform": lambda v: stats.loguniform(v.low, v.high),
    "normal": lambda v: stats.norm(v.mean, v.std),
    "lognormal": lambda v: stats.lognorm(v.sigma, scale=v.median),
}


def points(study: Study) -> list[Point]:
    """All points of a study, with the last axis varying fastest. Raises `InputError` if axes conflict."""
    random = np.random.default_rng(study.seed)
    expanded = [expand(axis, random, f"sweep.{i}") for i, axis in enumerate(study.sweep)]
    count = int(np.prod([len(axis_points) for axis_points in expanded], dtype=np.float64))
    if count > MAX_POINTS:
        raise InputError(f"sweep: {count} points given; allowed: at most {MAX_POINTS}")
    fields = [
        path
        for axis_points in expanded
        for path in dict.fromkeys(path for point in axis_points for path in point.changes)
    ]
    fields += list(study.margin.factors) if study.margin else []
    columns = [name for axis_points in expanded for name in axis_points[0].columns]
    columns += [study.margin.column] if study.margin else []
    for listed, what in ((fields, "field"), (columns, "name")):
        twice = [name for name in listed if listed.count(name) > 1]
        if twice:
            raise InputError(f"sweep: {what} '{twice[0]}' given by two axes; allowed: one")
    return [joined(parts) for parts in product(*expanded)]


def chosen(all_points: list[Point], only: Sequence[str]) -> list[Point]:
    """The points whose columns match the given texts of value patterns, such as `kind=LLC*,HBsWC direct`."""
    for text in only:
        name, _, patterns = text.partition("=")
        check_known(f"--only {text}", name, all_points[0].columns)
        values = list(dict.fromkeys(str(point.columns[name]) for point in all_points))
        asked = [pattern.strip() for pattern in patterns.split(",")]
        for pattern in asked:
            if not any(fnmatchcase(value, pattern) for value in values):
                allowed = f"{', '.join(values)}, or a pattern of them"
                raise InputError(f"--only {text}: '{pattern}' given; allowed: {allowed}")
        all_points = [p for p in all_points if any(fnmatchcase(str(p.columns[name]), pattern) for pattern in asked)]
    return all_points


def expand(axis: Axis, random: np.random.Generator, where: str) -> list[Point]:
    """The points of a single axis; random draws advance `random`."""
    if axis.zip is not None:
        beside = [expand(zipped, random, f"{where}.zip.{i}") for i, zipped in enumerate(axis.zip)]
        lengths = [len(axis_points) for axis_points in beside]
        if len(set(lengths)) > 1:
            raise InputError(f"{where}.zip: axes of {', '.join(map(str, lengths))} values given; allowed: as many each")
        return [joined(parts) for parts in zip(*beside, strict=True)]
    if axis.rows is not None:
        if axis.name is None:
            paths = list(dict.fromkeys(path for row in axis.rows for path in row))
            return [Point({path: row.get(path) for path in paths}, row) for row in axis.rows]
        labels = axis.labels or map(_label, axis.rows)
        return [Point({axis.name: label}, row) for label, row in zip(labels, axis.rows, strict=True)]
    if axis.draws is not None:
        spec = axis.draws
        drawn_points = _drawn(spec.variables, spec.number, spec.method, random)
        return (
            [joined(parts) for parts in zip(drawn_points, _of_kinds(axis, random), strict=True)]
            if spec.kinds
            else drawn_points
        )
    values = axis.values if axis.range is None else spaced(axis.range)
    return [placed(axis, value) for value in values or []]


def _label(row: dict[str, Any]) -> str:
    """A label for a row of several fields from its texts and numbers, such as `HBsWC direct`."""
    return " ".join(str(value) for value in row.values() if isinstance(value, str | int | float))


def joined(parts: Iterable[Point]) -> Point:
    """Merge points of several axes into one."""
    merged = Point({}, {})
    for part in parts:
        merged.columns.update(part.columns)
        merged.changes.update(part.changes)
    return merged


def placed(target: Target, value: Any) -> Point:
    """The point that sets a value in its target fields."""
    plain = value.item() if isinstance(value, np.generic) else value
    whole = getattr(target, "whole", False)
    plain_value = round(plain) if whole else _rounded(plain) if isinstance(plain, float) else plain
    scaled = {path: plain_value if f == 1.0 else _rounded(f * plain_value) for path, f in target.factors.items()}
    return Point({target.column: plain_value}, scaled)


def _rounded(value: float) -> float:
    return float(f"{value:.{DIGITS}g}")


def spaced(spec: Range) -> Sequence[int | float]:
    """The values of a range; integers stay integers."""
    if spec.step is None:
        spread = np.linspace(spec.start, float(spec.stop or 0), int(spec.number or 1))
        whole = isinstance(spec.start, int) and isinstance(spec.stop, int) and not np.any(spread % 1)
        return [int(value) if whole else _rounded(float(value)) for value in spread]
    number = spec.number or int((spec.stop - spec.start) / spec.step + 1e-9) + 1  # type: ignore[operator]
    if number > MAX_POINTS:
        raise InputError(f"sweep: a range of {number} values given; allowed: at most {MAX_POINTS}")
    values = [spec.start + i * spec.step for i in range(number)]
    return [_rounded(value) if isinstance(value, float) else value for value in values]


def _of_kinds(axis: Axis, random: np.random.Generator) -> list[Point]:
    """Points of the kinds of draws, which alternate."""
    spec = axis.draws
    assert spec is not None  # noqa: S101 (for the types)
    kinds, kind_points = spec.kinds or {}, [Point({}, {})] * spec.number
    blank = {variable.column: None for kind in kinds.values() for variable in kind.variables}
    for i, (name, kind) in enumerate(kinds.items()):
        places = range(i, spec.number, len(kinds))
        points_of_kind = _drawn(kind.variables, len(places), spec.method, random)
        fixed = Point({str(axis.name): name, **blank}, kind.set)
        for place, point in zip(places, points_of_kind, strict=True):
            kind_points[place] = joined([fixed, point])
    return kind_points


def _drawn(variables: Sequence[Variable], number: int, method: str, random: np.random.Generator) -> list[Point]:
    values = draw(variables, number, method, random)
    return [joined(map(placed, variables, row)) for row in values]


def draw(variables: Sequence[Variable], number: int, method: str, random: np.random.Generator) -> NDArray[np.float64]:
    """Random values of variables, (number, variables)."""
    size = len(variables)
    if method == "latin_hypercube" and size:
        fractions = stats.qmc.LatinHypercube(size, rng=random).random(number)
    else:
        fractions = random.random((number, size))
    columns = [quantile(variable, fractions[:, i]) for i, variable in enumerate(variables)]
    return np.asarray(np.array(columns).reshape(size, number).T)


def quantile(variable: Variable, fraction: NDArray[np.float64]) -> NDArray[np.float64]:
    """Quantiles of a variable at the given fractions, within its limits."""
    law = DISTRIBUTIONS[variable.distribution](variable)
    low = 0.0 if variable.low is None else law.cdf(variable.low)
    high = 1.0 if variable.high is None else law.cdf(variable.high)
    return np.asarray(law.ppf(low + (high - low) * fraction))


def drawn_columns(axis: Axis) -> list[str]:
    """Random columns of an axis."""
    return list(dict.fromkeys(variable.column for variable in drawn_variables(axis)))


def drawn_variables(axis: Axis) -> list[Variable]:
    """Random variables of an axis."""
    inside = [variable for inner_axis in axis.zip or [] for variable in drawn_variables(inner_axis)]
    if axis.draws is None:
        return inside
    of_kinds = [variable for kind in (axis.draws.kinds or {}).values() for variable in kind.variables]
    return [*inside, *axis.draws.variables, *of_kinds]
