"""The thyristor-controlled series capacitor: a reactance that follows its setpoint; compiled.

A positive setpoint is more capacitive, which raises the transfer (docs/facts_devices.md). Its port stands behind
`rs + j xs`, what is left while it is bypassed, so that its source is the voltage -j (x + xs) I.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Literal

from facts_damping.compiling import compiled
from facts_damping.devices.base import KIND, Series
from facts_damping.devices.kind import DeviceKind, Shown, Site, Start, table
from facts_damping.errors import InputError
from facts_damping.fields import quantity

if TYPE_CHECKING:
    from facts_damping.compiling.structs import Float1


class Tcsc(Series):
    """A thyristor-controlled series capacitor ([TCSC](facts_devices.md)); data on the system base.

    Its setpoint is added to its reactance, capacitive positive. It stands as an SSSC does. If it is not installed, it
    remains as a fixed series capacitor.
    """

    kind: Literal["tcsc"] = KIND
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

    def check(self) -> None:
        """Raise `ValueError` where fields contradict each other."""
        if not self.X_min <= self.X <= self.X_max:
            raise ValueError(f"X must be between X_min and X_max, given {self.X}, {self.X_min} and {self.X_max}")


FIELDS = ("rs", "xs", "X", "X_min", "X_max", "T")


def start(device: Tcsc, site: Site) -> Start:
    """The device at rest with its reactance X. Raises `InputError` if its current is so large that it is bypassed."""
    if site.size > device.I_max:
        raise InputError(
            f"devices: {device.name} carries {site.size:.4g} p.u. at the start; "
            f"allowed: at most I_max, {device.I_max:g}"
        )
    return Start((site.offset, *(getattr(device, name) for name in FIELDS)), [device.X], 0.0, device.I_max)


@compiled
def characteristic(device: Any, x: Float1, _u: float, magnitude: float) -> tuple[complex, complex]:
    """Voltage drop relative to the direction of the current, -j (x + xs) |I|, and its derivative by |I|, p.u."""
    d = device.tcsc
    slope = complex(0.0, -(x[d.offset] + d.xs))
    return slope * magnitude, slope


@compiled
def derivatives(device: Any, x: Float1, u: float, _magnitude: float, dx: Float1) -> None:
    """Write the derivative of the state, p.u./s: T dx = clip(X + u, X_min, X_max) - x."""
    d = device.tcsc
    dx[d.offset] = (min(max(d.X + u, d.X_min), d.X_max) - x[d.offset]) / d.T


@compiled
def truth(device: Any, x: Float1, _u: float, magnitude: float, blocked: bool, out: Any) -> None:
    """Write its fields of DEVICE_TRUTH: reactance, voltages, and the power that it gives."""
    d = device.tcsc
    capacitive = -d.xs if blocked else x[d.offset]
    out.state = x[d.offset]
    out.injected_voltage = capacitive * magnitude
    out.active_voltage = 0.0
    out.current = magnitude
    out.active_power = -d.rs * magnitude * magnitude
    out.reactive_power = capacitive * magnitude * magnitude


RELATIVE = {"X": 0.2, "X_min": 0.1, "X_max": 0.3, "setpoint_max": 0.1, "rate_max": 5.0}  # to the reactance of its line
SHOWN = Shown(
    "TCSC (thyristor-controlled series capacitor)",
    "reactance added",
    "is capacitive, raises the transfer",
    "reactance and voltage",
    "reactance",
    "P",
)
ROW = DeviceKind(
    table(*FIELDS), ["x"], start, characteristic, derivatives, truth, model=Tcsc, shown=SHOWN, new=RELATIVE
)
