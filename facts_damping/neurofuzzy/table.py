"""Tables of antecedents, consequents and of the networks that join them."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from collections.abc import Callable

GAUSSIAN, TRIANGULAR, SPLINE_NEAREST, SPLINE = 0, 1, 2, 3
SINGLETON, AFFINE, SAM, FOURIER, MEXICAN_HAT, MORLET, LEGENDRE, LEGENDRE_WAVELET = range(8)
POINTS = 9  # control points of a B-spline, on [-1, 1]
HARMONICS = 5  # 1, sin x, cos x, sin 2x, cos 2x
DEGREES = 4  # of the Legendre polynomials: 0 to 3
WAVELETS = 6  # degrees 0 to 2 on two halves of [0, 1]


class Slot(NamedTuple):
    """A parameter's place: the group that it belongs to, and the bounds that projection keeps it in."""

    group: str
    low: float
    high: float


H, S = Slot("h", -3.0, 3.0), Slot("s", 0.2, 5.0)
DEGREE = Slot("degree", 0.01, 1.0)
W, VOLUME = Slot("w", -5.0, 5.0), Slot("V", 0.05, 5.0)
TAU, NU = Slot("tau", -3.0, 3.0), Slot("nu", 0.2, 10.0)


class Antecedent(NamedTuple):
    """A kind of membership function: code, parameters of one, how many are active at one input."""

    code: int
    slots: list[Slot]
    active: int
    description: str


class Consequent(NamedTuple):
    """A kind of consequent: code, parameters of one rule and output as a function of the number of inputs."""

    code: int
    slots: Callable[[int], list[Slot]]
    description: str


ANTECEDENTS = {
    "gaussian": Antecedent(GAUSSIAN, [H, S], 2, "exp(-((x-h)/s)^2), (3.9): h, s"),
    "triangular": Antecedent(TRIANGULAR, [H, S], 2, "max(0, 1 - 2|x-h|/s), (3.10): h, s"),
    "b-spline": Antecedent(
        SPLINE_NEAREST, [DEGREE] * POINTS, 1, "degree of the nearest control point, (3.11), figure 3.4"
    ),
    "b-spline-interpolated": Antecedent(
        SPLINE, [DEGREE] * POINTS, 2, "order-2 curve through the control points, (3.11)"
    ),
}
CONSEQUENTS = {
    "singleton": Consequent(SINGLETON, lambda _: [W], "w"),
    "affine": Consequent(AFFINE, lambda m: [W] * (1 + m), "w_0 + sum_i w_i x_i, (6.4)"),
    "sam": Consequent(SAM, lambda _: [Slot("c", W.low, W.high), VOLUME], "centroid c with volume V > 0, (3.30)"),
    "fourier": Consequent(
        FOURIER, lambda m: [W] * HARMONICS**m, "w . kron_i [1, sin x, cos x, sin 2x, cos 2x], (3.13)"
    ),
    "mexican-hat": Consequent(
        MEXICAN_HAT, lambda m: [W] + [TAU, NU] * m, "w sum_i psi((x_i - tau_i) / nu_i), (3.14, 3.18)"
    ),
    "morlet": Consequent(MORLET, lambda m: [W] + [TAU, NU] * m, "w sum_i exp(-q_i^2/2) cos 5 q_i, (3.19)"),
    "legendre": Consequent(LEGENDRE, lambda m: [W] * (DEGREES * m), "tanh(sum_id w_id L_d(x_i)), (3.21)"),
    "legendre-wavelet": Consequent(LEGENDRE_WAVELET, lambda _: [W] * WAVELETS, "sum_db rho_db phi_db(F), (3.22, 3.24)"),
}


# Networks of the identifiers (table C.2).
IDENTIFIERS = {"ANFTSI": ("gaussian", "singleton"), "ANFGuMoI": ("gaussian", "morlet")}


# Consequents of the thesis's networks where there are several outputs (6.4), (6.9).
MIMO_FORM = {"singleton": "affine"}


class Variant(NamedTuple):
    """A network of the thesis (tables C.1, C.2): antecedent, consequent, identifier that goes with it."""

    antecedent: str
    consequent: str
    identifier: str


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


def has_dilation(consequent: str) -> bool:
    """Whether a consequent is a wavelet that is dilated: whether a parameter of its is nu."""
    return any(slot.group == NU.group for slot in CONSEQUENTS[consequent].slots(1))
