"""What all parameter models share: strict, frozen, no unknown keys; every number has a unit."""

from __future__ import annotations

import math
import re
from functools import partial
from typing import Annotated, Any

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, StringConstraints, ValidationInfo, field_validator

Name = Annotated[str, StringConstraints(min_length=1, max_length=64, pattern=r"^[A-Za-z0-9][A-Za-z0-9_.+-]*$")]

SCALES = {  # of units that may stand with a number, by the unit in which a field has it
    "s": {"us": 1e-6, "ms": 1e-3, "s": 1.0, "min": 60.0, "h": 3600.0},
    "Hz": {"mHz": 1e-3, "Hz": 1.0, "kHz": 1e3},
    "rad": {"rad": 1.0, "deg": math.pi / 180.0},
    "p.u.": {"p.u.": 1.0, "pu": 1.0, "%": 0.01},
    "-": {"%": 0.01},
    **{unit: {unit: 1.0} for unit in ("MW", "Mvar", "MVA", "kV", "deg", "km", "p.u./s", "1/s")},
}
LEAST = 1e-30  # of what must be more than 0: less means nothing in any unit here, and squares and quotients overflow


class ParameterModel(BaseModel):
    """A table row or a section of a file: unknown keys, wrong types, NaN and infinities are errors."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False, defer_build=True)

    @field_validator("*")
    @classmethod
    def _not_vanishing(cls, value: Any, info: ValidationInfo) -> Any:
        if isinstance(value, float) and 0.0 < value < LEAST:
            limits = cls.model_fields[str(info.field_name)].metadata
            if any(getattr(limit, "gt", None) == 0 for limit in limits):
                raise ValueError(f"{value:g} given; allowed: {LEAST:g} or more")
        return value


def quantity(default: Any, unit: str, description: str, usual: float | None = None, **limits: float) -> Any:
    """A number with unit, meaning and range; `...` as default makes it required: then `usual` is a value that is."""
    extra = {"unit": unit} | ({} if usual is None else {"usual": usual})
    made = Field(default, description=description, json_schema_extra=extra, **limits)  # type: ignore[call-overload]
    if unit in SCALES:
        made.metadata.append(BeforeValidator(partial(_in_unit, unit)))
    return made


def _in_unit(unit: str, given: Any) -> Any:
    """A number that is given as text with its unit, `50 ms`, in the unit of its field."""
    if not isinstance(given, str):
        return given
    found = re.fullmatch(r"([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?) ?([^\d\s]\S*)", given.strip())
    scale = SCALES[unit].get(found[2]) if found else None
    if found is None or scale is None:
        units = ", ".join(SCALES[unit])
        raise ValueError(
            f"{given!r} given; allowed: a number{'' if unit == '-' else f' in {unit}'}, or one with {units}"
        )
    return float(found[1]) * scale if scale != 1.0 else float(found[1])
