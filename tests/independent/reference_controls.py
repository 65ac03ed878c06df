"""Controls of machines in the reference model: exciters, stabiliser, turbine with governor; one class a block.

Quantities are in per unit of a machine's rating, time in s.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from facts_damping.parameters.plant.machines import DcExciter, Exciter, Governor, Stabiliser, StaticExciter

    Values = list[float]


def held(rate: float, value: float, low: float, high: float) -> float:
    """Rate of a state that does not move beyond its limits."""
    return 0.0 if (value >= high and rate > 0.0) or (value <= low and rate < 0.0) else rate


class Control:
    """An exciter that is none: the field voltage stays."""

    states: tuple[str, ...] = ()

    def __init__(self, V: float, Efd: float) -> None:
        self.Efd0, self.start = Efd, list[float]()

    def field(self, z: Values, V: float, signal: float) -> float:
        return self.Efd0

    def rates(self, z: Values, V: float, signal: float) -> Values:
        return []


class Static(Control):
    """A gain with a transducer, a lead-lag before it and a rate feedback whose loop is closed without delay."""

    def __init__(self, e: StaticExciter, V: float, Efd: float) -> None:
        super().__init__(V, Efd)
        self.e, self.Vref = e, V + Efd / e.KA
        self.low = -math.inf if e.minimum is None else e.minimum
        self.high = math.inf if e.maximum is None else e.maximum
        self.states = (*(("xf",) if e.KF else ()), *(("lag",) if e.TB else ()), *(("Vm",) if e.TR else ()))
        self.start = [*([Efd] if e.KF else []), *([Efd / e.KA] if e.TB else []), *([V] if e.TR else [])]

    def _error(self, z: Values, V: float, signal: float) -> float:
        """What is left of the voltage to be made up for, without the rate feedback."""
        return self.Vref + signal - (z[-1] if self.e.TR else V)

    def field(self, z: Values, V: float, signal: float) -> float:
        e, error = self.e, self._error(z, V, signal)
        fed = e.KF / e.TF if e.KF else 0.0
        xf, lag = (z[0] if e.KF else 0.0), (z[1 if e.KF else 0] if e.TB else 0.0)
        quick = e.TC / e.TB if e.TB else 1.0
        # Efd = KA (quick (error - fed (Efd - xf)) + (1 - quick) lag), solved for Efd.
        Efd = e.KA * (quick * (error + fed * xf) + (1.0 - quick) * lag) / (1.0 + e.KA * quick * fed)
        return min(max(Efd, self.low), self.high)

    def rates(self, z: Values, V: float, signal: float) -> Values:
        e, Efd, rates = self.e, self.field(z, V, signal), []
        error = self._error(z, V, signal)
        if e.KF:
            rates.append((Efd - z[0]) / e.TF)
            error -= e.KF / e.TF * (Efd - z[0])
        if e.TB:
            rates.append((error - z[1 if e.KF else 0]) / e.TB)
        return [*rates, (V - z[-1]) / e.TR] if e.TR else rates


class Dc(Control):
    """IEEE DC1A."""

    def __init__(self, e: DcExciter, V: float, Efd: float) -> None:
        super().__init__(V, Efd)
        VR = self.drain(e, Efd)
        self.e, self.Vref = e, V + VR / e.KA
        self.low = -math.inf if e.minimum is None else e.minimum
        self.high = math.inf if e.maximum is None else e.maximum
        self.states = ("Efd", "VR", "Vc", *(("Vm",) if e.TR else ()))
        self.start = [Efd, VR, -e.KF / e.TF * Efd, *([V] if e.TR else [])]

    @staticmethod
    def drain(e: DcExciter, Efd: float) -> float:
        """Regulator voltage that keeps the field voltage."""
        return (e.KE + e.AEX * math.exp(e.BEX * Efd)) * Efd

    def field(self, z: Values, V: float, signal: float) -> float:
        return z[0]

    def rates(self, z: Values, V: float, signal: float) -> Values:
        e, (Efd, VR, Vc) = self.e, z[:3]
        feedback = e.KF / e.TF * Efd + Vc
        error = self.Vref + signal - (z[3] if e.TR else V) - feedback
        rates = [
            (VR - self.drain(e, Efd)) / e.TE,
            held((e.KA * error - VR) / e.TA, VR, self.low, self.high),
            -feedback / e.TF,
        ]
        return [*rates, (V - z[3]) / e.TR] if e.TR else rates


class Damper:
    """A power system stabiliser; without data a machine has none."""

    def __init__(self, p: Stabiliser | None) -> None:
        self.p = p if p is not None and p.enabled else None
        self.states = ("washout", "lead_1", "lead_2") if self.p else ()

    def _chain(self, z: Values, omega: float) -> tuple[float, Values]:
        if self.p is None:
            return 0.0, []
        p, out, rates = self.p, self.p.K * omega - z[0], []
        rates.append(out / p.Tw)
        for x, lead, lag in ((z[1], p.T1, p.T2), (z[2], p.T3, p.T4)):
            rates.append((out - x) / lag)
            out = x + lead / lag * (out - x)
        return out, rates

    def output(self, z: Values, omega: float) -> float:
        """Addition to the exciter's reference."""
        return 0.0 if self.p is None else min(max(self._chain(z, omega)[0], self.p.minimum), self.p.maximum)

    def rates(self, z: Values, omega: float) -> Values:
        return self._chain(z, omega)[1]


class Turbine:
    """A hydraulic turbine with its governor; without data the mechanical power is its reference."""

    def __init__(self, p: Governor | None, P: float) -> None:
        self.p = p if p is not None and p.enabled else None
        self.states: tuple[str, ...] = ()
        self.start = list[float]()
        if self.p is not None:
            gate = P / self.p.At + self.p.q_nl
            self.states, self.start = ("filter", "desired", "gate", "flow"), [0.0, gate, gate, gate]

    def power(self, z: Values, omega: float, reference: float) -> float:
        """Mechanical power."""
        if self.p is None:
            return reference
        return self.p.At * (z[3] / z[2]) ** 2 * (z[3] - self.p.q_nl) - self.p.Dt * z[2] * omega

    def rates(self, z: Values, omega: float, reference: float) -> Values:
        if self.p is None:
            return []
        p, (e, c, gate, flow) = self.p, z
        speed = p.R * (reference / p.At + p.q_nl)
        de = (speed - omega - p.R * c - e) / p.Tf
        dc = min(max((e + p.Tr * de) / (p.r * p.Tr), -p.rate_max), p.rate_max)
        head = (flow / gate) ** 2
        return [de, held(dc, c, p.gate_min, p.gate_max), (c - gate) / p.Tg, (1.0 - head) / p.Tw]


def exciter_of(e: Exciter | None, V: float, Efd: float) -> Control:
    """The exciter block of a machine."""
    if e is None:
        return Control(V, Efd)
    return Static(e, V, Efd) if e.model == "static" else Dc(e, V, Efd)
