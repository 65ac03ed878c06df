"""A frozen set of cases on which controllers are scored."""

from __future__ import annotations

from typing import Any

from pydantic import Field

from facts_damping.fields import Name, ParameterModel, quantity
from facts_damping.parameters.profile import FieldPath


class ScoredCase(ParameterModel):
    """A case: its kind, and the fields of the run that it sets."""

    kind: str = Field(..., description="one of the kinds of the set")
    set: dict[FieldPath, Any] = Field(..., description="path: value, fields of the run, as in `--set`")


class CaseSet(ParameterModel):
    """A set of cases for [scores](score.md). A version is never changed; another one gets another number."""

    description: str = Field("", description="text that `facts-damping list case_sets` shows")
    version: str = Field(..., description="of the set")
    run: dict[str, Any] = Field(..., description="base run, without controllers")
    set: dict[FieldPath, Any] = Field({}, description="path: value, fields of all runs")
    after: float = quantity(8.0, "s", "time after the last event that counts", gt=0, le=1000)
    controllers: dict[str, list[dict[str, Any]]] = Field(
        ...,
        min_length=1,
        description="name: controllers of the run, those that are ranked; the others stand beside them",
    )
    beside: list[str] = Field(..., min_length=1, description="those of `controllers` that each card has beside its own")
    devices: list[Name] = Field(["sssc"], min_length=1, description="devices of a controller that names none")
    signals: list[Name] = Field(["speed"], min_length=1, description="signals of a controller that names none")
    kinds: dict[str, str] = Field(..., min_length=1, description="kind of case: what it is")
    called: dict[str, str] = Field({}, description="kind of case: its name on cards, where that is another one")
    cases: list[ScoredCase] = Field(..., min_length=1, description="the cases")
