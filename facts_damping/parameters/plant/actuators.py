"""Actuators beside FACTS and HVDC as data: modulated loads, batteries, series capacitors, exciters."""

from __future__ import annotations

from typing import Any, Literal

from pydantic import Field, model_validator

from facts_damping.parameters.base import quantity
from facts_damping.parameters.plant.devices import AtMachine, DeviceModel, Parallel, Series


def _kind() -> Any:
    return Field(..., description="kind of device")


class LoadModulation(Parallel):
    """[Load modulation](facts_devices.md): active power drawn at a bus beside its loads.

    Its setpoint is the power, positive for more load, in p.u. of the system base: with a base of 100 MVA a
    `setpoint_max` of 0.5 is 50 MW. One that is not installed does nothing.
    """

    kind: Literal["load_modulation"] = _kind()
    setpoint_max: float = quantity(
        ..., "p.u.", "limit of the setpoint, power drawn; as much less must be drawn too", usual=0.5, gt=0, le=1000
    )
    rate_max: float = quantity(..., "p.u./s", "rate limit of the setpoint", usual=10, gt=0, le=1e4)
    pf: float = quantity(1.0, "-", "power factor of what is modulated, which draws reactive power", ge=0.5, le=1)
    V_min: float = quantity(0.7, "p.u.", "voltage of its bus below which the power falls with its square", ge=0.1, le=1)


class Bess(Parallel):
    """A [battery](facts_devices.md) at a bus: active power by its setpoint, reactive power by a droop of voltage.

    Its setpoint is the power into the grid, in p.u. of the system base; discharging is positive. The power is also
    limited by the rating, and near empty or full in proportion to the rest. One that is not installed does nothing.
    """

    kind: Literal["bess"] = _kind()
    setpoint_max: float = quantity(..., "p.u.", "limit of the setpoint, power into the grid", usual=0.5, gt=0, le=1000)
    rate_max: float = quantity(..., "p.u./s", "rate limit of the setpoint", usual=10, gt=0, le=1e4)
    S_rated: float = quantity(..., "MVA", "rating of the converter", usual=50, gt=0, le=1e5)
    E_rated: float = quantity(..., "MWh", "energy from a charge of 0 to 1", usual=25, gt=0, le=1e6)
    charge: float = quantity(0.5, "-", "initial charge; from `charge_min` to `charge_max`", ge=0, le=1)
    charge_min: float = quantity(0.1, "-", "charge at which discharging has ended", ge=0, le=1)
    charge_max: float = quantity(0.9, "-", "charge at which charging has ended", ge=0, le=1)
    taper: float = quantity(
        0.02, "-", "width of the bands of charge at both ends in which the power limit falls to zero", ge=1e-4, le=0.5
    )
    eta_in: float = quantity(0.95, "-", "efficiency of charging", ge=0.1, le=1)
    eta_out: float = quantity(0.95, "-", "efficiency of discharging", ge=0.1, le=1)
    K: float = quantity(0.0, "p.u.", "gain of the voltage support: reactive power per voltage; 0: none", ge=0, le=1e4)
    V_min: float = quantity(0.7, "p.u.", "voltage of its bus below which the power falls with its square", ge=0.1, le=1)

    @model_validator(mode="after")
    def _consistent(self) -> Bess:
        if self.charge_max - self.charge_min < 2.0 * self.taper:
            given = f"{self.charge_min}, {self.charge_max} and {self.taper}"
            raise ValueError(f"charge_max must be at least charge_min + 2 taper, given {given}")
        if not self.charge_min <= self.charge <= self.charge_max:
            given = f"{self.charge}, {self.charge_min} and {self.charge_max}"
            raise ValueError(f"charge must be between charge_min and charge_max, given {given}")
        return self


class Tcsc(Series):
    """A thyristor-controlled series capacitor ([TCSC](facts_devices.md)); data on the system base.

    Its setpoint is added to its reactance, capacitive positive. It stands as an SSSC does. If it is not installed, it
    remains as a fixed series capacitor.
    """

    kind: Literal["tcsc"] = _kind()
    rs: float = quantity(1e-6, "p.u.", "resistance", ge=1e-6, le=1)
    xs: float = quantity(0.001, "p.u.", "inductive reactance while it is bypassed", gt=0, le=1)
    X: float = quantity(
        ..., "p.u.", "capacitive reactance without a setpoint; from `X_min` to `X_max`", usual=0.01, ge=-1, le=1
    )
    X_min: float = quantity(..., "p.u.", "smallest capacitive reactance; negative: inductive", usual=0, ge=-1, le=1)
    X_max: float = quantity(..., "p.u.", "largest capacitive reactance", usual=0.02, ge=-1, le=1)
    setpoint_max: float = quantity(
        ..., "p.u.", "limit of the setpoint, capacitive reactance added", usual=0.005, gt=0, le=1
    )
    rate_max: float = quantity(..., "p.u./s", "rate limit of the setpoint", usual=0.2, gt=0, le=1000)
    T: float = quantity(0.015, "s", "time constant with which the reactance follows", ge=0.001, le=10)
    I_max: float = quantity(1000.0, "p.u.", "current above which it is bypassed", gt=0, le=1000)

    @property
    def reactance(self) -> float:
        """Its reactance at rest, p.u., inductive positive."""
        return -self.X

    @model_validator(mode="after")
    def _consistent(self) -> Tcsc:
        if not self.X_min <= self.X <= self.X_max:
            raise ValueError(f"X must be between X_min and X_max, given {self.X}, {self.X_min} and {self.X_max}")
        return self


class ExciterInput(AtMachine):
    """An [exciter input](facts_devices.md): a wide-area signal added to a machine's voltage regulator.

    Its setpoint is added where a stabiliser adds its output. The machine needs an exciter.
    """

    kind: Literal["exciter_input"] = _kind()
    setpoint_max: float = quantity(
        0.1, "p.u.", "limit of the setpoint, an offset of the voltage reference; usual: 0.05 to 0.1", gt=0, le=1
    )
    rate_max: float = quantity(10.0, "p.u./s", "rate limit of the setpoint", gt=0, le=1000)


ACTUATORS: list[type[DeviceModel]] = [LoadModulation, Bess, Tcsc, ExciterInput]
