"""The static var compensator: a susceptance that follows a voltage regulator."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Literal

from facts_damping.compiling import compiled
from facts_damping.devices.base import KIND, Parallel
from facts_damping.devices.kind import DeviceKind, Shown, Site, Start, first_state, table
from facts_damping.fields import quantity

if TYPE_CHECKING:
    from facts_damping.compiling.structs import Float1


class Svc(Parallel):
    """A static var compensator ([SVC](facts_devices.md)) at a bus; data on the system base.

    Its setpoint is an offset of its voltage reference. The integration step must be below about 2.8 T/(1 + K X), with
    the reactance X of the network behind its bus. One that is not installed does nothing.
    """

    kind: Literal["svc"] = KIND
    setpoint_max: float = quantity(
        ..., "p.u.", "limit of the setpoint, an offset of the voltage reference", usual=0.05, gt=0, le=1
    )
    rate_max: float = quantity(..., "p.u./s", "rate limit of the setpoint", usual=5, gt=0, le=1000)
    B_max: float = quantity(..., "p.u.", "capacitive limit of the susceptance", usual=2, gt=0, le=1000)
    B_min: float = quantity(..., "p.u.", "inductive limit of the susceptance, negative", usual=-1, ge=-1000, le=0)
    K: float = quantity(
        ..., "p.u.", "gain of the regulator: susceptance per voltage, the inverse slope", usual=30, gt=0, le=1e4
    )
    T: float = quantity(0.05, "s", "time constant with which the susceptance follows", ge=0.001, le=10)
    V_min: float = quantity(0.05, "p.u.", "voltage of its bus below which it is blocked", gt=0, le=0.9)


FIELDS = ("K", "T", "B_min", "B_max")


def start(device: Svc, site: Site) -> Start:
    """The device at rest: zero susceptance, and the matching voltage reference."""
    row = (site.offset, site.size, *(getattr(device, name) for name in FIELDS))
    return Start(row, [0.0], device.V_min)


@compiled
def characteristic(device: Any, x: Float1, _u: float, voltage: float) -> tuple[complex, complex]:
    """Current into the network relative to the direction of the voltage, -j B |V|, and its derivative by |V|, p.u."""
    d = device.svc
    slope = complex(0.0, -x[d.offset])
    return slope * voltage, slope


@compiled
def derivatives(device: Any, x: Float1, u: float, voltage: float, dx: Float1) -> None:
    """Write the derivative of the state, 1/s: T dB = clip(K (Vref + u - V), B_min, B_max) - B."""
    d = device.svc
    wanted = d.K * (d.Vref + u - voltage)
    dx[d.offset] = (min(max(wanted, d.B_min), d.B_max) - x[d.offset]) / d.T


SHOWN = Shown(
    "SVC (static var compensator)",
    "offset of the voltage reference",
    "raises the bus voltage",
    state="susceptance",
    marker="d",
    outline="M0,-1.2L1.2,1H-1.2Z",
)
ROW = DeviceKind(table("Vref", *FIELDS), ["B"], start, characteristic, derivatives, first_state, model=Svc, shown=SHOWN)
