"""Exciter input: a setpoint added where a machine's stabiliser adds its output; compiled.

It has no port: `plant.dynamics` adds the reference of a device at a machine to the regulator's summing point.
"""

from __future__ import annotations

from typing import Literal

from facts_damping.devices.base import KIND, AtMachine
from facts_damping.devices.kind import DeviceKind, Shown, at_rest, no_source, table, without_states
from facts_damping.fields import quantity


class ExciterInput(AtMachine):
    """An [exciter input](facts_devices.md): a wide-area signal added to a machine's voltage regulator.

    Its setpoint is added where a stabiliser adds its output. The machine needs an exciter.
    """

    kind: Literal["exciter_input"] = KIND
    setpoint_max: float = quantity(
        0.1, "p.u.", "limit of the setpoint, an offset of the voltage reference; usual: 0.05 to 0.1", gt=0, le=1
    )
    rate_max: float = quantity(10.0, "p.u./s", "rate limit of the setpoint", gt=0, le=1000)


SHOWN = Shown(
    "exciter input", "offset of a machine's voltage reference", "raises its field voltage", "regulator input", "", "*"
)
ROW = DeviceKind(table(), [], without_states, no_source, at_rest, model=ExciterInput, shown=SHOWN, new={})
