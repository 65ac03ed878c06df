"""Inverters in the reference model: one class a model, complex numbers for voltages and currents, start by algebra.

Quantities are in per unit of an inverter's rating, angles in rad in the network's frame, time in s. A current flows
into the network. A source's current follows from its states and the terminal's voltage.
"""

from __future__ import annotations

import cmath
import math
from typing import TYPE_CHECKING, Any, NamedTuple

from .reference_controls import held

if TYPE_CHECKING:
    from collections.abc import Mapping

    Values = list[float]

LEAST = 0.002  # s, of time constants that must not be 0


class Sight(NamedTuple):
    """What an inverter and its controls see: voltage and current at the terminals, and at the plant."""

    V: complex
    I: complex  # noqa: E741
    bus: complex  # voltage of the regulated bus
    branch: complex  # power of the monitored branch
    set: Mapping[str, float]  # setpoints of devices: Paux, Qaux, Vaux, Pplant, Qplant, Vplant

    @property
    def S(self) -> complex:
        """Power into the network."""
        return self.V * self.I.conjugate()

    def setpoint(self, name: str) -> float:
        """A setpoint, 0 where no device gives it."""
        return self.set.get(name, 0.0)


class Orders(NamedTuple):
    """What the controls ask of the converter; a grid-forming one takes them for Pset, and for Vset or Qset."""

    p: float
    q: float


def within(value: float, low: float, high: float) -> float:
    """A value within two limits."""
    return float(min(max(value, low), high))


def shortened(current: complex, most: float) -> complex:
    """A current that is no larger than allowed, in its direction."""
    size = abs(current)
    return current * most / size if size > most else current


def stopped(rate: float, value: float, low: float, high: float) -> float:
    """Rate of an integral that comes to rest at its limits, no faster than they are reached in 2 ms."""
    return within(rate, (low - value) / LEAST, (high - value) / LEAST)


def lag(value: float, state: float, T: float) -> float:
    """Rate of a first-order lag."""
    return (value - state) / max(T, LEAST)


class Droop:
    """REGFMA1: an EMF whose angle integrates a droop of P, and whose size has a droop of Q."""

    def __init__(self, p: Any, V: complex, S: complex, omega_0: float) -> None:
        self.p, self.omega_0, self.Z = p, omega_0, complex(p.Re, p.Xe)
        emf = V + self.Z * (S / V).conjugate()
        angle, E = cmath.phase(emf), abs(emf)
        self.states = ("P_seen", "Q_seen", "V_seen", "P_above", "P_below", "Q_above", "Q_below", "angle_order")
        self.start = [S.real, S.imag, abs(V), 0.0, 0.0, 0.0, 0.0, angle]
        for name, value, there in (
            ("E_integral", E, p.VFlag == 1),
            ("angle", angle, p.Td > 0.0),
            ("E_limited", E, p.Te > 0.0),
            ("E", E, p.Tv > 0.0),
        ):
            self.states += (name,) * there
            self.start += [value] * there
        self.base = abs(V) if p.VFlag == 1 else E
        q = 0.0 if p.QVFlag == 1 else S.imag
        self.orders = Orders(S.real, self.base + p.mq * S.imag if p.QVFlag == 1 else q)

    def _voltage(self, z: dict[str, float], orders: Orders, aux: tuple[float, float]) -> tuple[float, float]:
        """The voltage command, and the ordered EMF."""
        p = self.p
        Vset, Qset = (orders.q, 0.0) if p.QVFlag == 1 else (self.base, orders.q)
        excess, lack = p.Qmax - z["Q_seen"], p.Qmin - z["Q_seen"]
        command = Vset + aux[1] + p.mq * (Qset + aux[0] - z["Q_seen"])
        command += min(0.0, p.Kpqmax * excess + z["Q_above"]) + max(0.0, p.Kpqmax * lack + z["Q_below"])
        E = p.Kpv * (command - z["V_seen"]) + z["E_integral"] if p.VFlag == 1 else command
        return command, within(E, p.Emin, p.Emax)

    def current(self, x: Values, V: complex, orders: Orders, sets: Mapping[str, float]) -> complex:
        """Current for a voltage."""
        z = dict(zip(self.states, x, strict=True))
        ordered = self._voltage(z, orders, (sets.get("Qaux", 0.0), sets.get("Vaux", 0.0)))[1]
        E = z.get("E", within(z.get("E_limited", ordered), self.p.Emin, self.p.Emax))
        free = (cmath.rect(E, z.get("angle", z["angle_order"])) - V) / self.Z
        return shortened(free, self.p.Imax or math.inf)

    def rates(self, x: Values, sight: Sight, orders: Orders) -> Values:
        p, z, S = self.p, dict(zip(self.states, x, strict=True)), sight.S
        P, Q = z["P_seen"], z["Q_seen"]
        slip = p.mp * (orders.p + sight.setpoint("Paux") - P)
        slip += min(0.0, p.Kppmax * (p.Pmax - P) + z["P_above"]) + max(0.0, p.Kppmax * (p.Pmin - P) + z["P_below"])
        command, ordered = self._voltage(z, orders, (sight.setpoint("Qaux"), sight.setpoint("Vaux")))
        limited = within(z.get("E_limited", ordered), p.Emin, p.Emax)
        moves = {
            "P_seen": lag(S.real, P, p.Tpf),
            "Q_seen": lag(S.imag, Q, p.Tqf),
            "V_seen": lag(abs(sight.V), z["V_seen"], p.Tvf),
            "P_above": stopped(p.Kipmax * (p.Pmax - P), z["P_above"], -math.inf, 0.0),
            "P_below": stopped(p.Kipmax * (p.Pmin - P), z["P_below"], 0.0, math.inf),
            "Q_above": stopped(p.Kiqmax * (p.Qmax - Q), z["Q_above"], -math.inf, 0.0),
            "Q_below": stopped(p.Kiqmax * (p.Qmin - Q), z["Q_below"], 0.0, math.inf),
            "angle_order": self.omega_0 * slip,
        }
        if p.VFlag == 1:
            moves["E_integral"] = held(p.Kiv * (command - z["V_seen"]), z["E_integral"], p.Emin, p.Emax)
        for name, value, T in (
            ("angle", z["angle_order"], p.Td),
            ("E_limited", ordered, p.Te),
            ("E", limited, p.Tv),
        ):
            if T > 0.0:
                moves[name] = lag(value, z[name], T)
        return [moves[name] for name in self.states]


