"""Machines in the reference model: one class a model, its states, its equations; their start.

Quantities are in per unit of a machine's rating, angles in rad, time in s.
"""

from __future__ import annotations

import cmath
import math
from typing import TYPE_CHECKING

from scipy.optimize import root

if TYPE_CHECKING:
    from facts_damping.parameters.plant.machines import Machine

    Values = list[float]


def or_infinite(value: float | None) -> float:
    """A parameter that the machine's model needs, so that it is there."""
    if value is None:
        raise ValueError("a parameter is missing")
    return value


class Saturation:
    """S(psi) = B (psi - A)^2 / psi above A, or S10 psi^B; both through S(1) = S10 and S(1.2) = S12."""

    def __init__(self, m: Machine) -> None:
        self.A, self.B, self.S10 = 0.0, 0.0, 0.0
        if m.saturation == "exponential":
            self.B, self.S10 = math.log(m.S12 / m.S10, 1.2), m.S10
        elif m.S12 > 0.0:
            # sqrt(B) (1 - A) = sqrt(S10) and sqrt(B) (1.2 - A) = sqrt(1.2 S12): the difference is 0.2 sqrt(B).
            root_B = (math.sqrt(1.2 * m.S12) - math.sqrt(m.S10)) / 0.2
            self.B, self.A = root_B**2, 1.0 - math.sqrt(m.S10) / root_B

    def __call__(self, Ed: float, Eq: float) -> float:
        psi = math.hypot(Ed, Eq)
        if self.S10:
            return float(self.S10 * psi**self.B)
        return self.B * (psi - self.A) ** 2 / psi if self.B and psi > self.A else 0.0


class Rotor:
    """A machine's rotor circuits: `states`, voltages behind `Xd`, `Xq` of the stator, rates."""

    states: tuple[str, ...] = ()

    def __init__(self, m: Machine) -> None:
        self.m, self.S = m, Saturation(m)
        self.Xd, self.Xq = or_infinite(m.Xd1), or_infinite(m.Xd1)
        # Saturation of the q axis goes by the ratio of the magnetising reactances.
        Xl = m.Xl or 0.0
        self.ratio = (m.Xq - Xl) / (m.Xd - Xl) if m.Xd and m.Xq else 0.0

    def emf(self, z: Values, Efd: float) -> tuple[float, float]:
        """Ed, Eq; the classical machine's E' lies along the q axis and is kept as its field voltage."""
        return 0.0, Efd

    def rates(self, z: Values, Efd: float, Id: float, Iq: float) -> Values:
        return []


class TwoAxis(Rotor):
    """Transient circuits alone."""

    def __init__(self, m: Machine) -> None:
        super().__init__(m)
        self.states = ("Eq1",) if m.Tq01 is None else ("Eq1", "Ed1")
        self.Xq = or_infinite(m.Xq if m.Xq1 is None else m.Xq1)

    def emf(self, z: Values, Efd: float) -> tuple[float, float]:
        return (z[1] if len(z) > 1 else 0.0), z[0]

    def rates(self, z: Values, Efd: float, Id: float, Iq: float) -> Values:
        m, (Ed, Eq) = self.m, self.emf(z, Efd)
        S = self.S(Ed, Eq)
        dEq = (Efd - (or_infinite(m.Xd) - self.Xd) * Id - Eq - S * Eq) / or_infinite(m.Td01)
        if m.Tq01 is None:
            return [dEq]
        return [dEq, ((or_infinite(m.Xq) - self.Xq) * Iq - Ed - self.ratio * S * Ed) / m.Tq01]


class Cascade(Rotor):
    """The thesis's machine: each subtransient voltage follows the transient one of its axis."""

    def __init__(self, m: Machine) -> None:
        super().__init__(m)
        self.states = ("Eq1", "Eq2", "Ed2") if m.Tq01 is None else ("Eq1", "Eq2", "Ed2", "Ed1")
        self.Xd, self.Xq = or_infinite(m.Xd2), or_infinite(m.Xq2)
        self.Xq1 = or_infinite(m.Xq if m.Xq1 is None else m.Xq1)

    def emf(self, z: Values, Efd: float) -> tuple[float, float]:
        return z[2], z[1]

    def rates(self, z: Values, Efd: float, Id: float, Iq: float) -> Values:
        m, (Eq1, Eq2, Ed2) = self.m, z[:3]
        Ed1, Xd1, S = (z[3] if len(z) > 3 else 0.0), or_infinite(m.Xd1), self.S(Ed2, Eq2)
        rates = [
            (Efd - (or_infinite(m.Xd) - Xd1) * Id - Eq1 - S * Eq2) / or_infinite(m.Td01),
            (Eq1 - (Xd1 - self.Xd) * Id - Eq2) / or_infinite(m.Td02),
            (Ed1 + (self.Xq1 - self.Xq) * Iq - Ed2) / or_infinite(m.Tq02),
        ]
        if m.Tq01 is not None:
            rates.append(((or_infinite(m.Xq) - self.Xq1) * Iq - Ed1 - self.ratio * S * Ed2) / m.Tq01)
        return rates


