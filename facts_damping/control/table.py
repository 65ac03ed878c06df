"""The table of controllers: one row per kind, with its parameters."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from facts_damping.control import lead_lag
from facts_damping.elementary import log
from facts_damping.errors import InputError, check_known
from facts_damping.extensions import rows
from facts_damping.neurofuzzy.learning import RATES
from facts_damping.neurofuzzy.table import (
    ANTECEDENTS,
    CONSEQUENTS,
    IDENTIFIERS,
    MIMO_FORM,
    VARIANTS,
    Variant,
    has_dilation,
)

if TYPE_CHECKING:
    from collections.abc import Callable

    from facts_damping.compiling.structs import Float1
    from facts_damping.parameters.run import Controller

LAW, DIRECT, INDIRECT, STATE_SPACE, CALLED, GIVEN = range(6)  # codes of a controller's step
# Fields of a user's own controller: a called program, or a node.
PROGRAMS, NODES = ("policy", "fmu"), ("external", "command")
RUN = ("policy", "fmu", "command")  # fields that name code to run
OFF_ON = ("off", "on")
ANY = 16  # most signals of a controller that takes several
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


class ControllerKind(NamedTuple):
    """A row of the table: a kind of controller."""

    description: str
    signals: int  # most signals
    states: int  # per device
    parameters: dict[str, Parameter]
    network: Variant | None = None
    law: Callable[..., float] | None = None  # compiled step of one device: (settings, states, signal, dt) to p.u.
    design: str = ""  # module:function that designs an observer with state feedback
    tuned: bool = True  # `tune` may tune its parameters
    named: bool = True  # named in the thesis, not an antecedent+consequent pair
    own: str = ""  # the field that defines a user's own controller

    @property
    def compensates(self) -> bool:
        """Whether it can have a `compensation`."""
        return COMPENSATION_PARAMETERS.keys() <= self.parameters.keys()

    @property
    def program(self) -> bool:
        """Whether its step is a user's own program."""
        return self.own in PROGRAMS

    @property
    def node(self) -> bool:
        """Whether it is a user's own node."""
        return self.own in NODES

    def code(self, scheme: str | None) -> int:
        """Code of its step; that of a neuro-fuzzy controller depends on the scheme."""
        if self.network is not None:
            return INDIRECT if scheme == "indirect" else DIRECT
        if self.program:
            return CALLED
        if self.node:
            return GIVEN
        return STATE_SPACE if self.design or self.own else LAW


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
        0.0,
        "Hz",
        0.0,
        10.0,
        "frequency that is compensated; 0: that of the least damped mode",
        live=False,
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
        0.02,
        "-",
        0.0,
        1e6,
        "learning rate, or factor of the best Lyapunov rate",
        search=powers(1e-4, 0.3),
    ),
    "momentum": Parameter(0.0, "-", 0.0, 0.99, "momentum of the consequents", search=Range(0.0, 0.9)),
    "hbar": Parameter(0.1, "-", 0.0, 1e6, "penalty on effort", each="device", search=powers(0.001, 1.0)),
    "sensitivity": Parameter(0.0, "-", -1.0, 1.0, "sign of dy/du; 0: that of the linearised plant", live=False),
    "dead_zone": Parameter(
        0.0, "-", 0.0, 10.0, "smaller errors, in units of `scale`, count as 0; 0: off", deployed=1e-3
    ),
    "leakage": Parameter(
        0.0,
        "1/frame",
        0.0,
        1.0,
        "fraction by which parameters return to their start; 0: off",
        search=powers(1e-5, 0.1),
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
        0.0,
        "1/frame",
        0.0,
        1.0,
        "`leakage` of the identifier",
        deployed=1e-3,
        search=powers(1e-4, 1.0),
    ),
    "identifier_weight": _start(1.5, 0.2, 5.0, "initial weights of the identifier", search=Range(0.5, 4.0)),
    "loop_delay": LOOP_DELAY,
    **COMPENSATION_PARAMETERS,
}

# Renamed parameters: an error for the old name gives the new one.
RENAMED = {"lag": "loop_delay", "effort": "control_weight", "noise": "measurement_noise"}

MIMO_GAIN = 5.0  # kG2 of appendix B, for every device except the first
LLC = ControllerKind(
    "lead-lag: washout and two lead-lag sections (thesis, appendix B)",
    1,
    6,
    LEAD_LAG_PARAMETERS,
    law=lead_lag.step,
    tuned=False,
)
CONTROLLERS = {
    "LLC": LLC,
    "LLC-tuned": LLC._replace(
        tuned=True, description="lead-lag with tuned gain and time constants, one set per system"
    ),
    "LQG": ControllerKind(
        "linear-quadratic-Gaussian: optimal for the linearised plant with the delay",
        ANY,
        0,
        LQG_PARAMETERS,
        design="facts_damping.small_signal.lqg:design",
    ),
    "Hinf": ControllerKind(
        "H-infinity loop shaping for the least damped mode and the delay: a robust design",
        ANY,
        0,
        LOOP_SHAPING_PARAMETERS,
        design="facts_damping.small_signal.loop_shaping:design",
    ),
}

