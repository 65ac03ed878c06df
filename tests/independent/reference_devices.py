"""FACTS devices in the reference model: regulators, DC links, setpoints. Quantities on the system base."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from facts_damping.devices.hvdc import Hvdc
    from facts_damping.devices.load_modulation import LoadModulation
    from facts_damping.devices.sssc import Sssc
    from facts_damping.devices.statcom import Statcom
    from facts_damping_library.devices.bess import Bess
    from facts_damping_library.devices.exciter_input import ExciterInput
    from facts_damping_library.devices.inverter_input import InverterInput
    from facts_damping_library.devices.svc import Svc
    from facts_damping_library.devices.tcsc import Tcsc

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


class Input:
    """Exciter or inverter input: only its reference, which its machine or inverter adds."""

    states: tuple[str, ...] = ()

    def __init__(self, p: ExciterInput | InverterInput) -> None:
        self.p, self.start = p, list[float]()

    def rates(self, _z: Values, _u: float) -> Values:
        return []


class Capacitor:
    """TCSC: a capacitive reactance that follows its order; without the current through it."""

    states = ("x",)

    def __init__(self, p: Tcsc) -> None:
        self.p, self.start = p, [p.X]

    def rates(self, z: Values, u: float) -> Values:
        p = self.p
        return [(float(np.clip(u + p.X, p.X_min, p.X_max)) - z[0]) / p.T]


class Shunt:
    """STATCOM: current id + j iq into the network, d axis on its bus's voltage."""

    states = ("vdc", "id", "iq", "x_ac", "x_dc", "x_d", "x_q")

    def __init__(self, p: Statcom, V: float, omega_0: float) -> None:
        self.p, self.Vref, self.rate = p, V, omega_0 / p.L
        i = losses(p, V).real / V
        self.start = [1.0, -i, 0.0, 0.0, i, -p.R * i, (p.Kf - p.L) * i]

    def current(self, z: Values, _u: float, V: complex, _end: int) -> complex:
        """Current into the network."""
        return complex(z[1], z[2]) * V / abs(V)

    def rates(self, z: Values, u: float, V: float) -> Values:
        p, (vdc, i_d, i_q, x_ac, x_dc, x_d, x_q) = self.p, z
        e = self.Vref + u - V + p.droop * i_q
        free_Q = p.Kp * e + x_ac
        free_P = p.Kd * (1.0 - vdc) + x_dc
        active = clip(free_P, p.I_max)
        room = math.sqrt(p.I_max**2 - active**2) if p.enforce_rating else p.I_max
        e_d, e_q = -active - i_d, -clip(free_Q, room) - i_q
        c_d = vdc * (V - p.Kf * i_q + p.Kc * e_d + x_d)
        c_q = vdc * (p.Kf * i_d + p.Kc * e_q + x_q)
        return [
            -(c_d * i_d + c_q * i_q) / (p.tau * vdc) - p.g * vdc / p.tau,
            self.rate * (c_d - V - p.R * i_d + p.L * i_q),
            self.rate * (c_q - p.R * i_q - p.L * i_d),
            held(p.Ki * e, free_Q, room),
            held(p.Kdi * (1.0 - vdc), free_P, p.I_max),
            p.Kci * e_d,
            p.Kci * e_q,
        ]


class Susceptance:
    """SVC: an admittance j B from its bus to ground."""

    states = ("B",)

    def __init__(self, p: Svc, V: float) -> None:
        self.p, self.Vref, self.start = p, V, [0.0]

    def current(self, z: Values, _u: float, V: complex, _end: int) -> complex:
        """Current into the network: what flows into the admittance, turned round."""
        return -1j * z[0] * V

    def rates(self, z: Values, u: float, V: float) -> Values:
        p = self.p
        order = float(np.clip((u + self.Vref - V) * p.K, p.B_min, p.B_max))
        return [(order - z[0]) / p.T]


def losses(p: Statcom, V: float) -> complex:
    """What a STATCOM draws at rest: the smaller current whose power, less R i^2, is what the DC link loses."""
    currents = np.roots([p.R, -V, p.g]) if p.R > 0.0 else np.array([p.g / V])
    return complex(V * float(currents.real.min()))


