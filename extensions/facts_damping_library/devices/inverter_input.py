"""Inverter input: a setpoint added in the controls of an inverter or of its plant.

It has no port: `plant.dynamics` adds the reference of a device at an inverter to the signal that it names.
"""

from __future__ import annotations

from typing import Literal

from facts_damping.devices.base import KIND, AtInverter, text
from facts_damping.devices.kind import DeviceKind, Shown, at_rest, no_source, table, without_states
from facts_damping.fields import quantity


class InverterInput(AtInverter):
    """An [inverter input](inverters.md): power oscillation damping by an inverter, in p.u. of its rating.

    Its setpoint is added to active power, reactive power or voltage: in the plant's control, behind the inverter's
    lag of communication, or in the inverter's own.
    """

    kind: Literal["inverter_input"] = KIND
    input: Literal["Pplant", "Qplant", "Vplant", "Paux", "Qaux", "Vaux"] = text(
        "what the setpoint is added to: power or voltage, of the plant or of the inverter (`aux`)"
    )
    setpoint_max: float = quantity(0.1, "p.u.", "limit of the setpoint, of the inverter's rating", gt=0, le=2)
    rate_max: float = quantity(10.0, "p.u./s", "rate limit of the setpoint", gt=0, le=1000)


SHOWN = Shown("inverter input", "power or voltage", "raises its power or voltage", "inverter input", "", "*")
ROW = DeviceKind(table(), [], without_states, no_source, at_rest, model=InverterInput, shown=SHOWN, new={})
