"""Names, units and layouts of all quantities that are measured, sent and recorded.

Tables are NumPy arrays of structured type, so that compiled functions, nodes and analysis use the same field names.
Times are integer nanoseconds of simulated time.
"""

from __future__ import annotations

from typing import Annotated, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from facts_damping.compiling.structs import Array
from facts_damping.monitor_table import MONITORS

NANOSECONDS = 1_000_000_000
NEVER = np.iinfo(np.int64).max  # ns, a time that never comes
NOT_YET = -1  # ns, time of an event that has not happened yet


def to_ns(seconds: float) -> int:
    """Seconds as integer nanoseconds, to the nearest."""
    return round(seconds * NANOSECONDS)


def start_of(tick: int, frame_rate: int) -> int:
    """Start of a tick, ns: t_k = k / f, rounded down."""
    return tick * NANOSECONDS // frame_rate


class Span(NamedTuple):
    """A tick with its start and end."""

    tick: int
    start_ns: int
    end_ns: int


# Channels of a PMU in the order of a frame's columns: name, unit. NaN: not available.
CHANNELS = {
    "voltage_magnitude": "pu",
    "voltage_angle": "rad",
    "speed_deviation": "pu",
    "active_power": "pu",
    "reactive_power": "pu",
    "frequency": "hz",
    "rocof": "hz_per_s",
    "current_magnitude": "pu",
    "current_angle": "rad",
}

# One entry of a PMU frame as a link delivers it. `values` are in the order of CHANNELS.
DELIVERY = np.dtype(
    [
        ("tick", "i8"),  # tick in which it is delivered
        ("pmu", "i8"),  # index of the PMU
        ("link", "i8"),  # index of the link that delivers it, among those of the run
        ("status", "i8"),  # bits of PmuFrame.msg
        ("measured_ns", "i8"),  # time of measurement, by the PMU's clock
        ("arrival_ns", "i8"),  # time of arrival at the controllers
        ("values", "f8", (len(CHANNELS),)),
    ]
)

SPEED_BAND = 0.2  # p.u. about synchronous speed, beyond which the machine model is not valid

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

# Estimates of an identifier after a tick: one row for each of its signals and devices.
ESTIMATE = np.dtype(
    [
        ("tick", "i8"),
        ("controller", "i8"),  # index of the controller in the run that it serves
        ("signal", "i8"),  # index of the signal among the controller's
        ("device", "i8"),  # index of the device in the run
        ("measured_ns", "i8"),  # time of measurement of the newest frame it rests on; -1: none yet
        ("jacobian", "f8"),  # p.u. of the signal per p.u. of setpoint, `horizon` frames ahead
        ("prediction", "f8"),  # p.u.; NaN: none yet
        ("error", "f8"),  # p.u., prediction less measurement; NaN: none yet
        ("ahead", "f8"),  # s, how far `change` looks ahead; NaN: not asked for
        ("change", "f8"),  # p.u., predicted from the frame after the newest over `ahead`; NaN: none
    ]
)

# Learning of a network after a tick: one row for each output and group of parameters (h, s, w and so on).
LEARNING = np.dtype(
    [
        ("tick", "i8"),
        ("controller", "i8"),  # index of the controller in the run
        ("identifier", "i8"),  # 0: the controller's own network, 1: its identifier's
        ("output", "i8"),  # index of the output: a device of the controller, a signal of the identifier
        ("group", "i8"),  # index of the group, in the order of the network's parameters
        ("rate", "f8"),  # learning rate at the newest frame used for learning
        ("lyapunov", "f8"),  # Lyapunov function at that frame, normalised (6.15), (6.10)
        ("fall", "f8"),  # its decrease by the step, to first order in the parameters
    ]
)

