"""Tables of antecedents, consequents and networks."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, NamedTuple

from facts_damping.elementary import exp
from facts_damping.extensions import rows
from facts_damping.neurofuzzy import antecedent, consequent
from facts_damping.neurofuzzy.antecedent import POINTS
from facts_damping.neurofuzzy.consequent import DEGREES, HARMONICS, WAVELETS

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    import numpy as np
    from numpy.typing import NDArray

    Numbers = Sequence[float] | NDArray[np.float64]


class Slot(NamedTuple):
    """Group of a parameter, and its bounds for projection."""

    group: str
    low: float
    high: float


H, S = Slot("h", -3.0, 3.0), Slot("s", 0.2, 5.0)
DEGREE = Slot("degree", 0.01, 1.0)
W, VOLUME = Slot("w", -5.0, 5.0), Slot("V", 0.05, 5.0)
TAU, NU = Slot("tau", -3.0, 3.0), Slot("nu", 0.2, 10.0)


class Antecedent(NamedTuple):
    """A kind of membership: compiled function, parameters, number active at one input, initial values.

    `start(h, s)`: parameters that approximate a gaussian of centre h and width s. `bounded`: inputs are within [-1, 1];
    `width`: default of s, if not 1.
    """

    function: Callable[..., Any]  # antecedent.py
    slots: list[Slot]
    active: int
    start: Callable[[float, float], Sequence[float]]
    description: str
    bounded: bool = False
    width: float = 1.0


class Consequent(NamedTuple):
    """A kind of consequent: compiled function, parameters of a rule and output by number of inputs, initial values.

    `start(w, side, tau, nu)`: parameters with weight w at rest and wavelets shifted by `side` tau and dilated by nu;
    parameters not given are zero. `bounded`: inputs are within [-1, 1].
    """

    function: Callable[..., Any]  # consequent.py
    slots: Callable[[int], list[Slot]]
    start: Callable[[float, float, Numbers, Numbers], Sequence[float]]
    description: str
    bounded: bool = False


class Variant(NamedTuple):
    """A network of the thesis (tables C.1, C.2): antecedent, consequent and its identifier."""

    antecedent: str
    consequent: str
    identifier: str


def _degrees(h: float, s: float) -> list[float]:
    """Degrees of a B-spline that match a gaussian."""
    points = [2.0 * i / (POINTS - 1) - 1.0 for i in range(POINTS)]
    return [min(max(exp(-((point - h) / s) * ((point - h) / s)), DEGREE.low), DEGREE.high) for point in points]


def _weight(w: float, *_: Any) -> list[float]:
    return [w]


def _wavelets(w: float, side: float, tau: Numbers, nu: Numbers) -> list[float]:
    return [w, *(value for t, n in zip(tau, nu, strict=True) for value in (side * t, n))]


ANTECEDENTS = {
    "gaussian": Antecedent(antecedent.gaussian, [H, S], 2, lambda h, s: [h, s], "exp(-((x-h)/s)^2), (3.9): h, s"),
    "triangular": Antecedent(
        antecedent.triangular,
        [H, S],
        2,
        lambda h, s: [h, s],
        "max(0, 1 - 2|x-h|/s), (3.10): h, s",
        width=3.0,  # with 1 they would not overlap
    ),
    "b-spline": Antecedent(
        antecedent.nearest_point,
        [DEGREE] * POINTS,
        1,
        _degrees,
        "degree of the nearest control point, (3.11), figure 3.4",
        bounded=True,
    ),
    "b-spline-interpolated": Antecedent(
        antecedent.spline,
        [DEGREE] * POINTS,
        2,
        _degrees,
        "order-2 curve through the control points, (3.11)",
        bounded=True,
    ),
}
CONSEQUENTS = {
    "singleton": Consequent(consequent.singleton, lambda _: [W], _weight, "w"),
    "affine": Consequent(consequent.affine, lambda m: [W] * (1 + m), _weight, "w_0 + sum_i w_i x_i, (6.4)"),
    "sam": Consequent(
        consequent.sam,
        lambda _: [Slot("c", W.low, W.high), VOLUME],
        lambda w, *_: [w, 1.0],
        "centroid c with volume V > 0, (3.30)",
    ),
    "fourier": Consequent(
        consequent.fourier,
        lambda m: [W] * HARMONICS**m,
        _weight,
        "w . kron_i [1, sin x, cos x, sin 2x, cos 2x], (3.13)",
    ),
    "mexican-hat": Consequent(
        consequent.mexican_hat,
        lambda m: [W] + [TAU, NU] * m,
        _wavelets,
        "w sum_i psi((x_i - tau_i) / nu_i), (3.14, 3.18)",
    ),
    "morlet": Consequent(
        consequent.morlet, lambda m: [W] + [TAU, NU] * m, _wavelets, "w sum_i exp(-q_i^2/2) cos 5 q_i, (3.19)"
    ),
    "legendre": Consequent(
        consequent.legendre, lambda m: [W] * (DEGREES * m), _weight, "tanh(sum_id w_id L_d(x_i)), (3.21)", bounded=True
    ),
    "legendre-wavelet": Consequent(
        consequent.legendre_wavelet,
        lambda _: [W] * WAVELETS,
        lambda w, *_: [w / math.sqrt(2.0)] * 2,  # phi of degree 0 is sqrt(2) on its half
        "sum_db rho_db phi_db(F), (3.22, 3.24)",
    ),
}
ANTECEDENTS |= rows("antecedents", Antecedent, ANTECEDENTS)
CONSEQUENTS |= rows("consequents", Consequent, CONSEQUENTS)
# Codes of the compiled functions: their order in the tables.
MEMBERSHIP_FUNCTIONS = list(dict.fromkeys(row.function for row in ANTECEDENTS.values()))
CONSEQUENT_FUNCTIONS = list(dict.fromkeys(row.function for row in CONSEQUENTS.values()))

# Networks of identifiers (table C.2).
IDENTIFIERS = {"ANFTSI": ("gaussian", "singleton"), "ANFGuMoI": ("gaussian", "morlet")}

# Consequents of the thesis's networks with several outputs, (6.4), (6.9).
MIMO_FORM = {"singleton": "affine"}

VARIANTS = {
    "ANFTSC": Variant("gaussian", "singleton", "ANFTSI"),
    "ANFSC": Variant("gaussian", "sam", "ANFTSI"),
    "ANFFsC": Variant("gaussian", "fourier", "ANFTSI"),
    "ANFGuMeC": Variant("gaussian", "mexican-hat", "ANFGuMoI"),
    "ANFGuMoC": Variant("gaussian", "morlet", "ANFGuMoI"),
    "ANFTrMeC": Variant("triangular", "mexican-hat", "ANFGuMoI"),
    "ANFTrMoC": Variant("triangular", "morlet", "ANFGuMoI"),
    "ANFLeC": Variant("gaussian", "legendre", "ANFTSI"),
    "ANFLeWC": Variant("gaussian", "legendre-wavelet", "ANFTSI"),
    "ANFBsC": Variant("b-spline", "singleton", "ANFTSI"),
    "HBsWC": Variant("b-spline", "morlet", "ANFGuMoI"),
}
VARIANTS |= rows("variants", Variant, VARIANTS)


def has_dilation(consequent_name: str) -> bool:
    """Whether a consequent is a dilated wavelet: whether it has a parameter nu."""
    return any(slot.group == NU.group for slot in CONSEQUENTS[consequent_name].slots(1))