class Link:
    """HVDC link: ends 0 (inverter) and 1 (rectifier); states are both voltages as they are known over there."""

    states = ("V_to", "V_from")

    def __init__(self, p: Hvdc, voltages: Values, base: float) -> None:
        self.p, self.base, self.start = p, base, list(voltages)

    def powers(self, z: Values, u: float, V: float) -> tuple[complex, complex]:
        """Complex powers given at both ends, if V is the voltage at the one that is asked."""
        p = self.p
        order = min(max(p.P / self.base + u, p.P_min / self.base), p.P_max / self.base)
        P = order * min(1.0, *((v / p.V_min) ** 2 for v in (*z, V)))
        power = P - p.loss * P - p.R * P**2
        sines = [math.sin(math.acos(pf)) / pf for pf in (p.pf_to, p.pf_from)]
        return complex(power, -power * sines[0]), complex(-P, -P * sines[1])

    def current(self, z: Values, u: float, V: complex, end: int) -> complex:
        """Current into the network at an end."""
        return complex((self.powers(z, u, abs(V))[end] / V).conjugate())

    def rates(self, z: Values, _u: float, *V: float) -> Values:
        return [(now - known) / self.p.T for now, known in zip(V, z, strict=True)]


class Modulated:
    """Load modulation: an ideal load of a power and a power factor, an impedance at low voltage."""

    states: tuple[str, ...] = ()

    def __init__(self, p: LoadModulation) -> None:
        self.p, self.start = p, list[float]()

    def power(self, _z: Values, u: float, V: float) -> complex:
        """Complex power given to the network."""
        drawn = complex(u, u * math.tan(math.acos(self.p.pf)))
        return -drawn * min(1.0, V / self.p.V_min) ** 2

    def current(self, z: Values, u: float, V: complex, _end: int) -> complex:
        """Current into the network."""
        return complex((self.power(z, u, abs(V)) / V).conjugate())

    def rates(self, _z: Values, _u: float, _V: float) -> Values:
        return []


class Battery:
    """BESS: power within rating and charge, then reactive power for the voltage in what the rating leaves."""

    states = ("charge",)

    def __init__(self, p: Bess, V: float, base: float) -> None:
        self.p, self.Vref, self.start = p, V, [p.charge]
        self.S, self.hours = p.S_rated / base, p.E_rated / base

    def power(self, z: Values, u: float, V: float) -> complex:
        """Complex power given to the network."""
        p = self.p
        sizes = np.clip([(z[0] - p.charge_min) / p.taper, (p.charge_max - z[0]) / p.taper], 0.0, 1.0)
        P = float(np.clip(u, -self.S * sizes[1], self.S * sizes[0]))
        Q = clip(p.K * (self.Vref - V), math.sqrt(self.S**2 - P**2))
        return complex(P, Q) * min(1.0, V / p.V_min) ** 2

    def current(self, z: Values, u: float, V: complex, _end: int) -> complex:
        """Current into the network."""
        return complex((self.power(z, u, abs(V)) / V).conjugate())

    def rates(self, z: Values, u: float, V: float) -> Values:
        P = self.power(z, u, V).real
        inside = P / self.p.eta_out if P > 0.0 else P * self.p.eta_in
        return [-inside / self.hours / 3600.0]


class Ramp:
    """A device's reference: each setpoint, after its dead time, limited and approached at the largest rate."""

    def __init__(
        self,
        p: Sssc | Statcom | Svc | Hvdc | LoadModulation | Bess | Tcsc | ExciterInput | InverterInput,
        targets: Targets,
        end: float,
    ) -> None:
        t, u = [0.0], [0.0]
        finite = [
            (max(time, 0.0) + p.dead_time, clip(value, p.setpoint_max))
            for time, value in targets
            if math.isfinite(value)
        ]
        for (time, goal), (until, _) in pairwise([*finite, (end, 0.0)]):
            reach = p.rate_max * max(until - time, 0.0)
            reached = goal if abs(goal - u[-1]) <= reach else u[-1] + math.copysign(reach, goal - u[-1])
            t += [time, time + abs(reached - u[-1]) / p.rate_max]
            u += [u[-1], reached]
        self.t, self.u = np.array([*t, max(end, t[-1])]), np.array([*u, u[-1]])

    def at(self, t: NDArray[np.float64] | float) -> NDArray[np.float64]:
        """Reference at times."""
        return np.asarray(np.interp(t, self.t, self.u))