# State of a supervisor after a tick; codes as in `facts_damping.monitor_table`.
SUPERVISION = np.dtype(
    [
        ("tick", "i8"),
        ("controller", "i8"),  # index of the controller in the run
        ("state", "i8"),
        ("cause", "i8"),
        ("refused", "i8"),
        ("fraction", "f8"),  # progress of the newest switch-over between setpoint sources, 0 to 1
        ("values", "f8", (len(MONITORS),)),  # values of the monitors; NaN: unknown
        ("probe_gain", "f8"),  # of the device whose response is known least; NaN: not probed
        ("probe_phase", "f8"),  # rad
        ("probe_coherence", "f8"),
        ("added_damping", "f8"),  # 1/s, reduction of the mode's growth rate by the controller, from the probe
        ("phase_margin", "f8"),  # rad, phase error in either direction at which the added damping becomes zero
        ("gain_margin", "f8"),  # factor on the gain at which the mode neither decays nor grows; NaN: none
    ]
)

# True state of a machine, which PMUs do not measure completely.
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

# True state of a FACTS device. The setpoint is a series voltage; at a bus, an offset of the voltage reference; for an
# HVDC link, power added to its order, with current and power at its `to` bus. NaN: not applicable to the kind.
DEVICE_TRUTH = np.dtype(
    [
        ("setpoint", "f8"),  # p.u., the setpoint in force, after limits
        ("reference", "f8"),  # p.u., the setpoint after the rate limit
        ("injected_voltage", "f8"),  # p.u., quadrature voltage, capacitive positive; NaN: no series device
        ("active_voltage", "f8"),  # p.u., in phase with the current, drop positive; NaN: no series device
        ("current", "f8"),  # p.u. of the system base
        ("dc_voltage", "f8"),  # p.u. of the rated DC voltage; NaN: no DC link
        ("state", "f8"),  # p.u.: charge of a battery, reactance of a TCSC, susceptance of an SVC; NaN: none of these
        ("active_power", "f8"),  # p.u. of the system base, supplied to the network
        ("reactive_power", "f8"),  # p.u. of the system base, supplied to the network
        ("blocked", "f8"),  # 1 = blocked (too little current or voltage, or no solution)
        ("released", "f8"),  # 1 = released by its watchdog: it accepts no setpoint
        ("refused_value", "f8"),  # setpoints refused by its watchdog so far: not finite or beyond the limit,
        ("refused_stamp", "f8"),  # too old or from the future,
        ("refused_order", "f8"),  # not newer than a previous one
    ]
)

# Table types for compiled functions.
Deliveries = Annotated[NDArray[Any], Array(DELIVERY, 1)]
Deliveries2 = Annotated[NDArray[Any], Array(DELIVERY, 2)]
Setpoints = Annotated[NDArray[Any], Array(SETPOINT, 1)]
Estimates = Annotated[NDArray[Any], Array(ESTIMATE, 1)]
Learnings = Annotated[NDArray[Any], Array(LEARNING, 1)]
Supervisions = Annotated[NDArray[Any], Array(SUPERVISION, 1)]
MachineTruths = Annotated[NDArray[Any], Array(MACHINE_TRUTH, 1)]
DeviceTruths = Annotated[NDArray[Any], Array(DEVICE_TRUTH, 1)]


FLAGS = ("blocked", "released")  # fields of DEVICE_TRUTH that are flags
SUPERVISION_FIELDS = {  # number fields of a SupervisorState, by the field of SUPERVISION
    "fraction": "fraction",
    "probe_gain": "probe_gain",
    "probe_phase": "probe_phase_rad",
    "probe_coherence": "probe_coherence",
    "added_damping": "added_damping_per_s",
    "phase_margin": "phase_margin_rad",
    "gain_margin": "gain_margin",
}
REFUSED = ("refused_value", "refused_stamp", "refused_order")  # its counters of refused setpoints, by cause

# Units of the truth's fields; all others are p.u.
TRUTH_UNITS = {"rotor_angle": "rad", **dict.fromkeys((*FLAGS, *REFUSED), "-")}


def truth_field(name: str) -> str:
    """Name of a truth's field in messages and columns: with its unit, if it has one."""
    unit = TRUTH_UNITS.get(name, "pu")
    return name if unit == "-" else f"{name}_{unit}"
