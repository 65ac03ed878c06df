"""What a set of cases is drawn from, and a case."""

from __future__ import annotations

from typing import Any

from pydantic import Field

from facts_damping.fields import Name, ParameterModel, quantity
from facts_damping.parameters.profile import FieldPath


class ScoredCase(ParameterModel):
    """A case: its kind, the number of its event, and the fields of the run that it sets."""

    kind: str
    event: int  # cases of other kinds may have the same
    set: dict[FieldPath, Any]  # path: value, as in `--set`


class CaseSet(ParameterModel):
    """A set of cases for [scores](score.md). A version is never changed; another one gets another number."""

    description: str = Field("", description="text that `facts-damping list case_sets` shows")
    version: str = Field(..., description="of the set")
    run: dict[str, Any] = Field(..., description="base run, without controllers")
    set: dict[FieldPath, Any] = Field({}, description="path: value, fields of all runs")
    after: float = quantity(8.0, "s", "time after the last event that counts", gt=0, le=1000)
    controllers: dict[str, list[dict[str, Any]]] = Field(
        {}, description="name: controllers of the run, the baselines that are ranked"
    )
    devices: list[Name] = Field(["sssc"], min_length=1, description="devices of a controller that names none")
    signals: list[Name] = Field(["speed"], min_length=1, description="signals of a controller that names none")
    lines: list[Name] = Field(..., min_length=1, description="lines that are faulted and trip")
    seed: str = Field(..., min_length=1, description="text that the cases are drawn from")
    kinds: dict[str, int] = Field(..., min_length=1, description="kind of case: number of its cases")
    beside: list[str] = Field([], description="those of `kinds` that stand beside the score, not in it")
    redrawn: dict[str, int] = Field(
        {}, description="kind and number of a case: draws before it that have no power flow"
    )
    heldout: str | None = Field(
        None, pattern="^[0-9a-f]{64}$", description="SHA-256 of the text that the held-out cases are drawn from"
    )
