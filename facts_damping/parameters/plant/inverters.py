"""Inverters and their controls as data."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any, NamedTuple, Union

from pydantic import Field, create_model, model_validator

from facts_damping.fields import Name, quantity
from facts_damping.machine_controls.block_models import MODELS, active_blocks
from facts_damping.parameters.plant.machines import BlockModel, block_fields


class InverterModel(BlockModel):
    """An [inverter](inverters.md): its bus, its operating point, and its constants, on its rating."""

    name: Name = Field(..., description="name, unique among machines and inverters")
    bus: Name = Field(..., description="bus to which it is connected")
    area: Name | None = Field(None, description="area; given for a grid-forming one if it is for machines")
    rating: float = quantity(..., "MVA", "rated power, the base of its data and of its controls'", gt=0, le=1e5)
    P: float | None = quantity(
        None, "MW", "active power; none: of the slack, or at its bus that in proportion to ratings", ge=-1e5, le=1e5
    )
    Q: float = quantity(
        0.0, "Mvar", "reactive power; beside `V` that of its own if sources share the bus", ge=-1e5, le=1e5
    )
    V: float | None = quantity(None, "p.u.", "terminal voltage at the start; none: that which follows", gt=0.5, le=1.5)
    slack: bool = Field(False, description="true: it balances the power flow, and has V")
    angle: float = quantity(0.0, "deg", "angle of the slack's terminal voltage", ge=-360, le=360)

    @property
    def forming(self) -> bool:
        """Whether it forms a grid, with an angle of its own."""
        source = MODELS[self.model].source
        return source is not None and source.forms_a_grid

    @model_validator(mode="after")
    def _scheduled(self) -> InverterModel:
        if self.slack and self.P is not None:
            raise ValueError(f"P: {self.P:g} given; allowed: none for the slack")
        if self.V is None and self.P is None:
            raise ValueError("P, V: none given; allowed: P, or V for the slack or at its bus")
        return self


class ControlModel(BlockModel):
    """What controls of inverters have beside their constants."""

    enabled: bool = Field(True, description="false: switched off")
    bus: Name | None = Field(None, description="bus that a plant control regulates; none: that of the inverter")
    branch: Name | None = Field(
        None, description="branch at this bus whose power out of the bus it sees; none: the inverter's"
    )

    @property
    def signals(self) -> set[str]:
        """The signals that its blocks give."""
        return {block.name for block in active_blocks(self)}

    @model_validator(mode="after")
    def _measured(self) -> ControlModel:
        if self.branch is not None and self.bus is None:
            raise ValueError(f"branch: {self.branch} given without `bus`; allowed: with it")
        return self


class InverterControlModel(ControlModel):
    """A [control of an inverter](inverters.md): electrical, of the plant, or of a turbine; one of each sort."""

    inverter: Name = Field(..., description="inverter to which it belongs")


class Meter(NamedTuple):
    """Where a plant control measures: its inverter, a bus, and branches out of it."""

    inverter: str
    bus: str
    branches: list[str]


def _models(role: str, base: type, suffix: str = "") -> dict[str, Any]:
    """Models by name; pickle looks for them in this module, by name and suffix."""
    models: dict[str, Any] = {}
    for name, row in MODELS.items():
        if row.role == role:
            models[name] = create_model(name, __base__=base, __doc__=f"{row.text}.", **block_fields(name))
            models[name].__qualname__ = name + suffix
    globals().update({model.__qualname__: model for model in models.values()})
    return models


INVERTERS: dict[str, Any] = _models("inverter", InverterModel)
CONTROLS: dict[str, Any] = _models("inverter_control", InverterControlModel)

if TYPE_CHECKING:
    Inverter = InverterModel
    InverterControl = InverterControlModel
    Constants = BlockModel
    ControlConstants = ControlModel
else:

    def _one_of(models: dict[str, Any], base: type) -> Any:
        choices = tuple(models.values())
        if len(choices) < 2:
            return choices[0] if choices else base
        return Annotated[Union[choices], Field(discriminator="model")]  # noqa: UP007 (made from the list)

    Inverter, InverterControl = _one_of(INVERTERS, InverterModel), _one_of(CONTROLS, InverterControlModel)
    # Without the place: of shares of machines.
    Constants = _one_of(_models("inverter", BlockModel, "Constants"), BlockModel)
    ControlConstants = _one_of(_models("inverter_control", ControlModel, "Constants"), ControlModel)
