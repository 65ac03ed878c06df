"""What all parameter models share: strict, frozen, no unknown keys; every number has a unit."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field, StringConstraints, ValidationInfo, field_validator

Name = Annotated[str, StringConstraints(min_length=1, max_length=64, pattern=r"^[A-Za-z0-9][A-Za-z0-9_.+-]*$")]

LEAST = 1e-30  # of what must be more than 0: less means nothing in any unit here, and squares and quotients overflow


class ParameterModel(BaseModel):
    """A table row or a section of a file: unknown keys, wrong types, NaN and infinities are errors."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)

    @field_validator("*")
    @classmethod
    def _not_vanishing(cls, value: Any, info: ValidationInfo) -> Any:
        if isinstance(value, float) and 0.0 < value < LEAST:
            limits = cls.model_fields[str(info.field_name)].metadata
            if any(getattr(limit, "gt", None) == 0 for limit in limits):
                raise ValueError(f"{value:g} given; allowed: {LEAST:g} or more")
        return value


def quantity(default: Any, unit: str, description: str, **limits: float) -> Any:
    """A number with unit, meaning and range; `...` as default makes it required."""
    return Field(default, description=description, json_schema_extra={"unit": unit}, **limits)  # type: ignore[call-overload]