class Circuits(Rotor):
    """The standard machine as magnetic circuits: flux linkages of field and dampers, d(psi)/dt = w0 (e - R i).

    Axis by axis the circuits of the equal-mutual model: La = X - Xl beside the circuits' leakages L1, L2, with
    X' - Xl = La || L1, X'' - Xl = La || L1 || L2, T' = (La + L1)/(w0 R1), T'' = (L2 + La || L1)/(w0 R2).
    """

    def __init__(self, m: Machine) -> None:
        super().__init__(m)
        Xl, self.Xd, self.Xq = or_infinite(m.Xl), or_infinite(m.Xd2), or_infinite(m.Xq2)
        self.Lad, self.Laq, self.d2, self.q2 = (
            or_infinite(m.Xd) - Xl,
            or_infinite(m.Xq) - Xl,
            self.Xd - Xl,
            self.Xq - Xl,
        )
        d1 = or_infinite(m.Xd1) - Xl
        self.Lf, self.Ld = 1.0 / (1.0 / d1 - 1.0 / self.Lad), 1.0 / (1.0 / self.d2 - 1.0 / d1)
        self.wRf, self.wRd = (self.Lad + self.Lf) / or_infinite(m.Td01), (self.Ld + d1) / or_infinite(m.Td02)
        if m.Xq1 is None or m.Tq01 is None:
            self.states = ("psi_f", "psi_1d", "psi_2q")
            self.Lq = 1.0 / (1.0 / self.q2 - 1.0 / self.Laq)
            self.wRq = (self.Lq + self.Laq) / or_infinite(m.Tq02)
        else:
            self.states = ("psi_f", "psi_1d", "psi_2q", "psi_1q")
            q1 = m.Xq1 - Xl
            self.Lg, self.Lq = 1.0 / (1.0 / q1 - 1.0 / self.Laq), 1.0 / (1.0 / self.q2 - 1.0 / q1)
            self.wRg, self.wRq = (self.Laq + self.Lg) / m.Tq01, (self.Lq + q1) / or_infinite(m.Tq02)

    def emf(self, z: Values, Efd: float) -> tuple[float, float]:
        linked = z[2] / self.Lq + (z[3] / self.Lg if len(z) > 3 else 0.0)
        return -self.q2 * linked, self.d2 * (z[0] / self.Lf + z[1] / self.Ld)

    def rates(self, z: Values, Efd: float, Id: float, Iq: float) -> Values:
        Ed2, Eq2 = self.emf(z, Efd)
        psi_ad, psi_aq, S = Eq2 - self.d2 * Id, -Ed2 - self.q2 * Iq, self.S(Ed2, Eq2)
        # E'q = Lad/(Lad + Lf) psi_f and E'd = -Laq/(Laq + Lg) psi_1q carry the saturation.
        rates = [
            self.wRf * ((Efd - S * Eq2) / self.Lad - (z[0] - psi_ad) / self.Lf),
            -self.wRd * (z[1] - psi_ad) / self.Ld,
            -self.wRq * (z[2] - psi_aq) / self.Lq,
        ]
        if len(z) == 3:
            rates[2] += self.wRq * self.ratio * S * Ed2 / self.Laq
        if len(z) > 3:
            rates.append(self.wRg * (self.ratio * S * Ed2 / self.Laq - (z[3] - psi_aq) / self.Lg))
        return rates


class FieldSaturates(Circuits):
    """GENSAL: the flux of the field, E'q = Lad/(Lad + Lf) psi_f, asks for the more field current the more there is."""

    def __init__(self, m: Machine) -> None:
        super().__init__(m.model_copy(update={"S10": 0.0, "S12": 0.0, "saturation": "quadratic"}))
        self.saturation_of_field = Saturation(m)

    def rates(self, z: Values, Efd: float, Id: float, Iq: float) -> Values:
        Eq1 = self.Lad / (self.Lad + self.Lf) * z[0]
        return super().rates(z, Efd - self.saturation_of_field(0.0, Eq1) * Eq1, Id, Iq)


ROTORS = {"classical": Rotor, "two_axis": TwoAxis, "cascade": Cascade, "genrou": Circuits, "gensal": FieldSaturates}


def machine_start(rotor: Rotor, V: complex, I: complex) -> tuple[float, float, Values]:  # noqa: E741
    """Rotor angle, field voltage and rotor states at rest: stator and circuits solved together."""
    Ra, count = rotor.m.Ra, len(rotor.states)

    def unrest(w: list[float]) -> Values:
        turn = cmath.exp(-1j * (w[0] - math.pi / 2.0))
        v, i = V * turn, I * turn
        Ed, Eq = rotor.emf(w[2:], w[1])
        stator = [Ed - v.real - Ra * i.real + rotor.Xq * i.imag, Eq - v.imag - Ra * i.imag - rotor.Xd * i.real]
        return stator + [0.1 * rate for rate in rotor.rates(w[2:], w[1], i.real, i.imag)]

    behind = V + complex(Ra, rotor.m.Xq if count and rotor.m.Xq else rotor.Xq) * I
    w = [cmath.phase(behind), abs(behind), 1.0, 1.0, -0.5, 0.5][: count + 2]
    for _ in range(3):
        w = root(unrest, w, options={"xtol": 1e-15}).x.tolist()
    if max(abs(x) for x in unrest(w)) > 1e-10:
        raise ValueError(f"{rotor.m.name}: no rest found")
    return w[0], w[1], w[2:]
