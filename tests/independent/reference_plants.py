"""Controls of inverters in the reference model: REECB1 and REPCA1, and an inverter together with them.

Quantities are in per unit of the inverter's rating, time in s. `orders` of a control follow from states and from what
is seen; starts are found by algebra.
"""

from __future__ import annotations

import cmath
import math
from typing import TYPE_CHECKING, Any

from .reference_controls import held
from .reference_inverters import SOURCES, Orders, Sight, lag, within

if TYPE_CHECKING:
    from collections.abc import Mapping

    from .reference_inverters import Source

    Values = list[float]

LOWEST = 0.01  # p.u. of voltage that powers are divided by
FREQUENCY = 0.02  # s, of both lags of a measured frequency


def beyond(value: float, low: float, high: float) -> float:
    """What is outside a dead band."""
    return value - within(value, low, high)


class ElectricalControl:
    """REECB1: a power order over the voltage, a reactive current by regulators of Q and V, support in dips."""

    def __init__(self, p: Any, V: float, S: complex, commands: Orders) -> None:
        self.p, self.Vref = p, p.Vref0 or V
        self.by_voltage = p.QFLAG == 1
        self.by_power = self.by_voltage and p.VFLAG == 1
        support = self._support(V)
        self.states: tuple[str, ...] = ("V_seen", "Pord", "Iq_order", *(("V_order",) if self.by_power else ()))
        self.start = [V, commands.p * V, commands.q - support, *([V] if self.by_power else [])]
        asked = (commands.q - support) * V if not self.by_voltage else S.imag if self.by_power else V
        self.orders = Orders(commands.p * V, asked)

    def _support(self, V: float) -> float:
        """Reactive current in support of the voltage."""
        p = self.p
        return within(p.Kqv * beyond(self.Vref - V, p.dbd1, p.dbd2), p.Iql1, p.Iqh1)

    def commands(self, x: Values, sight: Sight, orders: Orders) -> tuple[Orders, Values]:
        """Currents that are asked for, and rates of the states."""
        p, (V, power, state) = self.p, x[:3]
        free = p.Vdip <= abs(sight.V) <= p.Vup
        Q = orders.q + sight.setpoint("Qaux")
        voltage = 0.0
        if self.by_power:
            error = within(Q, p.Qmin, p.Qmax) - sight.S.imag
            order = p.Kqp * error + x[3]
            voltage = within(within(order, p.Vmin, p.Vmax) + sight.setpoint("Vaux"), p.Vmin, p.Vmax)
        elif self.by_voltage:
            voltage = within(orders.q + sight.setpoint("Vaux"), p.Vmin, p.Vmax)
        active = within(power, p.Pmin, p.Pmax) / max(V, LOWEST)
        supported, raw = self._support(V), state + p.Kvp * (voltage - V) if self.by_voltage else state

        def room(current: float) -> float:
            return math.sqrt(max(0.0, p.Imax**2 - current**2))

        if p.PQFLAG == 1:
            Ip = within(active, 0.0, p.Imax)
            most = room(Ip)
            Iq = within((within(raw, -most, most) if self.by_voltage else raw) + supported, -most, most)
        else:
            most = p.Imax
            Iq = within((within(raw, -most, most) if self.by_voltage else raw) + supported, -most, most)
            Ip = within(active, 0.0, room(Iq))
        moved = within((orders.p + sight.setpoint("Paux") - power) / max(p.Tpord, 0.002), p.dPmin, p.dPmax)
        rates = [lag(abs(sight.V), V, p.Trv), held(moved, power, p.Pmin, p.Pmax)]
        if self.by_voltage:
            rates.append(held(p.Kvi * (voltage - V), raw, -most, most))
        else:
            rates.append(lag(Q / max(V, LOWEST), state, p.Tiq))
        if self.by_power:
            rates.append(held(p.Kqi * error, order, p.Vmin, p.Vmax))
        return Orders(Ip, Iq), [rates[0], *(rate * free for rate in rates[1:])]


