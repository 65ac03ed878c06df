"""A study as data: a base run, the fields that are swept, and the margin that is searched."""

from __future__ import annotations

from typing import Any, Literal

from pydantic import Field, model_validator

from facts_damping.fields import Name, ParameterModel, quantity
from facts_damping.parameters.profile import FieldPath

Number = int | float
Criterion = Literal["unstable", "not_damped", "damping", "worse", "linear"]
DAMPING_RATIO = 0.03
Every = Literal["scenario", "controller", "network"]
Drawn = Literal["jacobian", "portrait"]

# What each distribution needs; `low` and `high` cut the others off where they are given.
NEEDED = {
    "uniform": ("low", "high"),
    "loguniform": ("low", "high"),
    "normal": ("mean", "std"),
    "lognormal": ("median", "sigma"),
}


class Target(ParameterModel):
    """Where a value goes: into one field of the run, or into several, each with a factor."""

    name: Name | None = Field(None, description="column of the table; none: the path of the field")
    field: FieldPath | None = Field(None, description="path of the field that takes the value, as in `--set`")
    fields: dict[FieldPath, float] | None = Field(
        None, min_length=1, description="path: factor, for several fields; each takes the value times its factor"
    )

    @property
    def factors(self) -> dict[str, float]:
        """The factor of each field."""
        return dict(self.fields or {}) if self.field is None else {self.field: 1.0}

    @property
    def column(self) -> str:
        """Column of the table."""
        return str(self.name or self.field)

    def _check_target(self) -> None:
        if (self.field is None) == (self.fields is None):
            raise ValueError("needs either `field` or `fields`")
        if self.fields is not None and self.name is None:
            raise ValueError("`fields` need a `name`, the column of the table")


class Range(ParameterModel):
    """Evenly spaced values; give two of `stop`, `step` and `number`."""

    start: Number = Field(0, description="first value")
    stop: Number | None = Field(None, description="last value, if the steps meet it")
    step: Number | None = Field(None, description="difference between two values")
    number: int | None = quantity(None, "-", "number of values", ge=1, le=1_000_000)

    @model_validator(mode="after")
    def _two(self) -> Range:
        if [self.stop, self.step, self.number].count(None) != 1:
            raise ValueError("a range needs two of `stop`, `step` and `number`")
        if self.step is not None and self.step == 0:
            raise ValueError("step: 0 given; allowed: another number")
        if self.step is not None and self.stop is not None and (self.stop - self.start) / self.step < 0:
            raise ValueError(f"step: {self.step} given, which leads away from {self.stop}; allowed: the other sign")
        return self


class Variable(Target):
    """A random variable that is drawn for fields of the run.

    `uniform` and `loguniform` need `low` and `high`, `normal` needs `mean` and `std`, `lognormal` needs `median` and
    `sigma`. The last two are cut off at `low` and `high` if these are given.
    """

    distribution: Literal["uniform", "loguniform", "normal", "lognormal"] = Field(
        ..., description="distribution of the values"
    )
    low: float | None = Field(None, description="smallest value")
    high: float | None = Field(None, description="largest value")
    mean: float | None = Field(None, description="mean of `normal`, before it is cut off")
    std: float | None = Field(None, gt=0, description="standard deviation of `normal`, before it is cut off")
    median: float | None = Field(None, gt=0, description="median of `lognormal`, before it is cut off")
    sigma: float | None = Field(None, gt=0, description="standard deviation of the logarithm of `lognormal`")
    whole: bool = Field(False, description="true: values are rounded to whole numbers")

    @model_validator(mode="after")
    def _complete(self) -> Variable:
        self._check_target()
        for name in NEEDED[self.distribution]:
            if getattr(self, name) is None:
                raise ValueError(f"{name}: missing; allowed: {self.distribution} with {self._needed()}")
        for name in {"mean", "std", "median", "sigma"} - set(NEEDED[self.distribution]):
            if getattr(self, name) is not None:
                raise ValueError(f"{name}: given; allowed: {self.distribution} with {self._needed()}")
        if self.low is not None and self.high is not None and not self.low < self.high:
            raise ValueError(f"high: {self.high:g} given; allowed: more than low, {self.low:g}")
        if self.distribution == "loguniform" and not (self.low or 0.0) > 0.0:
            raise ValueError(f"low: {self.low:g} given; allowed: more than 0 for loguniform")
        return self

    def _needed(self) -> str:
        return " and ".join(NEEDED[self.distribution])


class Kind(ParameterModel):
    """A kind of random case: fields that it sets, and random variables of its own."""

    set: dict[FieldPath, Any] = Field({}, description="path: value, fields of the run that all its cases have")
    variables: list[Variable] = Field([], description="random variables that only its cases have")


class Draws(ParameterModel):
    """Random cases: all variables are drawn together, from the seed of the study."""

    number: int = quantity(..., "-", "number of cases", ge=1, le=1_000_000)
    method: Literal["plain", "latin_hypercube"] = Field(
        "plain", description="independent draws, or a Latin hypercube sample"
    )
    variables: list[Variable] = Field([], description="random variables of all cases")
    kinds: dict[str, Kind] | None = Field(
        None, min_length=1, description="name: kind of case; cases are of each kind in turn; the axis needs a `name`"
    )

    @model_validator(mode="after")
    def _something(self) -> Draws:
        if not self.variables and self.kinds is None:
            raise ValueError("neither `variables` nor `kinds` given; allowed: one of them, or both")
        common = {variable.column for variable in self.variables}
        for name, kind in (self.kinds or {}).items():
            columns = [variable.column for variable in kind.variables]
            twice = next((column for column in columns if column in common or columns.count(column) > 1), None)
            if twice is not None:
                raise ValueError(f"kinds.{name}: '{twice}' drawn twice; allowed: once")
        return self


