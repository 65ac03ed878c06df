"""The table of controllers: one row per kind, with its parameters."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from facts_damping.control import lead_lag
from facts_damping.control.parameter_tables import (
    COMPENSATION_PARAMETERS,
    LEAD_LAG_PARAMETERS,
    LOOP_SHAPING_PARAMETERS,
    LQG_PARAMETERS,
    NEURO_FUZZY_PARAMETERS,
    Parameter,
    Value,
)
from facts_damping.control.parameter_tables import powers as powers  # noqa: PLC0414 (for extensions of before)
from facts_damping.errors import InputError, check_known
from facts_damping.extensions import rows
from facts_damping.neurofuzzy.table import ANTECEDENTS, CONSEQUENTS, MIMO_FORM, VARIANTS, Variant, has_dilation

if TYPE_CHECKING:
    from collections.abc import Callable

    from facts_damping.parameters.run import Controller

LAW, DIRECT, INDIRECT, STATE_SPACE, CALLED, GIVEN = range(6)  # codes of a controller's step
# Fields of a user's own controller: a called program, or a node.
PROGRAMS, NODES = ("policy", "fmu"), ("external", "command")
RUN = ("policy", "fmu", "command")  # fields that name code to run
ANY = 16  # most signals of a controller that takes several


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
    parameters = dict(NEURO_FUZZY_PARAMETERS)
    parameters["identifier"] = parameters["identifier"]._replace(default=network.identifier)
    parameters["width"] = parameters["width"]._replace(default=antecedent.width)
    parameters["range"] = parameters["range"]._replace(default=1.0 if bounded else 3.0)
    return ControllerKind(f"neuro-fuzzy: {network.antecedent} + {network.consequent}", ANY, 0, parameters, network)


CONTROLLERS |= {name: _neuro_fuzzy(variant) for name, variant in VARIANTS.items()}
CONTROLLERS |= rows("controllers", ControllerKind, CONTROLLERS)
# For compiled steps: a record with a field for each parameter of any kind, and the laws.
SETTINGS = np.dtype(
    [(name, "f8") for name in dict.fromkeys(name for row in CONTROLLERS.values() for name in row.parameters)]
)
LAWS = list(dict.fromkeys(row.law for row in CONTROLLERS.values() if row.law is not None))


def kind(name: str, where: str = "controller") -> ControllerKind:
    """The row for a name of the table or any pair `antecedent+consequent`. Raises `InputError` if unknown."""
    name = kind_name(name)
    antecedent, plus, consequent = name.partition("+")
    if not plus:
        others = f"any other name with {' or '.join(f'`{field}`' for field in OWN)}"
        check_known(where, name, [*CONTROLLERS, "antecedent+consequent", others])
        return CONTROLLERS[name]
    check_known(f"{where}: antecedent", antecedent, ANTECEDENTS)
    check_known(f"{where}: consequent", consequent, CONSEQUENTS)
    row = _neuro_fuzzy(Variant(antecedent, consequent, "ANFGuMoI" if has_dilation(consequent) else "ANFTSI"))
    return row._replace(named=False)


def kind_name(name: str) -> str:
    """The kind in a controller's name, which may be that of a tuned law: `KIND@FILE`."""
    return name.partition("@")[0]


def kind_of(controller: Controller, where: str = "controller") -> ControllerKind:
    """The row for a run's controller, by its name or user-defined field. Raises `InputError` if unknown."""
    fields = [field for field in OWN if getattr(controller, field) not in (None, False)]
    if not fields:
        return kind(controller.name, where)
    if len(fields) > 1:
        both = " and ".join(f"`{field}`" for field in fields)
        raise InputError(f"{where}: '{controller.name}' given with {both}; allowed: one of {', '.join(OWN)}")
    if controller.name in CONTROLLERS or "+" in controller.name:
        raise InputError(f"{where}: '{controller.name}' given with `{fields[0]}`; allowed: a name that is not taken")
    return OWN[fields[0]]


def defaults(row: ControllerKind, profile: str, signals: int = 1, devices: int = 1) -> dict[str, Value]:
    """Default parameters of a kind; with several devices the gains of appendix B are 10, 5, 5 and so on."""
    values: dict[str, Value] = {
        name: p.deployed if profile == "deployed" and p.deployed is not None else p.default
        for name, p in row.parameters.items()
    }
    if "gain" in values and devices > 1:
        values["gain"] = [float(values["gain"]), *[MIMO_GAIN] * (devices - 1)]  # type: ignore[arg-type]
    if row.network is not None and signals * devices > 1:
        values["identifier"] = "ANFTSI"  # of chapter 6
    return values


def variant_of(row: ControllerKind, devices: int) -> Variant | None:
    """A kind's neuro-fuzzy variant, or None; with several devices those named in the thesis have affine consequents."""
    if row.network is None or devices == 1 or not row.named:
        return row.network
    return row.network._replace(consequent=MIMO_FORM.get(row.network.consequent, row.network.consequent))