class VirtualMachine:
    """REGFMB1: an EMF with the swing of a machine, of which only what lies ahead of a PLL's angle is limited."""

    states = (
        *("P_seen", "Q_seen", "V_seen", "Id_seen", "Iq_seen", "slip", "washed", "pll_order", "angle", "angle_IT"),
        *("angle_max", "angle_min", "E", "pulled"),
    )

    def __init__(self, p: Any, V: complex, S: complex, omega_0: float) -> None:
        self.p, self.omega_0, self.Z = p, omega_0, complex(p.Re, p.Xe)
        I0 = (S / V).conjugate()
        emf, along = V + self.Z * I0, I0 * cmath.exp(-1j * cmath.phase(V))
        self.widest = math.asin(min(1.0, p.Xe * p.ImaxSS))
        ahead = cmath.phase(emf / V)
        seen = [S.real, S.imag, abs(V), along.real, along.imag]
        least = -self.widest if p.ESFlag == 1 else 0.0
        self.start = [*seen, 0.0, 0.0, 0.0, cmath.phase(V), ahead, self.widest, least, abs(emf), 0.0]
        self.V0 = abs(V)
        drop = -along.imag if p.QVFlag == 1 == p.VdrpFlag else S.imag
        self.orders = Orders(S.real, self.V0 + p.mq * drop if p.QVFlag == 1 else S.imag)

    def _shares(self, d: float, q: float) -> tuple[float, float]:
        """Steady active and reactive current that are allowed."""
        p = self.p
        first, left = (p.Kf or 1.0) * p.ImaxSS, math.sqrt(max(0.0, p.ImaxSS**2 - (d if p.PQFlag == 1 else q) ** 2))
        return (first, left) if p.PQFlag == 1 else (left, first)

    def _emf(self, x: Values, command: float) -> tuple[complex, float, float, float]:
        """The EMF, its size without limits, and the limits."""
        p, (_, _, V, d, q, _, _, _, pll, ahead, most, least, integral, _) = self.p, x
        across = self._shares(d, q)[1]
        low, high = (abs(complex(V + side * p.Xe * across, p.Xe * d)) for side in (-1, 1))
        free = p.Kpv * (command - V) + integral
        return cmath.rect(within(free, low, high), pll + within(ahead, least, most)), free, low, high

    def _command(self, x: Values, orders: Orders, sets: Mapping[str, float]) -> float:
        mq, more = float(self.p.mq), sets.get("Vaux", 0.0) + float(self.p.mq) * sets.get("Qaux", 0.0)
        if self.p.QVFlag != 1:
            return self.V0 + mq * (orders.q - x[1]) + more
        return orders.q - mq * (-x[4] if self.p.VdrpFlag == 1 else x[1]) + more

    def current(self, x: Values, V: complex, orders: Orders, sets: Mapping[str, float]) -> complex:
        """Current for a voltage."""
        return shortened((self._emf(x, self._command(x, orders, sets))[0] - V) / self.Z, self.p.ImaxF)

    def rates(self, x: Values, sight: Sight, orders: Orders) -> Values:
        p, S = self.p, sight.S
        P, Q, V, d, q, slip, washed, integral, pll, ahead, most, least, x_E, droop = x
        to_pll = cmath.exp(-1j * pll)
        I, across = sight.I * to_pll, (sight.V * to_pll).imag  # noqa: E741
        running = abs(sight.V) > p.VPLLfrz
        asked = p.KpPLL * across + integral
        turn = within(asked, p.DwPLLmin, p.DwPLLmax) if running else 0.0
        pulled = (turn if p.wFlag == 1 else slip) / p.mp if p.FFlag == 1 else 0.0
        power = orders.p + sight.setpoint("Paux") - (droop if p.Tp > 0.0 else pulled)
        torque = power - P - p.D1 * slip - p.D2 * (slip - washed)
        command = self._command(x, orders, sight.set)
        free, low, high = self._emf(x, command)[1:]
        active = self._shares(d, q)[0]
        back = stopped(p.Ki * (-p.Ke * active - d), least, -self.widest, 0.0) if p.ESFlag == 1 else 0.0
        stands = free if p.Kiv * (command - V) else x_E
        return [
            lag(S.real, P, p.Tpf),
            lag(S.imag, Q, p.Tqf),
            lag(abs(sight.V), V, p.Tvf),
            lag(I.real, d, p.Tif),
            lag(I.imag, q, p.Tif),
            held(torque / (2.0 * p.H), slip, p.Dwmin, p.Dwmax),
            p.wD * (slip - washed),
            held(p.KiPLL * across, asked, p.DwPLLmin, p.DwPLLmax) if running else 0.0,
            self.omega_0 * turn,
            held(self.omega_0 * (slip - turn), ahead, least, most),
            stopped(p.Ki * (active - d), most, 0.0, self.widest),
            back,
            held(p.Kiv * (command - V), stands, low, high),
            lag(pulled, droop, p.Tp) if p.Tp > 0.0 else 0.0,
        ]


