"""A fault campaign as data: runs to draw from, faults and how often each is drawn."""

from __future__ import annotations

from typing import Any

from pydantic import Field, model_validator

from facts_damping.fields import Name, ParameterModel, quantity
from facts_damping.parameters.profile import FieldPath

EARLIEST_S = 0.1  # begin of a fault: some need what was before
Choices = dict[str, dict[FieldPath, Any]]  # label: what it sets in the run


class BaseRun(ParameterModel):
    """A run for which faults are drawn, with fields that are drawn, too.

    In `choose`, one label of each list is drawn, and its fields are set in the run. For example, `choose: {link: {fast:
    {link: fibre}, slow: {link: satellite}}}` draws one of two links.
    """

    run: str | dict[str, Any] = Field(
        {}, description="run: name under config/runs, path, or inline, with supervision; empty: all defaults"
    )
    set: dict[FieldPath, Any] = Field({}, description="path: value, fields of the run that differ, as in `--set`")
    choose: dict[Name, Choices] = Field({}, description="name of a list: label: path: value")

    @model_validator(mode="after")
    def _not_empty(self) -> BaseRun:
        empty = next((name for name, choices in self.choose.items() if not choices), None)
        if empty is not None:
            raise ValueError(f"choose.{empty}: none given; allowed: at least one")
        return self


class Campaign(ParameterModel):
    """A fault campaign: random cases of [what fails](supervision.md), when, where, and in which run.

    `facts-damping campaign` checks for each case that supervised control [does no harm](supervision_results.md). A case
    depends on its number and the seed only.
    """

    description: str = Field("", description="text that `facts-damping list campaigns` shows")
    seed: int = quantity(0, "-", "seed of all cases", ge=0, le=2**31 - 1)
    draws: int = quantity(..., "-", "number of cases", ge=1, le=1_000_000)
    graphs: int = quantity(0, "-", "number of further cases that run as graphs of real nodes", ge=0, le=10_000)
    graph_duration: float = quantity(
        8.0, "s", "simulated time of a graph; its fault begins at least 3 s before the end", gt=0, le=1e3
    )
    base_runs: dict[Name, BaseRun] = Field(..., min_length=1, description="name: run; each is drawn equally often")
    faults: dict[Name, float] = Field(
        {}, description="fault: how often it is drawn relative to the others, 0 to 1e6; empty: all equally often"
    )
    healthy: float = quantity(0.0, "-", "fraction of cases in which nothing fails", ge=0, le=1)
    window: tuple[float, float] = Field(
        (2.0, 8.0), strict=False, description="earliest and latest start of a fault in s, from 0.1 on"
    )
    lasting: float = quantity(0.3, "-", "fraction of faults that last to the end", ge=0, le=1)
    unsupervised: bool = Field(False, description="true: each case is repeated without supervision")

    @model_validator(mode="after")
    def _ordered(self) -> Campaign:
        low, high = self.window
        if not EARLIEST_S <= low <= high:
            allowed = f"from {EARLIEST_S:g} on, the first not after the second"
            raise ValueError(f"window: {low:g} to {high:g} s given; allowed: {allowed}")
        odd = next((name for name, weight in self.faults.items() if not 0.0 <= weight <= 1e6), None)
        if odd is not None:
            raise ValueError(f"faults.{odd}: {self.faults[odd]:g} given; allowed: 0 to 1e+06")
        return self
