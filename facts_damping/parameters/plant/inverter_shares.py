"""Shares of machines that inverters replace, at the same buses and with the same flows."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

from pydantic import Field, model_validator

from facts_damping.fields import Name, ParameterModel, quantity
from facts_damping.parameters.plant.inverters import CONTROLS, INVERTERS, Constants, ControlConstants

if TYPE_CHECKING:
    from collections.abc import Sequence

    from facts_damping.parameters.plant.inverters import Inverter, InverterControl
    from facts_damping.parameters.plant.machines import Machine

WHOLE = 1.0 - 1e-9  # from which on nothing of a machine is left


class InverterShare(ParameterModel):
    """A share of [machines](inverters.md) that inverters replace.

    Each machine keeps the rest of its rating and powers, with its data; an inverter at its bus, called `name`_MACHINE,
    has the share, and holds the same voltage. So the flows stay. A machine that is replaced as a whole goes with its
    controls; its PMUs then stand at the inverter, with frequencies for speeds, and the inverter of the slack is the
    slack. With a share of 0, devices and PMUs at the inverters go.
    """

    name: Name = Field("IBR", description="first part of the inverters' names")
    area: Name | None = Field(None, description="area whose machines they replace; give either this or `machines`")
    machines: list[Name] = Field([], description="machines that they replace")
    share: float = quantity(..., "-", "share of rating and power that the inverters have", ge=0, le=1)
    inverter: Constants = Field(..., description="model of the inverters, and its constants")
    controls: list[ControlConstants] = Field([], description="controls of each inverter, without the inverter")

    @model_validator(mode="after")
    def _of_machines(self) -> InverterShare:
        if (self.area is None) != bool(self.machines):
            raise ValueError("a share needs either `area` or `machines`")
        return self

    def inverter_of(self, machine: Machine) -> str:
        """Name of the inverter that replaces a machine."""
        return f"{self.name}_{machine.name}"

    def covers(self, machine: Machine) -> bool:
        """Whether it replaces a machine."""
        return machine.area == self.area if self.area is not None else machine.name in self.machines


class Replaced(NamedTuple):
    """Machines that are left, inverters, controls; inverters by machine that is gone, and those that are not there."""

    machines: list[Machine]
    inverters: list[Inverter]
    controls: list[InverterControl]
    gone: dict[str, str]
    absent: set[str]


def replaced(machines: Sequence[Machine], shares: Sequence[InverterShare]) -> Replaced:
    """Machines and inverters as shares say.

    Raises `ValueError` for shares of machines that are not there, or that exceed a machine.
    """
    for i, share in enumerate(shares):
        names = [m.name if share.area is None else str(m.area) for m in machines]
        asked = share.machines if share.area is None else [share.area]
        if unknown := [name for name in asked if name not in names]:
            field, allowed = "machines" if share.area is None else "area", ", ".join(sorted(set(names)))
            raise ValueError(f"inverter_shares.{i}.{field}: {', '.join(unknown)} given; allowed: {allowed}")
    parts = {m.name: [s for s in shares if s.share > 0.0 and s.covers(m)] for m in machines}
    shared = {name: sum(share.share for share in of_machine) for name, of_machine in parts.items()}
    if exceeded := [f"{total:g} of {name}" for name, total in shared.items() if total > 2.0 - WHOLE]:
        raise ValueError(f"inverter_shares.*.share: {', '.join(exceeded)} given; allowed: at most 1 of a machine")
    gone = {m.name: parts[m.name][0].inverter_of(m) for m in machines if shared[m.name] >= WHOLE}
    pairs = [(share, m) for m in machines for share in parts[m.name]]
    left = {m.name: _part(m, 1.0 - shared[m.name]) if shared[m.name] else {} for m in machines}
    return Replaced(
        [m.model_copy(update=left[m.name]) for m in machines if m.name not in gone],
        [_inverter(share, m, slack=m.slack and gone.get(m.name) == share.inverter_of(m)) for share, m in pairs],
        [CONTROLS[row.model](inverter=share.inverter_of(m), **row.model_dump())
         for share, m in pairs for row in share.controls],
        gone,
        {share.inverter_of(m) for share in shares if share.share == 0.0 for m in machines if share.covers(m)},
    )  # fmt: skip


def _part(machine: Machine, part: float) -> dict[str, Any]:
    """Rating and powers of a part of a machine; at the slack's bus its power is that in proportion to ratings."""
    P = None if machine.P is None else machine.P * part
    return {"rating": machine.rating * part, "P": P, "Q": machine.Q * part}


def _inverter(share: InverterShare, machine: Machine, *, slack: bool) -> Inverter:
    """The inverter that has a share of a machine."""
    row = {field: getattr(machine, field) for field in ("bus", "area", "V", "angle")} | _part(machine, share.share)
    row |= {**share.inverter.model_dump(), "name": share.inverter_of(machine), "slack": slack}
    inverter: Inverter = INVERTERS[share.inverter.model](**row)
    return inverter