class Following:
    """REGCB1: currents that follow the commands, made by an EMF in the direction of the voltage; REGCC1: by a PLL."""

    def __init__(self, p: Any, V: complex, S: complex, _omega_0: float) -> None:
        self.p, self.Z, self.pll = p, complex(p.Re, p.Xe), p.model == "REGCC1"
        self.states: tuple[str, ...] = ("V_filtered", "Ip", "Iq_into", "Ed", "Eq")
        Vt = abs(V)
        I0 = S.conjugate() / Vt
        E = Vt + self.Z * I0
        self.orders = Orders(I0.real, -I0.imag)
        self.P0, self.Q0 = S.real, S.imag
        self.start = [Vt, (S.real if p.RateFlag == 1 else I0.real), -I0.imag, E.real, E.imag]
        if self.pll:
            self.states += ("Ip_sent", "Iq_sent", "pll", "angle")
            self.start += [I0.real, -I0.imag, 0.0, cmath.phase(V)]

    def _turn(self, x: Values, V: complex) -> complex:
        """Direction of the EMF's first part."""
        return cmath.rect(1.0, x[8]) if self.pll else V / abs(V) if V else 1.0 + 0.0j

    def current(self, x: Values, V: complex, _orders: Orders, _sets: Mapping[str, float]) -> complex:
        """Current for a voltage."""
        return (complex(x[3], x[4]) * self._turn(x, V) - V) / self.Z

    def rates(self, x: Values, sight: Sight, orders: Orders) -> Values:
        p, turn = self.p, self._turn(x, sight.V)
        seen = max(x[0], 0.01)
        scale = seen if p.RateFlag == 1 else 1.0
        Ip, Iq = x[1] / scale, x[2]
        if p.PQFlag == 1:
            Ip = within(Ip, -p.Imax, p.Imax)
            Iq = within(Iq, -(room := math.sqrt(p.Imax**2 - Ip**2)), room)
        else:
            Iq = within(Iq, -p.Imax, p.Imax)
            Ip = within(Ip, -(room := math.sqrt(p.Imax**2 - Iq**2)), room)
        grown, recovered = lag(orders.p * scale, x[1], p.Tg), lag(orders.q, x[2], p.Tg)
        grown = min(grown, p.rrpwr) if self.P0 >= 0.0 else max(grown, -p.rrpwr)
        if self.Q0 > 0.0:
            recovered = min(recovered, p.Iqrmax)
        elif self.Q0 < 0.0:
            recovered = max(recovered, p.Iqrmin)
        V, order, tail = sight.V / turn, complex(Ip, -Iq), list[float]()
        if self.pll:
            error = order - sight.I / turn
            order = p.Kip * error + complex(x[5], -x[6])
            asked = p.Kppll * V.imag + x[7]
            tail = [
                *(p.Kii * error.real, -p.Kii * error.imag),
                held(p.Kipll * V.imag, asked, p.wmin, p.wmax),
                within(asked, p.wmin, p.wmax),
            ]
        E = V + self.Z * order
        return [
            lag(abs(sight.V), x[0], p.Tfltr) if p.Tfltr else 0.0,
            *(grown, recovered, lag(E.real, x[3], p.Te), lag(E.imag, x[4], p.Te), *tail),
        ]