# User's own controllers, by the field that defines them.
OWN = {
    "linear": ControllerKind("a linear law", ANY, 0, COMPENSATION_PARAMETERS, tuned=False, own="linear"),
    "policy": ControllerKind("a class in Python", ANY, 0, {}, tuned=False, own="policy"),
    "fmu": ControllerKind("an FMU", ANY, 0, {}, tuned=False, own="fmu"),
    "external": ControllerKind("a node", ANY, 0, {}, tuned=False, own="external"),
    "command": ControllerKind("a node", ANY, 0, {}, tuned=False, own="command"),
}


def _neuro_fuzzy(network: Variant) -> ControllerKind:
    """The row of a neuro-fuzzy controller; inputs are within [-1, 1] for B-splines and Legendre polynomials."""
    antecedent = ANTECEDENTS[network.antecedent]
    bounded = antecedent.bounded or CONSEQUENTS[network.consequent].bounded
    own = dict(NEURO_FUZZY_PARAMETERS)
    own["identifier"] = own["identifier"]._replace(default=network.identifier)
    own["width"] = own["width"]._replace(default=antecedent.width)
    own["range"] = own["range"]._replace(default=1.0 if bounded else 3.0)
    return ControllerKind(f"neuro-fuzzy: {network.antecedent} + {network.consequent}", ANY, 0, own, network)


CONTROLLERS |= {name: _neuro_fuzzy(variant) for name, variant in VARIANTS.items()}
CONTROLLERS |= rows("controllers", ControllerKind, CONTROLLERS)
# For compiled steps: a record with a field for each parameter of any kind, and the laws.
SETTINGS = np.dtype(
    [(name, "f8") for name in dict.fromkeys(name for row in CONTROLLERS.values() for name in row.parameters)]
)
LAWS = list(dict.fromkeys(row.law for row in CONTROLLERS.values() if row.law is not None))


def kind(name: str, where: str = "controller") -> ControllerKind:
    """The row for a name of the table or any pair `antecedent+consequent`. Raises `InputError` if unknown."""
    antecedent, plus, consequent = name.partition("+")
    if not plus:
        others = f"any other name with {' or '.join(f'`{field}`' for field in OWN)}"
        check_known(where, name, [*CONTROLLERS, "antecedent+consequent", others])
        return CONTROLLERS[name]
    check_known(f"{where}: antecedent", antecedent, ANTECEDENTS)
    check_known(f"{where}: consequent", consequent, CONSEQUENTS)
    found = _neuro_fuzzy(Variant(antecedent, consequent, "ANFGuMoI" if has_dilation(consequent) else "ANFTSI"))
    return found._replace(named=False)


def kind_of(controller: Controller, where: str = "controller") -> ControllerKind:
    """The row for a run's controller, by its name or user-defined field. Raises `InputError` if unknown."""
    given = [field for field in OWN if getattr(controller, field) not in (None, False)]
    if not given:
        return kind(controller.name, where)
    if len(given) > 1:
        both = " and ".join(f"`{field}`" for field in given)
        raise InputError(f"{where}: '{controller.name}' given with {both}; allowed: one of {', '.join(OWN)}")
    if controller.name in CONTROLLERS or "+" in controller.name:
        raise InputError(f"{where}: '{controller.name}' given with `{given[0]}`; allowed: a name that is not taken")
    return OWN[given[0]]


def defaults(kind: ControllerKind, profile: str, signals: int = 1, devices: int = 1) -> dict[str, Value]:
    """Default parameters of a kind; with several devices the gains of appendix B are 10, 5, 5 and so on."""
    found: dict[str, Value] = {
        name: p.deployed if profile == "deployed" and p.deployed is not None else p.default
        for name, p in kind.parameters.items()
    }
    if "gain" in found and devices > 1:
        found["gain"] = [float(found["gain"]), *[MIMO_GAIN] * (devices - 1)]  # type: ignore[arg-type]
    if kind.network is not None and signals * devices > 1:
        found["identifier"] = "ANFTSI"  # of chapter 6
    return found


def variant_of(kind: ControllerKind, devices: int) -> Variant | None:
    """A kind's neuro-fuzzy variant, or None; with several devices those named in the thesis have affine consequents."""
    if kind.network is None or devices == 1 or not kind.named:
        return kind.network
    return kind.network._replace(consequent=MIMO_FORM.get(kind.network.consequent, kind.network.consequent))
