"""Names, units and layouts of everything that is measured, sent and recorded.

Tables are NumPy arrays of structured type, so that the compiled functions, the nodes and the
analysis read the same fields by the same names. Times are integer nanoseconds of simulated time.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

NANOSECONDS = 1_000_000_000


def to_ns(seconds: float) -> int:
    """Seconds as integer nanoseconds, to the nearest."""
    return round(seconds * NANOSECONDS)


# What a PMU station reports, in the order of the columns of a frame: name, unit. NaN = not available.
CHANNELS = {
    "voltage_magnitude": "pu",
    "voltage_angle": "rad",
    "speed_deviation": "pu",
    "active_power": "pu",
    "reactive_power": "pu",
}

# One entry of a PMU frame as a link delivers it. `values` are in the order of CHANNELS.
DELIVERY = np.dtype(
    [
        ("tick", "i8"),  # tick in which it is delivered
        ("station", "i8"),  # index of the station
        ("link", "i8"),  # index of the link that delivers it, among those of the run
        ("measured_ns", "i8"),  # time of measurement
        ("arrival_ns", "i8"),  # time of arrival at the controllers
        ("values", "f8", (len(CHANNELS),)),
    ]
)

# One setpoint of one device, as a controller issues it or as a link delivers it.
SETPOINT = np.dtype(
    [
        ("tick", "i8"),  # tick in which it is issued, or delivered
        ("controller", "i8"),  # index of the controller in the run
        ("device", "i8"),  # index of the device in the run
        ("measured_ns", "i8"),  # time of measurement of the newest frame it rests on
        ("issued_ns", "i8"),  # time at which the controller computed it
        ("effective_ns", "i8"),  # time at which it reaches the device (as issued: issued_ns)
        ("value", "f8"),  # p.u. of the system's base voltage
    ]
)

# What an identifier estimates after a tick, a row for each of its signals and devices.
ESTIMATE = np.dtype(
    [
        ("tick", "i8"),
        ("controller", "i8"),  # index of the controller in the run that it serves
        ("signal", "i8"),  # index of the signal among the controller's
        ("device", "i8"),  # index of the device in the run
        ("measured_ns", "i8"),  # time of measurement of the newest frame it rests on; -1: none yet
        ("jacobian", "f8"),  # p.u. of the signal per p.u. of setpoint, one frame ahead
        ("prediction", "f8"),  # p.u.; NaN: none yet
        ("error", "f8"),  # p.u., prediction less measurement; NaN: none yet
        ("ahead", "f8"),  # s, how far `change` looks ahead; NaN: not asked for
        ("change", "f8"),  # p.u., predicted from the frame after the newest over `ahead`; NaN: none
    ]
)

# How a network learns, after a tick: a row for each output and group of parameters (h, s, w and so on).
LEARNING = np.dtype(
    [
        ("tick", "i8"),
        ("controller", "i8"),  # index of the controller in the run
        ("identifier", "i8"),  # 0: the controller's own network, 1: its identifier's
        ("output", "i8"),  # index of the output: a device of the controller, a signal of the identifier
        ("group", "i8"),  # index of the group, in the order of the network's parameters
        ("rate", "f8"),  # learning rate of the newest frame that taught
        ("lyapunov", "f8"),  # Lyapunov function at that frame, normalised (6.15), (6.10)
        ("fall", "f8"),  # its fall by the step, to first order in the parameters
    ]
)

# The truth about a machine, which no PMU sees as a whole.
MACHINE_TRUTH = np.dtype(
    [
        ("rotor_angle", "f8"),  # rad, against the synchronously rotating frame
        ("speed_deviation", "f8"),  # p.u. of synchronous speed
        ("electrical_power", "f8"),  # p.u. of the system base, air-gap power
        ("mechanical_power", "f8"),  # p.u. of the system base, from the turbine
        ("field_voltage", "f8"),  # p.u., 1 = open-circuit rated voltage on the air-gap line
        ("terminal_voltage", "f8"),  # p.u.
    ]
)

# The truth about a FACTS device. A setpoint is a series voltage, or at a bus an offset of the voltage reference. What
# has no meaning for a kind is NaN.
DEVICE_TRUTH = np.dtype(
    [
        ("setpoint", "f8"),  # p.u., the setpoint in force, after limits
        ("reference", "f8"),  # p.u., the setpoint after the rate limit
        ("injected_voltage", "f8"),  # p.u., quadrature voltage, capacitive positive; NaN: no series device
        ("active_voltage", "f8"),  # p.u., in phase with the current, drop positive; NaN: no series device
        ("current", "f8"),  # p.u. of the system base
        ("dc_voltage", "f8"),  # p.u. of the rated DC voltage; NaN: no DC link
        ("active_power", "f8"),  # p.u. of the system base, given to the network
        ("reactive_power", "f8"),  # p.u. of the system base, given to the network
        ("blocked", "f8"),  # 1 = blocked (too little current or voltage, or no solution)
    ]
)


@dataclass(frozen=True)
class Record:
    """Everything that one closed loop left behind: from `loop.run` or from a recording alike.

    `frames` has shape (ticks, stations, channels), `machines` (ticks, machines) of MACHINE_TRUTH,
    `devices` (ticks, devices) of DEVICE_TRUTH; `delivered` has a row an entry (DELIVERY), `issued`
    and `applied` a row a setpoint (SETPOINT), `estimates` a row an identified derivative (ESTIMATE), `learning` a row a
    learning rate (LEARNING).
    `in_synchronism` is false at the tick that ended an unstable run. `notes` says what a damaged
    recording lacks.
    """

    configuration: dict[str, Any]
    stations: list[str]
    machine_names: list[str]
    device_names: list[str]
    controller_names: list[str]
    time_ns: NDArray[np.int64]
    frames: NDArray[np.float64]
    delivered: NDArray[Any]
    issued: NDArray[Any]
    applied: NDArray[Any]
    machines: NDArray[Any]
    devices: NDArray[Any]
    in_synchronism: NDArray[np.bool_]
    estimates: NDArray[Any] = field(default_factory=lambda: np.zeros(0, ESTIMATE))
    learning: NDArray[Any] = field(default_factory=lambda: np.zeros(0, LEARNING))
    events: list[dict[str, Any]] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)

    @property
    def time_s(self) -> NDArray[np.float64]:
        """Time of every tick, s."""
        return self.time_ns / NANOSECONDS
