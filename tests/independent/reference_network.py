"""The algebraic equations of the reference model: all of one stage together, by Newton's method."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations
from typing import TYPE_CHECKING

import numpy as np
from scipy.optimize import root

from facts_damping.devices.sssc import Sssc
from facts_damping.devices.statcom import Statcom
from facts_damping_library.devices.svc import Svc

from .reference_grid import Array, Complex, Grid, Stage

if TYPE_CHECKING:
    from facts_damping_library.devices.tcsc import Tcsc

    from .reference import Model

    Blocked = frozenset[str]

TOLERANCE = 1e-12  # of a step of Newton's method
DIFFERENCE = 1e-6  # of an unknown, for the Jacobian


@dataclass(frozen=True)
class Known:
    """What the network is solved for: machine frames and voltages, states and references of devices."""

    turn: Complex  # exp(j (delta - pi/2))
    E: Complex  # Ed + j Eq
    devices: dict[str, list[float]]
    u: dict[str, float]
    inverters: list[list[float]]


class Solution:
    """The unknowns by what they are: bus voltages, Id + j Iq of machines, currents of SSSCs."""

    def __init__(self, y: Array, buses: int, machines: int) -> None:
        z = y.view(complex)
        self.y = y
        self.V: Complex = z[:buses]
        self.I: Complex = z[buses : buses + machines]
        self.i: Complex = z[buses + machines :]


def smallest(p: Sssc | Tcsc) -> float:
    """The least current that a device in series works with."""
    return p.I_min if isinstance(p, Sssc) else 0.0


def largest(p: Sssc | Tcsc) -> float:
    """The largest current that a device in series works with."""
    if isinstance(p, Sssc):
        return p.I_rated if p.enforce_rating else np.inf
    return p.I_max


class Network:
    """Kirchhoff's laws at every bus, the stators of all machines, the voltages over all SSSCs."""

    def __init__(self, model: Model, stage: Stage, before: Network | None = None) -> None:
        system = model.system
        self.model, self.stage, self.grid = model, stage, Grid(system, stage)
        row, n = self.grid.row, len(self.grid.buses)
        self.at = np.array([row[m.bus] for m in system.machines], dtype=int)
        self.on = np.array([m.name not in stage.tripped for m in system.machines])
        self.Ra = np.array([m.Ra for m in system.machines])
        self.Xd = np.array([rotor.Xd for rotor in model.rotors])
        self.Xq = np.array([rotor.Xq for rotor in model.rotors])
        self.load_scale = np.array([stage.loads.get(name, 1.0) for name in model.loads.names])
        self.ends = np.array([[row[bus] for bus in p.ends] for p in model.series], dtype=int).reshape(-1, 2)
        self.shunts = np.array([row[bus] for _, bus, _ in model.shunts], dtype=int)
        # Which bus each current enters, in this order: machines, loads, SSSCs, devices at buses.
        into = np.eye(n)
        scale = np.array([m.rating / system.base_power for m in system.machines])
        series = into[:, self.ends[:, 1]] - into[:, self.ends[:, 0]]
        self.inverters_at = np.array([row[i.bus] for i in system.inverters], dtype=int)
        rated = np.array([i.rating / system.base_power for i in system.inverters])
        parallel = [into[:, self.shunts], into[:, self.inverters_at] * rated]
        self.enter = np.hstack([into[:, self.at] * scale, -into[:, model.loads.at], series, *parallel])
        held = dict.fromkeys(self.grid.bolted, 0j)
        held |= {row[b.bus]: b.V * np.exp(1j * np.deg2rad(b.angle)) for b in system.infinite_buses}
        self.held, self.held_V = np.array(list(held), dtype=int), np.array(list(held.values()), complex)
        self.inverses: dict[Blocked, Array] = {}  # of the Jacobian where it last was needed
        self.first = self._unknowns(model.flow.V, model.I0, np.array(list(model.flow.I.values())))
        self.y = self.first
        if before is not None:
            last = before.split(before.y)
            self.y = self._unknowns(before.voltages(last), last.I, last.i)

    def _unknowns(self, V: dict[str, complex], current: Complex, series: Complex) -> Array:
        """The unknowns in a row; a point that had no voltage yet starts from none."""
        at_buses = [V.get(bus, 0.0j) for bus in self.grid.buses]
        return np.concatenate([at_buses, current, series]).astype(complex).view(float)

    def split(self, y: Array) -> Solution:
        """The unknowns by what they are."""
        return Solution(y, len(self.grid.buses), len(self.at))

    def voltages(self, s: Solution) -> dict[str, complex]:
        """Voltages by bus."""
        return dict(zip(self.grid.buses, s.V.tolist(), strict=True))

    def residual(self, y: Array, known: Known, blocked: Blocked) -> Array:
        """What is left of all equations; zero at the solution."""
        model, s = self.model, self.split(y)
        currents = [s.I * known.turn, model.loads.currents(s.V, self.load_scale), s.i]
        for (p, _, end), bus in zip(model.shunts, self.shunts, strict=True):
            V = complex(s.V[bus])
            z = known.devices[p.name]
            on = p.name in model.parallel and p.name not in blocked and V != 0.0
            current = model.parallel[p.name].current(z, known.u[p.name], V, end) if on else 0.0j
            currents.append(np.array([current]))
        currents.append(self.inverter_currents(s, known))
        balance = self.enter @ np.concatenate(currents) - self.grid.Y @ s.V
        balance[self.held] = s.V[self.held] - self.held_V
        v = s.V[self.at] / known.turn
        stator_d = known.E.real - v.real - self.Ra * s.I.real + self.Xq * s.I.imag
        stator_q = known.E.imag - v.imag - self.Ra * s.I.imag - self.Xd * s.I.real
        stators = np.where(self.on, stator_d + 1j * stator_q, s.I)
        over = np.array([model.drop(p, complex(i), known, blocked) for p, i in zip(model.series, s.i, strict=True)])
        drops = s.V[self.ends[:, 0]] - s.V[self.ends[:, 1]] - over
        return np.concatenate([balance, stators, drops]).view(float)

    def inverter_currents(self, s: Solution, known: Known) -> Complex:
        """Currents of inverters into the network, p.u. of their ratings."""
        units = zip(self.model.inverters, known.inverters, self.inverters_at, strict=True)
        sets = self.model.set_at
        return np.array(
            [unit.current(x, complex(s.V[at]), sets(unit.row.name, known.u)) for unit, x, at in units], complex
        )

    def _inverse(self, y: Array, known: Known, blocked: Blocked) -> Array:
        """The inverse of the Jacobian, by differences on one side: how soon Newton's method converges, not where to."""
        here = self.residual(y, known, blocked)
        columns = [self.residual(y + d, known, blocked) - here for d in DIFFERENCE * np.eye(len(y))]
        return np.asarray(np.linalg.inv(np.array(columns).T / DIFFERENCE), float)

    def _newton(self, y: Array, known: Known, blocked: Blocked) -> Array | None:
        """Newton's method, with an old Jacobian for as long as that converges quickly; none: no solution found."""
        last = np.inf
        for _ in range(50):
            if blocked not in self.inverses:
                self.inverses[blocked] = self._inverse(y, known, blocked)
            step = self.inverses[blocked] @ self.residual(y, known, blocked)
            y, size = y - step, float(np.abs(step).max())
            if size < TOLERANCE * (1.0 + float(np.abs(y).max())):
                return y
            if not size < 0.1 * last:
                del self.inverses[blocked]
            if not size < 1e6:
                break
            last = size
        self.inverses.pop(blocked, None)
        return None

    def _powell(self, known: Known, blocked: Blocked) -> Array | None:
        """Powell's method, where Newton's goes to and fro over the edge of a limit; none: no solution found."""
        y = root(self.residual, self.first, (known, blocked), method="hybr", options={"xtol": 1e-15}).x
        return y if float(np.abs(self.residual(y, known, blocked)).max()) < 1e-10 else None

    def _unfit(self, s: Solution) -> set[str]:
        """Devices whose current or voltage is too small to work with, or whose current is too large."""
        series = zip(self.model.series, s.i, strict=True)
        unfit = {p.name for p, i in series if not smallest(p) <= abs(i) <= largest(p)}
        shunts = zip(self.model.shunts, self.shunts, strict=True)
        return unfit | {p.name for (p, *_), bus in shunts if isinstance(p, Statcom | Svc) and abs(s.V[bus]) < p.V_min}

    def solve(self, known: Known) -> tuple[Solution, Blocked]:
        """All unknowns, with as few devices blocked as there is a solution with that all others can work in."""
        installed = self.model.installed
        for count in range(len(installed) + 1):
            for some in combinations(installed, count):
                blocked = frozenset(some)
                starts = (self.y, self.y, self.first, 0.5 * self.y)
                solutions = (self._newton(start, known, blocked) for start in starts)
                y = next((y for y in solutions if y is not None), None)
                y = self._powell(known, blocked) if y is None else y
                s = None if y is None else self.split(y)
                if s is not None and not self._unfit(s) & set(installed) - blocked:
                    self.y = s.y
                    return s, blocked
        raise RuntimeError("the network has no solution")
