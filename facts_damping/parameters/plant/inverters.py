"""Inverters and their controls as data."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any, NamedTuple, Union

from pydantic import Field, create_model, model_validator

from facts_damping.fields import Name, quantity
from facts_damping.machine_controls.block_models import MODELS
from facts_damping.parameters.plant.machines import BlockModel, block_fields


class InverterModel(BlockModel):
    """An [inverter](inverters.md): its bus, its operating point, and its constants, on its rating."""

    name: Name = Field(..., description="name, unique among machines and inverters")
    bus: Name = Field(..., description="bus to which it is connected")
    area: Name | None = Field(None, description="area; given for a grid-forming one if it is for machines")
    rating: float = quantity(..., "MVA", "rated power, the base of its data and of its controls'", gt=0, le=1e5)
    P: float | None = quantity(None, "MW", "active power; not given for the slack", ge=-1e5, le=1e5)
    Q: float = quantity(
        0.0, "Mvar", "reactive power; beside `V` that of its own if sources share the bus", ge=-1e5, le=1e5
    )
    V: float | None = quantity(None, "p.u.", "terminal voltage at the start; none: that which follows", gt=0.5, le=1.5)
    slack: bool = Field(False, description="true: it balances the power flow; only grid-forming")
    angle: float = quantity(0.0, "deg", "angle of the slack's terminal voltage", ge=-360, le=360)

    @property
    def forming(self) -> bool:
        """Whether it forms a grid, with an angle of its own."""
        source = MODELS[self.model].source
        return source is not None and source.forming

    @model_validator(mode="after")
    def _scheduled(self) -> InverterModel:
        if self.slack == (self.P is not None):
            raise ValueError("P must be given for every inverter but the slack, and not for that")
        if self.slack and (self.V is None or not self.forming):
            raise ValueError("slack: true given; allowed: with V, for a grid-forming inverter")
        return self


class InverterControlModel(BlockModel):
    """A [control of an inverter](inverters.md): electrical, of the plant, or of a turbine; one of each sort."""

    inverter: Name = Field(..., description="inverter to which it belongs")
    enabled: bool = Field(True, description="false: switched off")
    bus: Name | None = Field(None, description="bus that a plant control regulates; none: that of the inverter")
    branch: Name | None = Field(
        None, description="branch at this bus whose power out of the bus it sees; none: the inverter's"
    )

    @property
    def signals(self) -> set[str]:
        """The signals that its blocks give."""
        return {block.name for block in MODELS[self.model].blocks if block.when is None or block.when(self)}

    @model_validator(mode="after")
    def _measured(self) -> InverterControlModel:
        if self.branch is not None and self.bus is None:
            raise ValueError(f"branch: {self.branch} given without `bus`; allowed: with it")
        return self


class Meter(NamedTuple):
    """Where a plant control measures: its inverter, a bus, and branches out of it."""

    inverter: str
    bus: str
    branches: list[str]


def _models(role: str, base: type) -> list[Any]:
    return [
        create_model(name, __base__=base, __doc__=f"{row.text}.", **block_fields(name))
        for name, row in MODELS.items()
        if row.role == role
    ]


if TYPE_CHECKING:
    Inverter = InverterModel
    InverterControl = InverterControlModel
else:

    def _one_of(role: str, base: type) -> Any:
        choices = tuple(_models(role, base))
        if len(choices) < 2:
            return choices[0] if choices else base
        return Annotated[Union[choices], Field(discriminator="model")]  # noqa: UP007 (made from the list)

    Inverter = _one_of("inverter", InverterModel)
    InverterControl = _one_of("inverter_control", InverterControlModel)
