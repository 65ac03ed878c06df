"""Faults of controllers as data: what a fault campaign does to them."""

from __future__ import annotations

from typing import Literal

from pydantic import Field, model_validator

from facts_damping.fields import ParameterModel, quantity

SIZED = {"gain": 10.0, "weights": 1.0}  # kinds that have a size, and what it is by default


class ControllerFault(ParameterModel):
    """A fault of a controller, for tests of supervision.

    The setpoints are reversed (`wrong_sign`), multiplied by `size` (`gain`), held at their value at the start
    (`stuck`), random within the limits (`random`), at one limit and the other in turn at each frame (`bang_bang`), or
    not numbers (`nan`). `weights` displaces each parameter of the network once, by a normal random number times `size`.
    A `hung` controller is silent and then continues; a `dead` one is silent and then starts again from the beginning.
    """

    kind: Literal["wrong_sign", "gain", "stuck", "random", "bang_bang", "nan", "weights", "hung", "dead"] = Field(
        ..., description="kind of fault"
    )
    start: float = quantity(0.0, "s", "time at which the fault begins", ge=0, le=1e5)
    duration: float | None = quantity(None, "s", "how long the fault lasts; none: to the end of the run", gt=0, le=1e5)
    size: float | None = Field(
        None, ge=-1e3, le=1e3, description="size of `gain` (none: 10) and of `weights` (none: 1); not for other kinds"
    )

    @model_validator(mode="after")
    def _of_its_kind(self) -> ControllerFault:
        if self.size is not None and self.kind not in SIZED:
            raise ValueError(f"size: given for {self.kind}; allowed: for {', '.join(SIZED)} only")
        return self
