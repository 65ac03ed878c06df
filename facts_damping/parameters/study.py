"""A study as data: a base run, the fields that are swept, and the margin that is searched."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import Field, StringConstraints, model_validator

from facts_damping.parameters.base import Name, ParameterModel, quantity
from facts_damping.parameters.files import FIELD_PATH

FieldPath = Annotated[str, StringConstraints(max_length=200, pattern=rf"^{FIELD_PATH}$")]
Number = int | float
Criterion = Literal["unstable", "not_damped"]

# What each distribution needs; `low` and `high` cut the others off where they are given.
NEEDED = {
    "uniform": ("low", "high"),
    "loguniform": ("low", "high"),
    "normal": ("mean", "std"),
    "lognormal": ("median", "sigma"),
}


class Target(ParameterModel):
    """Where a swept value goes: one field of the run, or several, each with a factor."""

    name: Name | None = Field(None, description="column of the table; none: the field's path")
    field: FieldPath | None = Field(None, description="field of the run, by its path as in --set")
    fields: dict[FieldPath, float] | None = Field(None, min_length=1, description="path: factor, for several fields")

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
    """Evenly spaced values from `start` on: two of `stop`, `step` and `number` say which."""

    start: Number = 0
    stop: Number | None = Field(None, description="the last value, if the step meets it")
    step: Number | None = None
    number: int | None = quantity(None, "-", "how many values", ge=1, le=1_000_000)

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
    """A random variable."""

    distribution: Literal["uniform", "loguniform", "normal", "lognormal"]
    low: float | None = Field(None, description="least value; of normal and lognormal: cut off there")
    high: float | None = Field(None, description="largest value; of normal and lognormal: cut off there")
    mean: float | None = Field(None, description="normal: mean before it is cut off")
    std: float | None = Field(None, gt=0, description="normal: standard deviation before it is cut off")
    median: float | None = Field(None, gt=0, description="lognormal: median before it is cut off")
    sigma: float | None = Field(None, gt=0, description="lognormal: standard deviation of the logarithm")
    whole: bool = Field(False, description="rounded to whole numbers")

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
    """A kind of draw: fields that it sets, and random variables of its own."""

    set: dict[FieldPath, Any] = {}
    variables: list[Variable] = []


class Draws(ParameterModel):
    """Values of random variables, drawn together from the study's seed; with `kinds` each draw is one of these."""

    number: int = quantity(..., "-", "how many draws", ge=1, le=1_000_000)
    method: Literal["plain", "latin_hypercube"] = Field("plain", description="independent draws, or one in each stripe")
    variables: list[Variable] = Field([], description="of all draws")
    kinds: dict[str, Kind] | None = Field(
        None, min_length=1, description="kind: what only its draws have; they come in turn, and the axis is called so"
    )

    @model_validator(mode="after")
    def _something(self) -> Draws:
        if not self.variables and self.kinds is None:
            raise ValueError("neither `variables` nor `kinds` given; allowed: one of them, or both")
        common = {one.column for one in self.variables}
        for name, kind in (self.kinds or {}).items():
            columns = [one.column for one in kind.variables]
            twice = next((one for one in columns if one in common or columns.count(one) > 1), None)
            if twice is not None:
                raise ValueError(f"kinds.{name}: '{twice}' drawn twice; allowed: once")
        return self


class Axis(Target):
    """What is swept: values or a range of a field, rows of several fields, draws, or axes side by side."""

    values: list[Any] | None = Field(None, min_length=1)
    range: Range | None = None
    rows: list[dict[FieldPath, Any]] | None = Field(None, min_length=1, description="each sets several fields at once")
    labels: list[str | Number] | None = Field(None, description="what the column `name` says of each row")
    draws: Draws | None = None
    zip: list[Axis] | None = Field(None, min_length=1, description="axes of the same length, stepped together")

    @model_validator(mode="after")
    def _one_kind(self) -> Axis:
        kinds = ("values", "range", "rows", "draws", "zip")
        given = [kind for kind in kinds if getattr(self, kind) is not None]
        if len(given) != 1:
            raise ValueError(f"{', '.join(given) or 'none'} given; allowed: one of {', '.join(kinds)}")
        if given[0] in ("values", "range"):
            self._check_target()
            _check_numbers(self.values or [], self.fields)
        elif self.field is not None or self.fields is not None:
            raise ValueError(f"`{given[0]}` have fields of their own; allowed: no `field`, no `fields`")
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
    """The search of the first value at which a run fails: a coarse grid, then bisection of the first change."""

    low: float = 0.0
    high: float
    tolerance: float = quantity(..., "that of the field", "width of the last bracket", gt=0)
    coarse: int = quantity(21, "-", "values of the grid from low to high", ge=2, le=10_000)
    criteria: list[Criterion] = Field(["unstable"], min_length=1, description="what counts as failing, each by itself")
    across: str = Field("scenario", description="column of the table whose values stand side by side")

    @model_validator(mode="after")
    def _ordered(self) -> Margin:
        self._check_target()
        if not self.low < self.high:
            raise ValueError(f"high: {self.high:g} given; allowed: more than low, {self.low:g}")
        return self


class Tables(ParameterModel):
    """Tables of figures for a page, one below the other: a row a controller, say, for each scenario of each system."""

    rows: list[str] = Field(["controller", "scheme"], min_length=1, description="columns that say what a row is")
    across: str | None = Field(
        None, description="column whose values stand side by side, a table for each figure; none: the figures do"
    )
    figures: list[str] = Field(..., min_length=1, description="columns that are shown")


class Study(ParameterModel):
    """Many closed loops: a base run, what is changed in it, what is swept over, what margin is searched."""

    description: str = ""
    run: str | dict[str, Any] = Field({}, description="name under config/runs, path, or a run inline; none: defaults")
    set: dict[FieldPath, Any] = Field({}, description="fields of the run that differ, path: value as in --set")
    seed: int = quantity(0, "-", "seed of all draws", ge=0, le=2**31 - 1)
    sweep: list[Axis] = Field([], description="axes; every value of one with every value of the others")
    margin: Margin | None = Field(None, description="searched at every point of the sweep")
    modes: bool = Field(True, description="also find the interarea mode of each run")
    check_step: bool = Field(
        False, description="each also with half the integration step; of a margin those at its ends"
    )
    tables: Tables | None = Field(None, description="of figures of all runs; none: no page of tables")
