"""Parameters of controllers: default, unit, range, meaning."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from facts_damping.elementary import log
from facts_damping.neurofuzzy.learning import RATES
from facts_damping.neurofuzzy.table import IDENTIFIERS

if TYPE_CHECKING:
    from facts_damping.compiling.structs import Float1

OFF_ON = ("off", "on")

MAX_AHEAD = 60  # most frames that an identifier may predict ahead


Value = float | str | list[float]  # a list has one entry per signal or device


def four_digits(value: float) -> float:
    """A value rounded to four significant digits."""
    return float(f"{value:.4g}")


class Range(NamedTuple):
    """Search range of a parameter, on a linear or logarithmic scale."""

    low: float
    high: float
    logarithmic: bool = False

    def value(self, at: float) -> float:
        """The value at a position from 0 to 1, to four significant digits."""
        if self.logarithmic:
            return four_digits(self.low * (self.high / self.low) ** at)
        return four_digits(self.low + at * (self.high - self.low))

    def place(self, value: float) -> float:
        """The position of a value, 0 to 1; a value outside is clipped."""
        inside = min(max(value, self.low), self.high)
        if self.logarithmic:
            return log(inside / self.low) / log(self.high / self.low)  # type: ignore[no-any-return]
        return (inside - self.low) / (self.high - self.low)


def powers(low: float, high: float) -> Range:
    """A search range on a logarithmic scale."""
    return Range(low, high, logarithmic=True)


class Parameter(NamedTuple):
    """A controller's parameter: default, unit, allowed range or choices, meaning."""

    default: Value
    unit: str
    low: float
    high: float
    description: str
    choices: tuple[str, ...] = ()  # of a text parameter
    deployed: float | str | None = None  # default in the profile `deployed`, if different
    live: bool = True  # may change during a run
    each: str = ""  # `signal` or `device`: may be a list with one entry for each
    whole: bool = False  # an integer
    search: Range | None = None  # range for `tune` and `search`; None: not searched

    def number(self, value: Value) -> float | Float1:
        """A value for compiled functions: the number itself, or the index of a text among the choices."""
        if self.choices:
            return float(self.choices.index(str(value)))
        return np.array(value) if isinstance(value, list) else float(value)


def _choice(default: str, choices: tuple[str, ...], text: str, deployed: str | None = None) -> Parameter:
    return Parameter(default, "", 0, len(choices) - 1, text, choices, deployed)


def _start(
    default: float, low: float, high: float, text: str, each: str = "", search: Range | None = None
) -> Parameter:
    return Parameter(default, "-", low, high, text, live=False, each=each, search=search)


# For controllers that use a model of the plant and its delay.
LOOP_DELAY = Parameter(
    -1.0,
    "s",
    -1.0,
    10.0,
    "delay from measurement to actuation; -1: PMU filter, mean of the link, dead time",
    live=False,
)

# For `compensation` (control/compensation.py); without it they have no effect.
COMPENSATION_PARAMETERS = {
    "mode_hz": Parameter(
        0.0, "Hz", 0.0, 10.0, "frequency that is compensated; 0: that of the least damped mode", live=False
    ),
    "down_delay": Parameter(
        -1.0, "s", -1.0, 10.0, "delay from controller to actuation; -1: mean of the link, dead time", live=False
    ),
    "latency_filter": Parameter(0.5, "s", 0.0, 100.0, "time constant of the filter of the measured latency"),
    "phasor_rate": Parameter(4.0, "1/s", 0.01, 100.0, "forgetting rate of the phasor"),
}

LEAD_LAG_PARAMETERS = {
    "gain": Parameter(
        10.0, "p.u./p.u.", -1000.0, 1000.0, "gain kG of the washout", each="device", search=powers(1.0, 200.0)
    ),
    "Tw": Parameter(10.0, "s", 0.01, 1000.0, "time constant of the washout", each="device"),
    "T1": Parameter(0.0761, "s", 0.0, 100.0, "numerator of the first section", each="device", search=powers(0.01, 1.0)),
    "T2": Parameter(
        0.3, "s", 0.001, 100.0, "denominator of the first section", each="device", search=powers(0.01, 1.0)
    ),
    "T3": Parameter(
        0.4272, "s", 0.0, 100.0, "numerator of the second section", each="device", search=powers(0.01, 1.0)
    ),
    "T4": Parameter(
        0.3, "s", 0.001, 100.0, "denominator of the second section", each="device", search=powers(0.01, 1.0)
    ),
    **COMPENSATION_PARAMETERS,
}

# small_signal/lqg.py designs the matrices from these at the start.
LQG_PARAMETERS = {
    "control_weight": Parameter(
        1e-6,
        "p.u.",
        1e-12,
        1e3,
        "price of a setpoint at its limit, relative to squared speed differences",
        live=False,
        search=powers(1e-10, 1e-2),
    ),
    "measurement_noise": Parameter(
        0.01,
        "p.u.",
        1e-9,
        1e6,
        "noise for torque steps of 1 p.u., relative to the signal's swing in the least damped mode",
        live=False,
        each="signal",
        search=powers(1e-3, 1e3),
    ),
    "loop_delay": LOOP_DELAY,
}

