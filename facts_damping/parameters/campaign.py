"""A fault campaign as data: runs to draw from, faults and how often each is drawn."""

from __future__ import annotations

from typing import Any

from pydantic import Field, model_validator

from facts_damping.parameters.base import Name, ParameterModel, quantity
from facts_damping.parameters.study import FieldPath

EARLIEST_S = 0.1  # begin of a fault: some need what was before
Choices = dict[str, dict[FieldPath, Any]]  # label: what it sets in the run


class Bed(ParameterModel):
    """A run that faults are drawn for, and what of it is drawn, too: one of each list."""

    run: str | dict[str, Any] = Field({}, description="name under config/runs, path, or a run inline; none: defaults")
    set: dict[FieldPath, Any] = Field({}, description="fields of the run that differ, path: value as in --set")
    choose: dict[Name, Choices] = Field({}, description="list: label: path: value; one of each list is drawn")

    @model_validator(mode="after")
    def _not_empty(self) -> Bed:
        empty = next((name for name, choices in self.choose.items() if not choices), None)
        if empty is not None:
            raise ValueError(f"choose.{empty}: none given; allowed: at least one")
        return self


class Campaign(ParameterModel):
    """Draws of (what fails) x (when) x (where) x (controller) x (scenario) x (link), and what must hold for each."""

    description: str = ""
    seed: int = quantity(0, "-", "seed of all draws", ge=0, le=2**31 - 1)
    draws: int = quantity(..., "-", "how many", ge=1, le=1_000_000)
    graphs: int = quantity(0, "-", "how many more draws are made as real graphs", ge=0, le=10_000)
    graph_duration: float = quantity(8.0, "s", "simulated time of these", gt=0, le=1e3)
    beds: dict[Name, Bed] = Field(..., min_length=1, description="name: a run; each is drawn as often as the others")
    faults: dict[Name, float] = Field({}, description="fault: how often beside the others; without: all, equally often")
    healthy: float = quantity(0.0, "-", "share of draws in which nothing fails", ge=0, le=1)
    window: tuple[float, float] = Field((2.0, 8.0), strict=False, description="s, between which a fault begins")
    lasting: float = quantity(0.3, "-", "share of faults that last to the end", ge=0, le=1)
    unsupervised: bool = Field(False, description="each draw once more without supervision")

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
