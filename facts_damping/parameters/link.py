"""A wide-area link as data: two chains of stages."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any, Union

from pydantic import BeforeValidator, Field, model_validator

from facts_damping.fields import ParameterModel
from facts_damping.parameters.stages import STAGES, StageModel


def _named(content: Any) -> Any:
    """A stage that names no model is constant."""
    return {"model": "constant", **content} if isinstance(content, dict) else content


if TYPE_CHECKING:
    Stage = StageModel
else:
    Stage = Annotated[Annotated[Union[tuple(STAGES)], Field(discriminator="model")], BeforeValidator(_named)]  # noqa: UP007 (made from the list)


class Link(ParameterModel):
    """A wide-area [link](links.md): one chain of stages up to the controllers and one down to the devices.

    The delays of the stages in a chain add up. A chain without stages has no delay.
    """

    description: str = Field("", description="text that `facts-damping list links` shows")
    up: list[Stage] = Field([], description="stages from the PMUs to the controllers, in order")
    down: list[Stage] = Field([], description="stages from the controllers to the devices, in order")

    @model_validator(mode="after")
    def _where_it_has_a_meaning(self) -> Link:
        for i, stage in enumerate(self.down):
            if stage.model == "wait":
                raise ValueError(f"down.{i}.model: 'wait' given; allowed: up only, where frames have several entries")
            if getattr(stage, "measurement", None) is not None:
                raise ValueError(f"down.{i}.measurement: given; allowed: up only, a setpoint is one value")
        return self
