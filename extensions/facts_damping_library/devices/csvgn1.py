"""CSVGN1: a static var compensator of a capacitor and a reactor behind thyristors, as a part of a grid; compiled.

Source: PSS/E Model Library; PowerSimulationsDynamics.jl (BSD-3), `src/models/device.jl`, for bases and signs.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, ClassVar, Literal, NamedTuple

from facts_damping.devices.base import KIND
from facts_damping.errors import InputError
from facts_damping.extending import DeviceKind, Parallel, Shown, Start, compiled, quantity, table

if TYPE_CHECKING:
    from facts_damping.compiling.structs import Float1
    from facts_damping.devices.kind import Site

SHORTEST = 0.001  # s, of T3, T4 and T5
ROUND_OFF = 1e-9  # p.u. of MBASE


class Csvgn1(Parallel):
    """PSS/E's static var compensator CSVGN1: a capacitor less a reactor of MBASE, of which y is on; always in service.

    y follows K (V - Vref) through (1 + s T1) (1 + s T2) / ((1 + s T3) (1 + s T4)), from VMIN to VMAX, and the lag T5,
    from RMIN / MBASE to 1. The susceptance is CBASE - y MBASE. Vref follows from Q. Its setpoint is added to Vref.
    """

    kind: Literal["csvgn1"] = KIND
    permanent: ClassVar[bool] = True
    setpoint_max: float = quantity(0.05, "p.u.", "limit of the setpoint", gt=0, le=1)
    rate_max: float = quantity(5.0, "p.u./s", "rate limit of the setpoint", gt=0, le=1000)
    Q: float = quantity(0.0, "Mvar", "reactive power given at the start", ge=-1e5, le=1e5)
    MBASE: float = quantity(..., "MVA", "reactor, and base of y", usual=100, gt=0, le=1e5)
    CBASE: float = quantity(..., "Mvar", "capacitor", usual=50, ge=-1e5, le=1e5)
    RMIN: float = quantity(0.0, "Mvar", "the least that is on of the reactor", ge=-1e5, le=1e5)
    VMAX: float = quantity(1.0, "p.u.", "limit of the regulator", ge=-1e4, le=1e4)
    VMIN: float = quantity(0.0, "p.u.", "limit of the regulator", ge=-1e4, le=1e4)
    K: float = quantity(..., "p.u.", "gain of the regulator: y per voltage", usual=50, gt=0, le=1e4)
    T1: float = quantity(0.0, "s", "of the numerator", ge=0, le=100)
    T2: float = quantity(0.0, "s", "of the numerator", ge=0, le=100)
    T3: float = quantity(..., "s", "of the denominator; 0: none, without T1", usual=0.15, ge=0, le=100)
    T4: float = quantity(0.0, "s", "of the denominator; 0: none, without T2", ge=0, le=100)
    T5: float = quantity(..., "s", "of the thyristors", usual=0.02, ge=SHORTEST, le=10)

    def check(self) -> None:
        """Raise `ValueError` where fields contradict each other."""
        for above, below in (("T1", "T3"), ("T2", "T4")):
            value, least = getattr(self, below), SHORTEST if getattr(self, above) > 0.0 else 0.0
            if value < least or 0.0 < value < SHORTEST:
                or_none = "" if least else "0, or "
                raise ValueError(f"{below}: {value:g} given; allowed: {or_none}at least {SHORTEST:g} s")
        if not (self.VMIN < self.VMAX and self.RMIN < self.MBASE):
            limits = f"VMIN {self.VMIN:g}, VMAX {self.VMAX:g}, RMIN {self.RMIN:g} and MBASE {self.MBASE:g} given"
            raise ValueError(f"{limits}; allowed: VMIN below VMAX, RMIN below MBASE")


class Rest(NamedTuple):
    """y at the start, p.u. of MBASE, and its limits; `low_by`, `high_by`: fields that are the limits."""

    y: float
    low: float
    high: float
    low_by: str
    high_by: str


def rest(device: Csvgn1, voltage: float) -> Rest:
    """What gives Q at a voltage, p.u.: y = (CBASE - Q / V^2) / MBASE."""
    y = (device.CBASE - device.Q / (voltage * voltage)) / device.MBASE
    low, low_by = max((device.VMIN, "VMIN"), (device.RMIN / device.MBASE, "RMIN"))
    high, high_by = min((1.0, "MBASE"), (device.VMAX, "VMAX"))
    return Rest(y, low, high, low_by, high_by)


FIELDS = ("K", "VMIN", "VMAX", "T5")
TABLE = table("Vref", "B_capacitor", "B_reactor", "low", *FIELDS, "lead_1", "lag_1", "lead_2", "lag_2")
STATES = ["first", "second", "thyristors"]


def consumed_power(device: Csvgn1, _voltages: Any, base_power: float) -> list[complex]:
    """Power drawn at rest, P + j Q, p.u. of the base (MVA)."""
    return [complex(0.0, -device.Q / base_power)]


def start(device: Csvgn1, site: Site) -> Start:
    """The device at rest with its Q. Raises `InputError` if limits exclude it."""
    at, square = rest(device, site.size), site.size * site.size
    if not at.low - ROUND_OFF <= at.y <= at.high + ROUND_OFF:
        least, most = (square * (device.CBASE - y * device.MBASE) for y in (at.high, at.low))
        raise InputError(
            f"devices: {device.name}.Q: {device.Q:g} Mvar given at {site.size:.4g} p.u. of voltage; "
            f"allowed: {least:.4g} to {most:.4g}, by CBASE, {at.high_by} and {at.low_by}"
        )
    y = min(max(at.y, at.low), at.high)
    # With a lag of 0 the section is 1, and its state acts on nothing.
    pairs = (device.T1, device.T3), (device.T2, device.T4)
    sections = [(lead / lag, lag) if lag else (1.0, 1.0) for lead, lag in pairs]
    row = (
        site.offset,
        site.size - y / device.K,
        device.CBASE / site.base_power,
        device.MBASE / site.base_power,
        device.RMIN / device.MBASE,
        *(getattr(device, name) for name in FIELDS),
        *sections[0],
        *sections[1],
    )
    return Start(row, [y, y, y], 0.0)


@compiled
def susceptance(d: Any, x: Float1) -> float:
    """The susceptance, p.u., of a row of TABLE."""
    return d.B_capacitor - d.B_reactor * min(max(x[d.offset + 2], d.low), 1.0)  # type: ignore[no-any-return]


@compiled
def characteristic(device: Any, x: Float1, _u: float, voltage: float) -> tuple[complex, complex]:
    """Current into the network relative to the direction of the voltage, -j B |V|, and its derivative by |V|, p.u."""
    slope = complex(0.0, -susceptance(device.csvgn1, x))
    return slope * voltage, slope


@compiled
def _held(slope: float, motion: float, above: bool, below: bool) -> float:
    """A derivative, 1/s; 0 if a limit is reached, beyond which its motion leads."""
    return 0.0 if (above and motion > 0.0) or (below and motion < 0.0) else slope


@compiled
def derivatives(device: Any, x: Float1, u: float, voltage: float, dx: Float1) -> None:
    """Write the derivatives of the states, 1/s.

    A section (1 + s T1) / (1 + s T3) has the output a = r u + (1 - r) x, r = T1 / T3, with T3 dx = u - x. States stop
    where the regulator's output, or the thyristors', is at its limit and they move it further.
    """
    d = device.csvgn1
    first, second, thyristors = x[d.offset], x[d.offset + 1], x[d.offset + 2]
    error = d.K * (voltage - d.Vref - u)
    between = d.lead_1 * error + (1.0 - d.lead_1) * first
    output = d.lead_2 * between + (1.0 - d.lead_2) * second
    above, below = output >= d.VMAX, output <= d.VMIN
    slope = (error - first) / d.lag_1
    dx[d.offset] = _held(slope, (1.0 - d.lead_1) * slope, above, below)
    slope = (between - second) / d.lag_2
    dx[d.offset + 1] = _held(slope, (1.0 - d.lead_2) * slope, above, below)
    slope = (min(max(output, d.VMIN), d.VMAX) - thyristors) / d.T5
    dx[d.offset + 2] = _held(slope, slope, thyristors >= 1.0, thyristors <= d.low)


@compiled
def truth(device: Any, x: Float1, _u: float, _size: float, _blocked: bool, out: Any) -> None:
    """Write the susceptance as the state of DEVICE_TRUTH."""
    out.state = susceptance(device.csvgn1, x)


SHOWN = Shown(
    "CSVGN1 (SVC of PSS/E)",
    "offset of the voltage reference",
    "raises the bus voltage",
    state="susceptance",
    marker="d",
    outline="M0,-1.2L1.2,1H-1.2Z",
)
ROW = DeviceKind(
    TABLE, STATES, start, characteristic, derivatives, truth, consumed_power=consumed_power, model=Csvgn1, shown=SHOWN
)