class Axis(Target):
    """An axis of a sweep; give exactly one of `values`, `range`, `rows`, `every`, `draws` and `zip`.

    `values` and `range` need `field`, or `fields` and `name`; the others have fields of their own.
    """

    values: list[Any] | None = Field(None, min_length=1, description="values of any type")
    range: Range | None = Field(None, description="evenly spaced values")
    rows: list[dict[FieldPath, Any]] | None = Field(
        None, min_length=1, description="path: value, several fields that each row sets at once"
    )
    labels: list[str | Number] | None = Field(
        None, description="with `rows` and `name`: text of each row in the column"
    )
    every: Every | None = Field(
        None,
        description="all scenarios of the system but `training`, all controllers, or the eleven neuro-fuzzy networks",
    )
    draws: Draws | None = Field(None, description="random values")
    zip: list[Axis] | None = Field(None, min_length=1, description="axes of the same length, side by side")

    @model_validator(mode="after")
    def _one_kind(self) -> Axis:
        kinds = ("values", "range", "rows", "every", "draws", "zip")
        chosen_kinds = [kind for kind in kinds if getattr(self, kind) is not None]
        if len(chosen_kinds) != 1:
            raise ValueError(f"{', '.join(chosen_kinds) or 'none'} given; allowed: one of {', '.join(kinds)}")
        if chosen_kinds[0] in ("values", "range"):
            self._check_target()
            _check_numbers(self.values or [], self.fields)
        elif self.field is not None or self.fields is not None:
            raise ValueError(f"`{chosen_kinds[0]}` have fields of their own; allowed: no `field`, no `fields`")
        if self.draws is not None and self.draws.kinds is not None and self.name is None:
            raise ValueError("`kinds` need a `name`, the column of the table")
        self._check_labels()
        return self

    def _check_labels(self) -> None:
        if self.labels is None:
            return
        if self.rows is None or self.name is None:
            raise ValueError("labels: given; allowed: beside `rows` and a `name`, the column of the table")
        if len(self.labels) != len(self.rows):
            raise ValueError(f"labels: {len(self.labels)} given; allowed: {len(self.rows)}, one a row")


def _check_numbers(values: list[Any], fields: dict[str, float] | None) -> None:
    odd = [value for value in values if isinstance(value, bool) or not isinstance(value, int | float)]
    if odd and fields is not None:
        raise ValueError(f"values: {odd[0]!r} given; allowed: numbers, where factors multiply them")


class Margin(Target):
    """A search for the values at which a run fails: a coarse grid, then bisection of each change."""

    low: float = Field(0.0, description="smallest value")
    high: float = Field(..., description="largest value")
    tolerance: float = quantity(..., "that of the field", "width of the last bracket", gt=0)
    coarse: int = quantity(21, "-", "number of values from `low` to `high` that are always run", ge=2, le=10_000)
    criteria: list[Criterion] = Field(
        ["damping"],
        min_length=1,
        description="what counts as failure, with a margin for each ([criteria](studies.md#margins))",
    )
    damping_ratio: float = quantity(
        DAMPING_RATIO, "-", "smallest damping ratio that the criterion `damping` accepts", ge=0, le=0.5
    )
    across: str = Field("scenario", description="column whose values stand side by side in table and picture")

    @model_validator(mode="after")
    def _ordered(self) -> Margin:
        self._check_target()
        if not self.low < self.high:
            raise ValueError(f"high: {self.high:g} given; allowed: more than low, {self.low:g}")
        return self


class Tables(ParameterModel):
    """Tables of results, written to `tables.md`: one for each scenario of each system."""

    rows: list[str] = Field(["controller", "scheme"], min_length=1, description="columns that identify a row")
    across: str | None = Field(
        None,
        description="column whose values stand side by side, with a table for each result; none: the results are side "
        "by side in one table",
    )
    figures: list[str] = Field(
        ..., min_length=1, examples=["[ITAE, trips]"], description="columns with the results that are shown"
    )


class Study(ParameterModel):
    """A [study](studies.md) of many closed loops: a base run, the fields that vary, perhaps a margin to search."""

    description: str = Field("", description="text that `facts-damping list studies` shows")
    run: str | dict[str, Any] = Field(
        {}, description="base run: name under config/runs, path, or inline; empty: all defaults"
    )
    set: dict[FieldPath, Any] = Field({}, description="path: value, fields of the run that differ, as in `--set`")
    seed: int = quantity(0, "-", "seed of all random cases", ge=0, le=2**31 - 1)
    sweep: list[Axis] = Field([], description="axes; every value of one meets every value of the others")
    margin: Margin | None = Field(None, description="margin that is searched at every point of the sweep")
    modes: bool = Field(True, description="true: the interarea mode of each run is identified, too")
    check_step: bool = Field(
        False,
        description="true: runs are repeated with half the integration step; in a margin search those at the ends of "
        "the brackets",
    )
    jacobian: int | None = quantity(
        None,
        "frames",
        "horizon of the plant's true Jacobian, which is compared with the identified one; none: no comparison",
        ge=1,
        le=60,
    )
    tables: Tables | None = Field(None, description="tables of results; none: no tables")
    pictures: list[Drawn] = Field(
        [], description="pictures of each point: its identifier (`jacobian`), its network (`portrait`)"
    )
