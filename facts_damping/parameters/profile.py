"""A profile as data: what all runs of a kind of study have in common, whatever system and controller they are of."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any

from pydantic import Field, StringConstraints

from facts_damping.fields import Name, ParameterModel
from facts_damping.parameters.files import FIELD_PATH

if TYPE_CHECKING:
    from collections.abc import Iterable

FieldPath = Annotated[str, StringConstraints(max_length=200, pattern=rf"^{FIELD_PATH}$")]
DEFAULT_PROFILE = "thesis"  # whose fields are the defaults of a run


class Profile(ParameterModel):
    """A [profile](running.md): assumptions that apply to any run; a field that a run file sets itself is kept."""

    description: str = Field("", description="text that `facts-damping list profiles` shows")
    set: dict[FieldPath, Any] = Field(
        {}, description="path: value, fields of the run as in `--set`; `*` is every entry of a list, if there are any"
    )
    systems: dict[Name, dict[FieldPath, Any]] = Field(
        {}, description="system: path: value, fields that are set for this system only"
    )
    signals: dict[Name, Name] = Field({}, description="signal: the signal that controllers receive in its place")
    fixed_model: bool = Field(
        False,
        description="true: controllers are designed on the system as this profile has it, whatever a run then changes",
    )

    def given(self, signals: Iterable[str]) -> list[str]:
        """What controllers are given in the place of signals."""
        return [self.signals.get(name, name) for name in signals]
