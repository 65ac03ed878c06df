"""Faults of controllers as data: what a fault campaign does to them."""

from __future__ import annotations

from typing import Literal

from pydantic import Field, model_validator

from facts_damping.parameters.base import ParameterModel, quantity

SIZED = {"gain": 10.0, "weights": 1.0}  # kinds that have a size, and what it is by default


class ControllerFault(ParameterModel):
    """A controller that goes wrong for a time.

    wrong_sign: its setpoints turned round; gain: multiplied by `size`; stuck: what they were at the start; random:
    anything within the limits; bang_bang: from one limit to the other at each frame; nan: no numbers; weights: its
    network's parameters moved, each by a normal number times `size`, at the start; hung: it says nothing, and then goes
    on; dead: it says nothing, and then begins again, knowing nothing.
    """

    kind: Literal["wrong_sign", "gain", "stuck", "random", "bang_bang", "nan", "weights", "hung", "dead"]
    start: float = quantity(0.0, "s", "from then on", ge=0, le=1e5)
    duration: float | None = quantity(None, "s", "for so long; none: to the end", gt=0, le=1e5)
    size: float | None = Field(None, ge=-1e3, le=1e3, description="of gain (none: 10) and weights (none: 1)")

    @model_validator(mode="after")
    def _of_its_kind(self) -> ControllerFault:
        if self.size is not None and self.kind not in SIZED:
            raise ValueError(f"size: given for {self.kind}; allowed: for {', '.join(SIZED)} only")
        return self
