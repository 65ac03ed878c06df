"""Synchronous machines: rotor circuits as matrices, swing equation in code.

Except for saturation, all models are linear in the states of the rotor circuits, the stator currents and the field
voltage. So a model is a row of matrices, and the compiled step has one equation:

    dz/dt = A z + B [Id, Iq, Efd] - S(|psi|) W [psi_q, psi_d],    [E''q, E''d] = C z + E0.

psi is the flux that saturates: [E''q, E''d], or [E'q, 0] (`gensal`). E'' is the EMF behind the stator's reactances
Xd'' and Xq'' (transient ones if the model has no subtransient circuits). Phasors are F = (Fd + j Fq)
exp(j (delta - pi/2)) in the network's frame. Powers and currents of the matrices are on the machine's own rating.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from facts_damping.elementary import log, magnitude, phase, power
from facts_damping.errors import InputError
from facts_damping.numerics.matrices import product, solve
from facts_damping.numerics.phasors import over, polar, times

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from facts_damping.parameters.plant.machines import Machine

SWING = ["delta", "omega"]
ROOT_STEPS = 100  # largest number of iterations
MACHINES = 1024  # whose equations a process keeps

MACHINE = np.dtype(
    [
        ("offset", "i8"),  # index of delta; omega and the circuits follow
        ("circuits", "i8"),
        ("column", "i8"),  # of the network's inputs, with the current of the transient saliency; its own column: none
        ("salient", "f8"),  # 1: there is such a current
        ("ratio", "f8"),  # rating over system base
        ("H", "f8"),  # s
        ("D", "f8"),  # p.u. of the rating
        ("speed", "f8"),  # 1: the speed multiplies the EMF, E (1 + omega)
        ("shaft", "f8"),  # 1: the speed divides the turbine's power, Pm / (1 + omega)
        ("Ra", "f8"),  # p.u. of the rating, as the stator's reactances
        ("Xd", "f8"),
        ("Xq", "f8"),
        ("admittance", "c16"),  # 1 / (Ra + j Xd), p.u. of the system base
        ("saliency", "f8", (2, 2)),  # current beside the admittance's from [Ed - Vd, Eq - Vq], p.u. of the system base
        ("E0", "c16"),  # constant part of Ed + j Eq, p.u.
        ("A", "f8", (4, 4)),
        ("B", "f8", (4, 3)),
        ("C", "f8", (2, 4)),
        ("W", "f8", (4, 2)),
        ("saturation_A", "f8"),  # S(psi) = B (psi - A)^2 / psi above A, or B psi^A if exponential
        ("saturation_B", "f8"),  # 0: no saturation
        ("exponential", "b1"),
        ("field_saturates", "b1"),  # only E'q
    ]
)


class RotorCircuits(NamedTuple):
    """A machine model: names (n), A (n, n), B (n, 3), C (2, n) and W (n, 2) in 1/s and p.u. of the rating."""

    names: list[str]
    A: NDArray[np.float64]
    B: NDArray[np.float64]
    C: NDArray[np.float64]
    W: NDArray[np.float64]


# The functions below require a Machine with all data of its model, so that no value is None.


def _circuits(m: Any, names: list[str]) -> RotorCircuits:
    """Matrices with the terms common to all models: field, transient circuit of the q axis, saturation.

    T'd0 dE'q = Efd - E'q - (Xd - X'd) Id - S E''q      T'q0 dE'd = -E'd + (Xq - X'q) Iq - kq S E''d
    with kq = (Xq - Xl) / (Xd - Xl).
    """
    n = len(names)
    A, B, W = np.zeros((n, n)), np.zeros((n, 3)), np.zeros((n, 2))
    leakage = m.Xl or 0.0
    A[0, 0], B[0, 0], B[0, 2] = -1 / m.Td01, -(m.Xd - m.Xd1) / m.Td01, 1 / m.Td01
    A[1, 1], B[1, 1] = -1 / m.Tq01, (m.Xq - m.Xq1) / m.Tq01
    W[0, 0], W[1, 1] = 1 / m.Td01, (m.Xq - leakage) / (m.Xd - leakage) / m.Tq01
    return RotorCircuits(names, A, B, np.eye(2, n), W)


def classical(m: Any) -> RotorCircuits:  # noqa: ARG001 (no data beside X'd)
    """No circuits: a constant EMF E' behind X'd."""
    return RotorCircuits([], np.zeros((0, 0)), np.zeros((0, 3)), np.zeros((2, 0)), np.zeros((0, 2)))


def two_axis(m: Any) -> RotorCircuits:
    """States E'q, E'd: the transient circuits alone (Sauer and Pai 1998, 5.4)."""
    return _circuits(m, ["Eq1", "Ed1"])


def cascade(m: Any) -> RotorCircuits:
    """States E'q, E'd, E''q, E''d: the subtransient EMF follows the transient one (thesis 2.3-2.6, corrected).

    T'd0 dE'q = Efd - E'q - (Xd - X'd) Id        T''d0 dE''q = E'q - E''q - (X'd - X''d) Id
    T'q0 dE'd = -E'd + (Xq - X'q) Iq             T''q0 dE''d = E'd - E''d + (X'q - X''q) Iq
    """
    names, A, B, C, W = _circuits(m, ["Eq1", "Ed1", "Eq2", "Ed2"])
    A[2, 0], A[2, 2], B[2, 0] = 1 / m.Td02, -1 / m.Td02, -(m.Xd1 - m.Xd2) / m.Td02
    A[3, 1], A[3, 3], B[3, 1] = 1 / m.Tq02, -1 / m.Tq02, (m.Xq1 - m.Xq2) / m.Tq02
    C[:] = [[0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]]
    return RotorCircuits(names, A, B, C, W)


def genrou(m: Any) -> RotorCircuits:
    """States E'q, E'd, psi1d, psi2q: the standard subtransient model with leakage (Sauer and Pai 1998, 3.5).

    T'd0 dE'q = Efd - E'q - (Xd - X'd) [Id - kd (psi1d + (X'd - Xl) Id - E'q)],  kd = (X'd - X''d) / (X'd - Xl)^2
    T'q0 dE'd = -E'd + (Xq - X'q) [Iq - kq (psi2q + (X'q - Xl) Iq + E'd)],       kq = (X'q - X''q) / (X'q - Xl)^2
    T''d0 dpsi1d = -psi1d + E'q - (X'd - Xl) Id      T''q0 dpsi2q = -psi2q - E'd - (X'q - Xl) Iq
    E''q = [(X''d - Xl) E'q + (X'd - X''d) psi1d] / (X'd - Xl)
    E''d = [(X''q - Xl) E'd - (X'q - X''q) psi2q] / (X'q - Xl)
    """
    names, A, B, C, W = _circuits(m, ["Eq1", "Ed1", "psi1d", "psi2q"])
    dl, ql = m.Xd1 - m.Xl, m.Xq1 - m.Xl
    kd, kq = (m.Xd1 - m.Xd2) / (dl * dl), (m.Xq1 - m.Xq2) / (ql * ql)
    A[0, 0], A[0, 2] = -(1 + (m.Xd - m.Xd1) * kd) / m.Td01, (m.Xd - m.Xd1) * kd / m.Td01
    B[0, 0] = -(m.Xd - m.Xd1) * (1 - kd * dl) / m.Td01
    A[1, 1], A[1, 3] = -(1 + (m.Xq - m.Xq1) * kq) / m.Tq01, -(m.Xq - m.Xq1) * kq / m.Tq01
    B[1, 1] = (m.Xq - m.Xq1) * (1 - kq * ql) / m.Tq01
    A[2, 0], A[2, 2], B[2, 0] = 1 / m.Td02, -1 / m.Td02, -dl / m.Td02
    A[3, 1], A[3, 3], B[3, 1] = -1 / m.Tq02, -1 / m.Tq02, -ql / m.Tq02
    C[:] = [
        [(m.Xd2 - m.Xl) / dl, 0.0, (m.Xd1 - m.Xd2) / dl, 0.0],
        [0.0, (m.Xq2 - m.Xl) / ql, 0.0, -(m.Xq1 - m.Xq2) / ql],
    ]
    return RotorCircuits(names, A, B, C, W)


def gensal(m: Any) -> RotorCircuits:
    """Circuits of `genrou` with salient poles, of which the field alone saturates, by E'q (PSS/E GENSAL).

    T'd0 dE'q = Efd - (1 + S(E'q)) E'q - (Xd - X'd) [Id - kd (psi1d + (X'd - Xl) Id - E'q)]
    """
    names, A, B, C, W = genrou(m)
    W[1:] = 0.0
    return RotorCircuits(names, A, B, C, W)


MODELS: dict[str, Callable[[Any], RotorCircuits]] = {
    "classical": classical,
    "two_axis": two_axis,
    "cascade": cascade,
    "genrou": genrou,
    "gensal": gensal,
}


def rotor_circuits(m: Machine) -> RotorCircuits:
    """The circuits of a machine; a salient-pole machine has none for E'd (equal to X'q = Xq, E'd = 0).

    Then psi2q of `genrou` saturates: T''q0 dE''d = -E''d + (Xq - X''q) Iq - kq S E''d (PSS/E GENSAE).
    """
    if m.Xq1 is not None or m.model == "classical":
        return MODELS[m.model](m)
    salient: Any = m.model_copy(update={"Xq1": m.Xq, "Tq01": 1.0})
    names, A, B, C, W = MODELS[m.model](salient)
    if m.model == "genrou" and salient.Xq > salient.Xq2:
        kq = (salient.Xq - salient.Xl) / (salient.Xd - salient.Xl)
        W[3, 1] = kq / (C[1, 3] * salient.Tq02)
    used = [i for i, name in enumerate(names) if name != "Ed1"]
    return RotorCircuits([names[i] for i in used], A[np.ix_(used, used)], B[used], C[:, used], W[used])


def stator_reactances(m: Machine) -> tuple[float, float]:
    """Reactances between the EMF of the circuits and the terminals, d and q axis, p.u. of the rating."""
    if m.model == "classical":
        pair = m.Xd1, m.Xd1
    elif m.model == "two_axis":
        pair = m.Xd1, m.Xq if m.Xq1 is None else m.Xq1
    else:
        pair = m.Xd2, m.Xq2
    return float(pair[0] or 0.0), float(pair[1] or 0.0)


def saturation(m: Machine) -> tuple[float, float]:
    """A and B of S(psi) through S10 and S12: B (psi - A)^2 / psi, or B psi^A if exponential; B = 0: none."""
    if m.S12 == 0:
        return 0.0, 0.0
    if m.saturation == "exponential":
        return log(m.S12 / m.S10) / log(1.2), m.S10
    a = math.sqrt(m.S10 / (1.2 * m.S12))
    A = (1.0 - 1.2 * a) / (1.0 - a)
    return A, 1.2 * m.S12 / ((1.2 - A) * (1.2 - A))


class MachineStart(NamedTuple):
    """A machine in the steady state: row of MACHINE, states, field voltage (p.u.), air-gap power (p.u. of rating)."""

    row: NDArray[Any]
    states: NDArray[np.float64]
    field_voltage: float
    power: float


@lru_cache(maxsize=MACHINES)
def _equations(m: Machine, base_power: float) -> tuple[RotorCircuits, NDArray[np.float64], NDArray[Any]]:
    """What no operating point changes: circuits, their steady states for one p.u. of field voltage, and the row."""
    c = rotor_circuits(m)
    try:
        return c, -solve(c.A, c.B[:, 2]), _row(m, c, base_power)
    except np.linalg.LinAlgError as error:
        text = "circuits without a steady state given; allowed: reactances of like size"
        raise InputError(f"machines: {m.name}: {text}") from error


def steady_state(m: Machine, base_power: float, offset: int, voltage: complex, current: complex) -> MachineStart:
    """A machine's row and its steady-state states; `current` is on the machine's rating.

    Where the q axis does not saturate it is along V + (Ra + j Xq) I (Kundur 1994, 3.6.5); else it is where its circuits
    are in steady state. Raises `InputError` if no such angle is found.
    """
    c, unit, constant = _equations(m, base_power)
    row = constant.copy()
    row["offset"] = offset
    xq = m.Xd1 if m.model == "classical" else m.Xq
    delta = phase(complex(voltage + times(complex(m.Ra, float(xq or 0.0)), current)))
    if row["saturation_B"] > 0 and not row["field_saturates"]:
        low, high = delta - 0.5, delta + 0.5  # rad, far more than saturation shifts the axis
        ends = [_at(row, c, angle, voltage, current).mismatch for angle in (low, high)]
        if ends[0] * ends[1] > 0:
            raise InputError(
                f"machines: {m.name}: S10, S12: {m.S10:g}, {m.S12:g} given, without a steady state; allowed: smaller"
            )
        delta = _root(lambda angle: _at(row, c, angle, voltage, current).mismatch, low, high)
    s = _at(row, c, delta, voltage, current)
    if m.model == "classical":
        row["E0"] = s.emf
        field_voltage, z = magnitude(s.emf), s.z
    else:
        field_voltage = float((s.emf.imag - product(c.C[0], s.z)) / product(c.C[0], unit))
        z = s.z + field_voltage * unit
        if row["field_saturates"]:
            field_voltage += _saturated(row, abs(float(z[0]))) * float(z[0])
    air_gap = (
        s.emf.real * s.current.real
        + s.emf.imag * s.current.imag
        + (row["Xq"] - row["Xd"]) * s.current.real * s.current.imag
    )
    return MachineStart(row, np.array([delta, 0.0, *z]), field_voltage, float(air_gap))


def _root(f: Callable[[float], float], low: float, high: float) -> float:
    """Zero of f between two points with opposite signs, by regula falsi (Illinois) and bisection."""
    below, above, side = f(low), f(high), 0
    best = min((abs(below), low), (abs(above), high))
    for k in range(ROOT_STEPS):
        middle = (low * above - high * below) / (above - below)
        if k % 4 == 3 or not low < middle < high:
            middle = (low + high) / 2.0
        if not low < middle < high:
            break
        here = f(middle)
        best = min(best, (abs(here), middle))
        if here == 0.0:
            break
        if here * below > 0.0:
            low, below, above, side = middle, here, above / 2.0 if side < 0 else above, -1
        else:
            high, above, below, side = middle, here, below / 2.0 if side > 0 else below, 1
    return best[1]


class _Trial(NamedTuple):
    """A machine at a trial angle: EMF, current in the rotor's frame, steady circuits without field, mismatch of Ed."""

    emf: complex
    current: complex
    z: NDArray[np.float64]
    mismatch: float


def _at(row: NDArray[Any], c: RotorCircuits, delta: float, voltage: complex, current: complex) -> _Trial:
    """A machine at a rotor angle: the EMF required by its stator, and that of its circuits."""
    v, i = (complex(phasor) for phasor in times([voltage, current], polar(1.0, math.pi / 2 - delta)))
    emf = complex(v + float(row["Ra"]) * i + complex(-row["Xq"] * i.imag, row["Xd"] * i.real))
    psi = magnitude(emf)
    s = 0.0 if row["field_saturates"] else _saturated(row, psi)
    drive = product(c.B[:, :2], np.array([i.real, i.imag])) - s * product(c.W, np.array([emf.imag, emf.real]))
    z = -solve(c.A, drive)
    return _Trial(emf, i, z, float(product(c.C[1], z) - emf.real))


def _saturated(row: NDArray[Any], psi: float) -> float:
    """S of a flux."""
    a, b = float(row["saturation_A"]), float(row["saturation_B"])
    if row["exponential"]:
        return float(b * power(psi, a))
    beyond = max(0.0, psi - a)
    return b * beyond * beyond / psi


def _row(m: Machine, c: RotorCircuits, base_power: float) -> NDArray[Any]:
    """A row of MACHINE; the callers set `offset`, `column` and `salient`."""
    row = np.zeros((), MACHINE)
    n, ratio = len(c.names), m.rating / base_power
    d, q = stator_reactances(m)
    row["circuits"] = n
    row["ratio"], row["H"], row["D"], row["Ra"], row["Xd"], row["Xq"] = ratio, m.H, m.D, m.Ra, d, q
    row["speed"], row["shaft"] = float(m.speed_voltage), float(m.speed_torque)
    row["admittance"] = over(ratio, complex(m.Ra, d))
    stator, alike = (solve(np.array([[m.Ra, -x], [d, m.Ra]]), np.eye(2)) for x in (q, d))
    row["saliency"] = ratio * (stator - alike)
    row["A"][:n, :n], row["B"][:n], row["C"][:, :n], row["W"][:n] = c.A, c.B, c.C, c.W
    row["saturation_A"], row["saturation_B"] = saturation(m)
    row["exponential"], row["field_saturates"] = m.saturation == "exponential", m.model == "gensal"
    return row
