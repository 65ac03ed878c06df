"""Synchronous machines: fourth-order rotor circuits as data, the swing equation as code.

Both models are linear in the rotor circuits' states, the stator currents and the field voltage, so a
model is a row of matrices and the compiled step knows one equation:

    dz/dt = A z + B [Id, Iq, Efd],    [E''q, E''d] = C z.

Phasors turn with F = (Fd + j Fq) exp(j (delta - pi/2)); the stator is V = E'' - (Ra + j X'') I with
X'' = X''d = X''q. Powers and currents of the matrices are on the machine's own rating.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from facts_damping.parameters.system import Machine

ROTOR_STATES = 6  # delta, omega, then the four rotor circuits


class RotorCircuits(NamedTuple):
    """Matrices of a machine model: A (4, 4), B (4, 3), C (2, 4); 1/s, and p.u. of the machine's rating."""

    A: NDArray[np.float64]
    B: NDArray[np.float64]
    C: NDArray[np.float64]


def cascade(m: Machine) -> RotorCircuits:
    """States E'q, E'd, E''q, E''d: the subtransient EMF follows the transient one (thesis 2.3-2.6, corrected).

    T'd0 dE'q = Efd - E'q - (Xd - X'd) Id        T''d0 dE''q = E'q - E''q - (X'd - X''d) Id
    T'q0 dE'd = -E'd + (Xq - X'q) Iq             T''q0 dE''d = E'd - E''d + (X'q - X''q) Iq
    """
    A = np.zeros((4, 4))
    B = np.zeros((4, 3))
    A[0, 0], B[0, 0], B[0, 2] = -1 / m.Td01, -(m.Xd - m.Xd1) / m.Td01, 1 / m.Td01
    A[1, 1], B[1, 1] = -1 / m.Tq01, (m.Xq - m.Xq1) / m.Tq01
    A[2, 0], A[2, 2], B[2, 0] = 1 / m.Td02, -1 / m.Td02, -(m.Xd1 - m.Xd2) / m.Td02
    A[3, 1], A[3, 3], B[3, 1] = 1 / m.Tq02, -1 / m.Tq02, (m.Xq1 - m.Xq2) / m.Tq02
    C = np.array([[0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]])
    return RotorCircuits(A, B, C)


def genrou(m: Machine) -> RotorCircuits:
    """States E'q, E'd, psi1d, psi2q: the standard subtransient model with leakage (Sauer and Pai 1998, 3.5).

    T'd0 dE'q = Efd - E'q - (Xd - X'd) [Id - kd (psi1d + (X'd - Xl) Id - E'q)],  kd = (X'd - X''d) / (X'd - Xl)^2
    T'q0 dE'd = -E'd + (Xq - X'q) [Iq - kq (psi2q + (X'q - Xl) Iq + E'd)],       kq = (X'q - X''q) / (X'q - Xl)^2
    T''d0 dpsi1d = -psi1d + E'q - (X'd - Xl) Id      T''q0 dpsi2q = -psi2q - E'd - (X'q - Xl) Iq
    E''q = [(X''d - Xl) E'q + (X'd - X''d) psi1d] / (X'd - Xl)
    E''d = [(X''q - Xl) E'd - (X'q - X''q) psi2q] / (X'q - Xl)
    """
    dl, ql = m.Xd1 - m.Xl, m.Xq1 - m.Xl
    kd, kq = (m.Xd1 - m.Xd2) / dl**2, (m.Xq1 - m.Xq2) / ql**2
    A = np.zeros((4, 4))
    B = np.zeros((4, 3))
    A[0, 0], A[0, 2] = -(1 + (m.Xd - m.Xd1) * kd) / m.Td01, (m.Xd - m.Xd1) * kd / m.Td01
    B[0, 0], B[0, 2] = -(m.Xd - m.Xd1) * (1 - kd * dl) / m.Td01, 1 / m.Td01
    A[1, 1], A[1, 3] = -(1 + (m.Xq - m.Xq1) * kq) / m.Tq01, -(m.Xq - m.Xq1) * kq / m.Tq01
    B[1, 1] = (m.Xq - m.Xq1) * (1 - kq * ql) / m.Tq01
    A[2, 0], A[2, 2], B[2, 0] = 1 / m.Td02, -1 / m.Td02, -dl / m.Td02
    A[3, 1], A[3, 3], B[3, 1] = -1 / m.Tq02, -1 / m.Tq02, -ql / m.Tq02
    C = np.array(
        [
            [(m.Xd2 - m.Xl) / dl, 0.0, (m.Xd1 - m.Xd2) / dl, 0.0],
            [0.0, (m.Xq2 - m.Xl) / ql, 0.0, -(m.Xq1 - m.Xq2) / ql],
        ]
    )
    return RotorCircuits(A, B, C)


MODELS: dict[str, Callable[[Machine], RotorCircuits]] = {"cascade": cascade, "genrou": genrou}
STATE_NAMES = {
    "cascade": ["delta", "omega", "Eq1", "Ed1", "Eq2", "Ed2"],
    "genrou": ["delta", "omega", "Eq1", "Ed1", "psi1d", "psi2q"],
}


class MachineStart(NamedTuple):
    """A machine in the steady state: its six states, field voltage (p.u.), air-gap power (p.u. of its rating)."""

    states: NDArray[np.float64]
    field_voltage: float
    power: float


def steady_state(m: Machine, circuits: RotorCircuits, voltage: complex, current: complex) -> MachineStart:
    """States that make all derivatives zero, from the terminal's phasors (current on the machine's rating).

    The q axis lies along V + (Ra + j Xq) I; then Efd = Vq + Ra Iq + Xd Id (Kundur 1994, 3.6.5).
    """
    delta = float(np.angle(voltage + (m.Ra + 1j * m.Xq) * current))
    turn = np.exp(-1j * (delta - np.pi / 2))
    v, i = voltage * turn, current * turn
    field_voltage = v.imag + m.Ra * i.imag + m.Xd * i.real
    z = -np.linalg.solve(circuits.A, circuits.B @ [i.real, i.imag, field_voltage])
    emf_q, emf_d = circuits.C @ z
    power = emf_d * i.real + emf_q * i.imag
    return MachineStart(np.array([delta, 0.0, *z]), float(field_voltage), float(power))
