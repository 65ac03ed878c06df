"""A profile as data: what all runs of a kind of study have in common, whatever system and controller they are of."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from pydantic import Field

from facts_damping.parameters.base import Name, ParameterModel
from facts_damping.parameters.study import FieldPath

if TYPE_CHECKING:
    from collections.abc import Iterable

DEFAULT_PROFILE = "thesis"  # whose fields are the defaults of a run


class Profile(ParameterModel):
    """Fields of a run that a profile sets; what a run says itself goes before it."""

    description: str = ""
    set: dict[FieldPath, Any] = Field({}, description="fields of the run, path: value; `*`: where there are entries")
    systems: dict[Name, dict[FieldPath, Any]] = Field({}, description="system: what is set for it alone")
    signals: dict[Name, Name] = Field({}, description="signal: the one that controllers are given in its place")
    fixed_model: bool = Field(
        False, description="controllers are designed on this system, whatever a run changes in it afterwards"
    )

    def given(self, signals: Iterable[str]) -> list[str]:
        """What controllers are given in the place of signals."""
        return [self.signals.get(name, name) for name in signals]