# small_signal/loop_shaping.py designs the matrices from these at the start.
LOOP_SHAPING_PARAMETERS = {
    "gain": LEAD_LAG_PARAMETERS["gain"]._replace(live=False, description="gain of the shaped plant"),
    "Tw": LEAD_LAG_PARAMETERS["Tw"]._replace(live=False),
    "above": Parameter(
        1.2,
        "-",
        1.01,
        10.0,
        "gamma of the design, relative to the smallest possible gamma",
        live=False,
        search=Range(1.02, 3.0),
    ),
    "loop_delay": LOOP_DELAY,
}

# Safety measures are off where the thesis has none; the profile `deployed` turns on those for safe adaptation.
NEURO_FUZZY_PARAMETERS = {
    "scale": Parameter(
        0.01,
        "p.u.",
        1e-6,
        1e3,
        "signal that gives an input of 1; a single number is for the first signal, others in proportion",
        each="signal",
        search=powers(0.001, 0.05),
    ),
    "change_scale": Parameter(
        0.001,
        "p.u./frame",
        1e-8,
        1e3,
        "the same for the signal's change in a frame",
        each="signal",
        search=powers(1e-4, 0.01),
    ),
    "range": Parameter(3.0, "-", 0.1, 3.0, "inputs are clipped to -range and range"),
    "weight": _start(
        0.5, -5.0, 5.0, "initial weights of the consequents; 1: the device's limit", "device", search=Range(0.0, 2.0)
    ),
    "spread": _start(0.5, 0.0, 3.0, "initial centres of the memberships: -spread and spread", search=Range(0.1, 1.5)),
    "width": _start(1.0, 0.2, 5.0, "initial widths s of the memberships", search=Range(0.4, 3.0)),
    "dilation": _start(1.0, 0.2, 10.0, "initial dilation nu of the wavelets", search=Range(0.5, 8.0)),
    "rate": _choice(
        "fixed", RATES, "learning rates: `eta`, or `eta` times half of the Lyapunov bound, jointly or by group"
    ),
    "eta": Parameter(
        0.02, "-", 0.0, 1e6, "learning rate, or factor of the best Lyapunov rate", search=powers(1e-4, 0.3)
    ),
    "momentum": Parameter(0.0, "-", 0.0, 0.99, "momentum of the consequents", search=Range(0.0, 0.9)),
    "hbar": Parameter(0.1, "-", 0.0, 1e6, "penalty on effort", each="device", search=powers(0.001, 1.0)),
    "sensitivity": Parameter(0.0, "-", -1.0, 1.0, "sign of dy/du; 0: that of the linearised plant", live=False),
    "dead_zone": Parameter(
        0.0, "-", 0.0, 10.0, "smaller errors, in units of `scale`, count as 0; 0: off", deployed=1e-3
    ),
    "leakage": Parameter(
        0.0, "1/frame", 0.0, 1.0, "fraction by which parameters return to their start; 0: off", search=powers(1e-5, 0.1)
    ),
    "projection": _choice("off", OFF_ON, "on: parameters stay within their bounds", deployed="on"),
    "clip": Parameter(0.0, "-", 0.0, 1e3, "largest norm of a step of all parameters; 0: off", deployed=0.5),
    "anti_windup": _choice("off", OFF_ON, "on: learning uses the applied setpoint", deployed="on"),
    "stale": Parameter(0.0, "s", 0.0, 1e3, "older frames are not learnt from; 0: off", deployed=1.0),
    "sign_guard": _choice("off", OFF_ON, "on: an estimated Jacobian of the wrong sign counts as zero", deployed="on"),
    "identifier": Parameter("ANFTSI", "", 0, 1, "neuro-fuzzy model of the identifier", tuple(IDENTIFIERS), live=False),
    "identifier_horizon": Parameter(1.0, "frames", 1.0, MAX_AHEAD, "how far it predicts ahead", live=False, whole=True),
    "identifier_span": Parameter(
        0.0,
        "frames",
        0.0,
        MAX_AHEAD,
        "distance of two past values that it uses; 0: it uses one",
        live=False,
        whole=True,
    ),
    "identifier_rate": _choice("lyapunov", RATES, "`rate` of the identifier"),
    "identifier_eta": Parameter(0.1, "-", 0.0, 100.0, "`eta` of the identifier", search=powers(0.001, 1.0)),
    "identifier_momentum": Parameter(0.0, "-", 0.0, 0.99, "`momentum` of the identifier"),
    "identifier_leakage": Parameter(
        0.0, "1/frame", 0.0, 1.0, "`leakage` of the identifier", deployed=1e-3, search=powers(1e-4, 1.0)
    ),
    "identifier_weight": _start(1.5, 0.2, 5.0, "initial weights of the identifier", search=Range(0.5, 4.0)),
    "loop_delay": LOOP_DELAY,
    **COMPENSATION_PARAMETERS,
}

# Renamed parameters: an error for the old name gives the new one.
RENAMED = {"lag": "loop_delay", "effort": "control_weight", "noise": "measurement_noise"}
