"""What all parameter models share: strict, frozen, no unknown keys; every number has a unit."""

from __future__ import annotations

import math
import re
from contextvars import ContextVar
from functools import partial
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

from pydantic import BaseModel, ConfigDict, Field, StringConstraints, ValidationError
from pydantic_core import core_schema

if TYPE_CHECKING:
    from collections.abc import Callable

    from pydantic import GetCoreSchemaHandler

Name = Annotated[str, StringConstraints(min_length=1, max_length=64, pattern=r"^[A-Za-z0-9][A-Za-z0-9_.+-]*$")]
LawName = Annotated[str, StringConstraints(min_length=1, max_length=99, pattern=r"^[A-Za-z0-9][A-Za-z0-9_.+@-]*$")]

SCALES = {  # of units that may stand with a number, by the unit in which a field has it
    "s": {"us": 1e-6, "ms": 1e-3, "s": 1.0, "min": 60.0, "h": 3600.0},
    "Hz": {"mHz": 1e-3, "Hz": 1.0, "kHz": 1e3},
    "rad": {"rad": 1.0, "deg": math.pi / 180.0},
    "p.u.": {"p.u.": 1.0, "pu": 1.0, "%": 0.01},
    "-": {"%": 0.01},
    **{unit: {unit: 1.0} for unit in ("MW", "Mvar", "MVA", "kV", "deg", "km", "p.u./s", "1/s")},
}
LIMITS = {"greater_than", "greater_than_equal", "less_than", "less_than_equal"}  # pydantic's errors of a range
MINIMUM = 1e-30  # of what must be more than 0: less means nothing in any unit here, and squares and quotients overflow

PHYSICAL: ContextVar[bool] = ContextVar("PHYSICAL", default=False)  # numbers need to be in no usual range now


class ParameterModel(BaseModel):
    """A table row or a section of a file: unknown keys, wrong types, NaN and infinities are errors."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False, defer_build=True)


class _Before(NamedTuple):
    """Has a function see what is given for a field before pydantic does, which would inspect its signature."""

    function: Callable[[Any], Any]

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> core_schema.CoreSchema:
        """Pydantic's own hook."""
        return core_schema.no_info_before_validator_function(self.function, handler(source))


class _Limited(NamedTuple):
    """Has a number that is not in its range pass where ranges are physical and it is not below `lowest`."""

    lowest: float

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> core_schema.CoreSchema:
        """Pydantic's own hook."""
        return core_schema.no_info_wrap_validator_function(self.check, handler(source))

    def check(self, value: Any, check: Callable[[Any], Any]) -> Any:
        """The value as pydantic checks it."""
        try:
            return check(value)
        except ValidationError as error:
            if not PHYSICAL.get() or {row["type"] for row in error.errors()} - LIMITS or value < self.lowest:
                raise
            return float(value)


def _lowest(unit: str, gt: float | None = None, ge: float | None = None, **_: float) -> float:
    """The least value that equations allow: a limit of a time constant, else 0 or more than that, or any."""
    limit = ge if gt is None else gt
    if limit is None or limit < 0.0:
        return -math.inf
    return 0.0 if limit == ge == 0.0 else max(MINIMUM, limit if unit == "s" else 0.0)


def quantity(
    default: Any, unit: str, description: str, usual: float | None = None, lowest: float | None = None, **limits: float
) -> Any:
    """A number with unit, meaning and range; `...` as default makes it required: then `usual` is a value that is.

    `lowest`: what equations allow, if it is less than the range begins with.
    """
    extra = {"unit": unit} | ({} if usual is None else {"usual": usual})
    field = Field(default, description=description, json_schema_extra=extra, **limits)  # type: ignore[call-overload]
    if limits:
        field.metadata.append(_Limited(_lowest(unit, **limits) if lowest is None else lowest))
    if limits.get("gt") == 0:
        field.metadata.append(_Before(_not_vanishing))
    if unit in SCALES:  # which comes first
        field.metadata.append(_Before(partial(_in_unit, unit)))
    return field


def _not_vanishing(value: Any) -> Any:
    if isinstance(value, float) and 0.0 < value < MINIMUM:
        raise ValueError(f"{value:g} given; allowed: {MINIMUM:g} or more")
    return value


def _in_unit(unit: str, value: Any) -> Any:
    """A number that is given as text with its unit, `50 ms`, in the unit of its field."""
    if not isinstance(value, str):
        return value
    match = re.fullmatch(r"([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?) ?([^\d\s]\S*)", value.strip())
    scale = SCALES[unit].get(match[2]) if match else None
    if match is None or scale is None:
        number = "a number" if unit == "-" else f"a number in {unit}"
        raise ValueError(f"{value!r} given; allowed: {number}, or one with {', '.join(SCALES[unit])}")
    return float(match[1]) * scale if scale != 1.0 else float(match[1])
