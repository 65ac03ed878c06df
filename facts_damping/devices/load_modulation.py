"""Load modulation: power drawn at a bus in addition to its loads, in proportion to the setpoint, as in PSTess."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Literal

from facts_damping.compiling import compiled
from facts_damping.devices.base import KIND, Parallel
from facts_damping.devices.kind import DeviceKind, Shown, Site, Start, at_rest, table
from facts_damping.devices.power_at_bus import beside, current
from facts_damping.fields import quantity

if TYPE_CHECKING:
    from facts_damping.compiling.structs import Float1


class LoadModulation(Parallel):
    """[Load modulation](facts_devices.md): active power drawn at a bus beside its loads.

    Its setpoint is the power, positive for more load, in p.u. of the system base: with a base of 100 MVA a
    `setpoint_max` of 0.5 is 50 MW. One that is not installed does nothing.
    """

    kind: Literal["load_modulation"] = KIND
    setpoint_max: float = quantity(
        ..., "p.u.", "limit of the setpoint, power drawn; as much less must be drawn too", usual=0.5, gt=0, le=1000
    )
    rate_max: float = quantity(..., "p.u./s", "rate limit of the setpoint", usual=10, gt=0, le=1e4)
    pf: float = quantity(1.0, "-", "power factor of what is modulated, which draws reactive power", ge=0.5, le=1)
    V_min: float = quantity(0.7, "p.u.", "voltage of its bus below which the power falls with its square", ge=0.1, le=1)


def start(device: LoadModulation, site: Site) -> Start:
    """The device at rest, without power and states; q: reactive power drawn, relative to the active power."""
    return Start((site.offset, device.V_min, beside(device.pf)), [], 0.0)


@compiled
def characteristic(device: Any, _x: Float1, u: float, voltage: float) -> tuple[complex, complex]:
    """Current into the network that draws u (1 + j q), relative to the voltage's direction, and its derivative, p.u."""
    d = device.load_modulation
    return current(-u, -u * d.q, 0.0, voltage, d.V_min)


SHOWN = Shown("load modulation", "active power drawn", "is more load", "power drawn", marker="v")
ROW = DeviceKind(table("V_min", "q"), [], start, characteristic, at_rest, model=LoadModulation, shown=SHOWN, new={})
