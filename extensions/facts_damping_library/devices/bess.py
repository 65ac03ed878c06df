"""Battery storage: power by its setpoint within rating and charge, voltage support by a droop."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, Literal

from facts_damping.compiling import compiled
from facts_damping.devices.base import KIND, Parallel
from facts_damping.devices.kind import DeviceKind, Shown, Site, Start, first_state, table
from facts_damping.devices.power_at_bus import current, power_fraction
from facts_damping.fields import quantity

if TYPE_CHECKING:
    from facts_damping.compiling.structs import Float1


class Bess(Parallel):
    """A [battery](facts_devices.md) at a bus: active power by its setpoint, reactive power by a droop of voltage.

    Its setpoint is the power into the grid, in p.u. of the system base; discharging is positive. The power is also
    limited by the rating, and near empty or full in proportion to the rest. One that is not installed does nothing.
    """

    kind: Literal["bess"] = KIND
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

    def check(self) -> None:
        """Raise `ValueError` where fields contradict each other."""
        if self.charge_max - self.charge_min < 2.0 * self.taper:
            values = f"{self.charge_min}, {self.charge_max} and {self.taper}"
            raise ValueError(f"charge_max must be at least charge_min + 2 taper, given {values}")
        if not self.charge_min <= self.charge <= self.charge_max:
            values = f"{self.charge}, {self.charge_min} and {self.charge_max}"
            raise ValueError(f"charge must be between charge_min and charge_max, given {values}")


STATES = ["charge"]
FIELDS = ("charge_min", "charge_max", "taper", "eta_in", "eta_out", "K", "V_min")
TABLE = table("S", "E", "Vref", *FIELDS)  # rating, p.u.; energy, p.u. s


def start(device: Bess, site: Site) -> Start:
    """The device at rest: no power, its initial charge, and the matching voltage reference."""
    S, E = device.S_rated / site.base_power, 3600.0 * device.E_rated / site.base_power
    row = (site.offset, S, E, site.size, *(getattr(device, name) for name in FIELDS))
    return Start(row, [device.charge], 0.0)


@compiled
def active(d: Any, charge: float, u: float) -> float:
    """Active power at a charge before the effect of low voltage, p.u.

    P = clip(u, -S f, S f), f = clip((charge_max - charge) / taper, 0, 1) for charging and
    clip((charge - charge_min) / taper, 0, 1) for discharging.
    """
    limit = d.S * min(max((charge - d.charge_min) / d.taper, 0.0), 1.0)
    floor = -d.S * min(max((d.charge_max - charge) / d.taper, 0.0), 1.0)
    return min(max(u, floor), limit)  # type: ignore[no-any-return]


@compiled
def characteristic(device: Any, x: Float1, u: float, voltage: float) -> tuple[complex, complex]:
    """Current into the network relative to the voltage's direction, of P + j Q, and its derivative by |V|; p.u.

    Q = clip(K (Vref - V), +-sqrt(S^2 - P^2)): active power has priority.
    """
    d = device.bess
    P = active(d, x[d.offset], u)
    room = math.sqrt(d.S * d.S - P * P)
    Q, slope = d.K * (d.Vref - voltage), -d.K
    if abs(Q) > room:
        Q, slope = math.copysign(room, Q), 0.0
    return current(P, Q, slope, voltage, d.V_min)


@compiled
def derivatives(device: Any, x: Float1, u: float, voltage: float, dx: Float1) -> None:
    """Write the derivative of the charge, 1/s: -P / (eta_out E) discharging, -eta_in P / E charging."""
    d = device.bess
    P = active(d, x[d.offset], u) * power_fraction(voltage, d.V_min)
    dx[d.offset] = -(P / d.eta_out if P > 0.0 else P * d.eta_in) / d.E


SHOWN = Shown("BESS (battery storage)", "active power supplied", "discharges", "power supplied", "charge")
ROW = DeviceKind(
    TABLE, STATES, start, characteristic, derivatives, first_state, integrals=STATES, model=Bess, shown=SHOWN, new={}
)
