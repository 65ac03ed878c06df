"""What all parameter models share: strict, frozen, no unknown keys; every number has a unit."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field, StringConstraints

Name = Annotated[str, StringConstraints(min_length=1, max_length=64, pattern=r"^[A-Za-z0-9][A-Za-z0-9_.+-]*$")]


class Model(BaseModel):
    """A table row or a section of a file: unknown keys, wrong types, NaN and infinities are errors."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)


def quantity(default: Any, unit: str, description: str, **limits: float) -> Any:
    """A number with unit, meaning and range; `...` as default makes it required."""
    return Field(default, description=description, json_schema_extra={"unit": unit}, **limits)  # type: ignore[call-overload]
