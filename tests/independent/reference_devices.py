"""FACTS devices in the reference model: regulators, DC links, setpoints. Quantities on the system base."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from facts_damping.parameters.devices import Sssc, Statcom, Svc

    Values = list[float]
    Targets = Sequence[tuple[float, float]]  # (time in s, value)


BAND = 1e-4  # p.u., of a regulator's output beyond its limit


def clip(value: float, limit: float) -> float:
    """A value within +-limit."""
    return min(max(value, -limit), limit)


def held(rate: float, free: float, limit: float) -> float:
    """Rate of an integrator that stands while its regulator's output is limited.

    A switch would have no solution where output and integrator push against each other at the limit, so the rate
    fades over a narrow band: to be integrated by an implicit method.
    """
    return rate * min(max((limit - abs(free)) / BAND + 1.0, 0.0), 1.0)


class Series:
    """SSSC: voltage drops along and across its current."""

    states = ("x_ac", "x_dc", "vdc")

    def __init__(self, p: Sssc, size: float) -> None:
        self.p = p
        self.start = [0.0, p.g / size / min(1.0, p.I_rated / size), 1.0]

    def drops(self, z: Values, u: float, size: float) -> tuple[float, float, Values]:
        """v_p, v_q at a current of a size, rates of the states; `u` is the ramped setpoint, capacitive > 0."""
        p, (x_ac, x_dc, vdc) = self.p, z
        wanted = -u - p.xs * size  # drop of the converter alone
        free_p = min(1.0, p.I_rated / size) * (p.Kd * (1.0 - vdc) + x_dc)
        s_p = clip(free_p, p.vp_max)
        free_q = (wanted * (1.0 + p.Kp) + x_ac) / (1.0 + p.Kp * vdc)  # sees its own v_q = s_q vdc
        limit = math.sqrt(p.vc_max**2 - s_p**2)
        s_q = clip(free_q, limit)
        rates = [
            held(p.Ki * (wanted - s_q * vdc), free_q, limit),
            held(p.Kdi * (1.0 - vdc), free_p, p.vp_max),
            (s_p * size - p.g * vdc) / p.tau,
        ]
        return s_p * vdc, s_q * vdc, rates


class Shunt:
    """STATCOM: current id + j iq into the network, d axis on its bus's voltage."""

    states = ("vdc", "id", "iq", "x_ac", "x_dc", "x_d", "x_q")

    def __init__(self, p: Statcom, V: float, omega_0: float) -> None:
        self.p, self.Vref, self.rate = p, V, omega_0 / p.L
        self.start = [1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]

    def current(self, z: Values, V: complex) -> complex:
        """Current into the network."""
        return complex(z[1], z[2]) * V / abs(V)

    def rates(self, z: Values, u: float, V: float) -> Values:
        p, (vdc, i_d, i_q, x_ac, x_dc, x_d, x_q) = self.p, z
        e = self.Vref + u - V + p.droop * i_q
        free_Q = p.Kp * e + x_ac
        free_P = p.Kd * (1.0 - vdc) + x_dc
        e_d, e_q = -clip(free_P, p.I_max) - i_d, -clip(free_Q, p.I_max) - i_q
        c_d = vdc * (V - p.Kf * i_q + p.Kc * e_d + x_d)
        c_q = vdc * (p.Kf * i_d + p.Kc * e_q + x_q)
        return [
            -(c_d * i_d + c_q * i_q) / (p.tau * vdc),
            self.rate * (c_d - V - p.R * i_d + p.L * i_q),
            self.rate * (c_q - p.R * i_q - p.L * i_d),
            held(p.Ki * e, free_Q, p.I_max),
            held(p.Kdi * (1.0 - vdc), free_P, p.I_max),
            p.Kci * e_d,
            p.Kci * e_q,
        ]


class Susceptance:
    """SVC: an admittance j B from its bus to ground."""

    states = ("B",)

    def __init__(self, p: Svc, V: float) -> None:
        self.p, self.Vref, self.start = p, V, [0.0]

    def current(self, z: Values, V: complex) -> complex:
        """Current into the network: what flows into the admittance, turned round."""
        return -1j * z[0] * V

    def rates(self, z: Values, u: float, V: float) -> Values:
        p = self.p
        order = float(np.clip((u + self.Vref - V) * p.K, p.B_min, p.B_max))
        return [(order - z[0]) / p.T]


class Ramp:
    """A device's reference: each setpoint limited and approached at the largest rate, corner by corner from zero."""

    def __init__(self, p: Sssc | Statcom | Svc, targets: Targets, end: float) -> None:
        t, u = [0.0], [0.0]
        finite = [(max(time, 0.0), clip(value, p.v_max)) for time, value in targets if math.isfinite(value)]
        for (time, goal), (until, _) in pairwise([*finite, (end, 0.0)]):
            reach = p.rate_max * max(until - time, 0.0)
            reached = goal if abs(goal - u[-1]) <= reach else u[-1] + math.copysign(reach, goal - u[-1])
            t += [time, time + abs(reached - u[-1]) / p.rate_max]
            u += [u[-1], reached]
        self.t, self.u = np.array([*t, max(end, t[-1])]), np.array([*u, u[-1]])

    def at(self, t: NDArray[np.float64] | float) -> NDArray[np.float64]:
        """Reference at times."""
        return np.asarray(np.interp(t, self.t, self.u))