class Current:
    """REGCA1: a current in the direction of the voltage; it is less at low and high voltage."""

    def __init__(self, p: Any, V: complex, S: complex, _omega_0: float) -> None:
        self.p, self.P0, self.Q0 = p, S.real, S.imag
        size = abs(V)
        Ip, Iq = S.real / size / self._gain(size), S.imag / size + self._less(size)
        self.orders = Orders(Ip, Iq)
        self.states: tuple[str, ...] = ("Ip_lag", "Iq_into", *(("V_low",) if p.Lvplsw == 1 else ()))
        self.start = [Ip, Iq, *([size] if p.Lvplsw == 1 else [])]

    def _gain(self, V: float) -> float:
        """Active current at low voltage, as a fraction."""
        low, high = self.p.Lvpnt0, self.p.Lvpnt1
        return within((V - low) / (high - low), 0.0, 1.0)

    def _less(self, V: float) -> float:
        """Reactive current that high voltage takes away."""
        return float(self.p.Khv * max(0.0, V - self.p.Volim))

    def _most(self, x: Values) -> float:
        """The active current that the logic of low voltage allows."""
        p = self.p
        if p.Lvplsw != 1 or x[2] > p.Brkpt:
            return math.inf
        return max(0.0, float(p.Lvpl1 * (x[2] - p.Zerox) / (p.Brkpt - p.Zerox)))

    def current(self, x: Values, V: complex, _orders: Orders, _sets: Mapping[str, float]) -> complex:
        """Current for a voltage."""
        size = abs(V)
        turn, less = V / size if size else 1.0 + 0.0j, self._less(size)
        Iq = max(x[1] - less, self.p.Iolim) if less else x[1]
        return complex(self._gain(size) * min(x[0], self._most(x)), -Iq) * turn

    def rates(self, x: Values, sight: Sight, orders: Orders) -> Values:
        p, most = self.p, self._most(x)
        asked = min(orders.p, most) - max(p.Tg / LEAST - 1.0, 0.0) * max(0.0, x[0] - most)
        grown, recovered = lag(asked, x[0], p.Tg), lag(orders.q, x[1], p.Tg)
        grown = min(grown, p.Rrpwr) if self.P0 >= 0.0 else max(grown, -p.Rrpwr)
        recovered = within(recovered, p.Iqrmin if self.Q0 < 0.0 else -math.inf, p.Iqrmax if self.Q0 > 0.0 else math.inf)
        return [grown, recovered, *([lag(abs(sight.V), x[2], p.Tfltr)] if p.Lvplsw == 1 else [])]


Source = Droop | VirtualMachine | Following | Current
SOURCES: dict[str, type[Source]] = {
    "REGFMA1": Droop,
    "REGFMB1": VirtualMachine,
    "REGCB1": Following,
    "REGCC1": Following,
    "REGCA1": Current,
}