class PlantControl:
    """REPCA1: a regulator of voltage or reactive power at a bus, and of active power with droops of the frequency."""

    def __init__(self, p: Any, at: Sight, orders: Orders) -> None:
        self.p, self.orders = p, orders
        self.states: tuple[str, ...] = ("seen", "Q_regulated", "Qext")
        self.reference = self._seen(at)
        self.start = [self.reference, orders.q, orders.q]
        self.P0 = at.branch.real
        if p.Fflag == 1:
            self.states += ("P_plant", "P_regulated", "Pext", "angle_seen", "turning")
            angle = cmath.phase(at.bus)
            self.start += [self.P0, orders.p, orders.p, angle, angle]

    def _seen(self, sight: Sight) -> float:
        """What the regulator of the reactive side sees."""
        p = self.p
        if p.RefFlag != 1:
            return float(sight.branch.imag)
        if p.VCFlag == 1:
            return abs(sight.bus - complex(p.Rc, p.Xc) * (sight.branch / sight.bus).conjugate())
        return abs(sight.bus) + float(p.Kc) * sight.branch.imag

    def given(self, x: Values, sets: Mapping[str, float]) -> tuple[Orders, float]:
        """Orders for the electrical control, and the regulated reactive side before its lead-lag."""
        p = self.p
        added = sets.get("Vplant", 0.0) if p.RefFlag == 1 else 0.0
        error = within(beyond(self.reference + added - x[0], p.dbd1, p.dbd2), p.emin, p.emax)
        free = p.Kp * error + x[1]
        ahead = within(free, p.Qmin, p.Qmax) + sets.get("Qplant", 0.0)
        q = x[2] + p.Tft / p.Tfv * (ahead - x[2]) if p.Tfv > 0.0 else ahead
        self.error, self.free, self.ahead = error, free, ahead
        return Orders(x[5] if p.Fflag == 1 else self.orders.p, q), error

    def rates(self, x: Values, sight: Sight, omega_0: float) -> Values:
        p = self.p
        error = self.given(x, sight.set)[1]
        moved = held(p.Ki * error, self.free, p.Qmin, p.Qmax) if abs(sight.bus) >= p.Vfrz else 0.0
        rates = [lag(self._seen(sight), x[0], p.Tfltr), moved, lag(self.ahead, x[2], p.Tfv) if p.Tfv > 0.0 else 0.0]
        if p.Fflag == 1:
            turned = math.remainder(cmath.phase(sight.bus) - x[6], 2.0 * math.pi) / FREQUENCY
            slip = (x[6] - x[7]) / FREQUENCY / omega_0
            outside = beyond(-slip, p.fdbd1, p.fdbd2)
            droop = min(0.0, p.Ddn * outside) + max(0.0, p.Dup * outside)
            lack = within(self.P0 + droop - x[3], p.femin, p.femax)
            free = p.Kpg * lack + x[4]
            rates += [
                lag(sight.branch.real, x[3], p.Tp),
                held(p.Kig * lack, free, p.Pmin, p.Pmax),
                lag(within(free, p.Pmin, p.Pmax) + sight.setpoint("Pplant"), x[5], p.Tg),
                *(turned, slip * omega_0),
            ]
        return rates


class Inverter:
    """An inverter with its controls: states of all, its current, rates."""

    def __init__(self, row: Any, controls: Mapping[str, Any], at: Sight, omega_0: float) -> None:
        self.row, self.omega_0 = row, omega_0
        self.source: Source = SOURCES[row.model](row, at.V, at.S, omega_0)
        self.electrical = self.plant = None
        asked = self.source.orders
        if "REECB1" in controls:
            self.electrical = ElectricalControl(controls["REECB1"], abs(at.V), at.S, asked)
            asked = self.electrical.orders
        if "REPCA1" in controls:
            self.plant = PlantControl(controls["REPCA1"], at, asked)
        self.asked = asked
        self.parts = [part for part in (self.source, self.electrical, self.plant) if part is not None]
        self.states = [name for part in self.parts for name in part.states]
        self.start = [value for part in self.parts for value in part.start]

    def _split(self, x: Values) -> list[Values]:
        blocks, at = [], 0
        for part in self.parts:
            blocks.append(x[at : at + len(part.states)])
            at += len(part.states)
        return blocks

    def _orders(self, blocks: list[Values], sets: Mapping[str, float]) -> Orders:
        """What its electrical control, or a forming source, is asked for."""
        return self.asked if self.plant is None else self.plant.given(blocks[-1], sets)[0]

    def current(self, x: Values, V: complex, sets: Mapping[str, float]) -> complex:
        """Current into the network at a voltage."""
        blocks = self._split(x)
        return self.source.current(blocks[0], V, self._orders(blocks, sets), sets)

    def rates(self, x: Values, sight: Sight) -> Values:
        blocks = self._split(x)
        orders, rates = self._orders(blocks, sight.set), list[float]()
        if self.electrical is not None:
            orders, rates = self.electrical.commands(blocks[1], sight, orders)
        if self.plant is not None:
            rates = [*rates, *self.plant.rates(blocks[-1], sight, self.omega_0)]
        return [*self.source.rates(blocks[0], sight, orders), *rates]
