"""Independent reference model of the two-area systems: network data, power flow and admittance matrix.

Units: p.u. on 100 MVA and 230 kV unless a machine quantity (900 MVA), angles in rad, time in s.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import root

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

S_BASE = 100.0  # MVA
S_MACHINE = 900.0  # MVA
W0 = 2.0 * np.pi * 60.0  # rad/s
LINE_R, LINE_X, LINE_B = 1e-4, 1e-3, 1.75e-3  # p.u. per km (docs/plant.md, Kundur example 12.6)
RS, XS = 0.000053, 0.0016  # SSSC's coupling (docs/plant.md)
X_TRANSFORMER = 0.15 * S_BASE / S_MACHINE
Y_MAGNETISING = (1.0 / 500.0 + 1.0 / 500.0j) * S_MACHINE / S_BASE  # Rm = Xm = 500 p.u. on 900 MVA

# Bus "w" and "e" are the halves of the split middle bus 8.
BUSES = ("1", "2", "3", "4", "5", "6", "7", "w", "e", "9", "10", "11")
TRANSFORMERS = (("1", "5"), ("2", "6"), ("3", "11"), ("4", "10"))
LINES = {  # name: (from, to, km); 1 to 4 as docs/plant.md numbers them
    "5-6": ("5", "6", 25.0),
    "6-7": ("6", "7", 10.0),
    "1": ("7", "w", 110.0),
    "2": ("7", "w", 110.0),
    "3": ("e", "9", 110.0),
    "4": ("e", "9", 110.0),
    "9-10": ("9", "10", 10.0),
    "10-11": ("10", "11", 25.0),
}


@dataclass(frozen=True)
class Case:
    """Data of one system (docs/plant.md, section 1)."""

    name: str
    P_MW: tuple[float, float, float, float]
    V: tuple[float, float, float, float]
    slack: int  # index of the machine
    slack_angle: float  # rad
    loads: dict[str, complex]  # MW + j Mvar
    capacitors: dict[str, float]  # Mvar at 1 p.u.
    long_line: bool  # exact pi equivalent instead of the plain pi section
    magnetising: str  # side of the transformers' magnetising branch: none, machine, network, split
    load_impedance: bool  # loads are nominal at 1 p.u. and of constant impedance in the power flow already
    bypass: float  # resistance between the halves of the middle bus when no SSSC is installed [p.u.]


TWO_AREA = Case(
    name="two_area",
    P_MW=(700.0, 700.0, 719.0, 700.0),
    V=(1.0, 1.0, 1.0, 1.0),
    slack=1,
    slack_angle=0.0,
    loads={"7": 967.0 + 100.0j, "9": 1767.0 + 100.0j},
    capacitors={"7": 387.0, "9": 537.0},
    long_line=True,
    magnetising="machine",
    load_impedance=True,
    bypass=RS,
)
KUNDUR_12_6 = Case(
    name="kundur_12_6",
    P_MW=(700.0, 700.0, 719.0, 700.0),
    V=(1.03, 1.01, 1.03, 1.01),
    slack=2,
    slack_angle=float(np.deg2rad(-6.8)),
    loads={"7": 967.0 + 100.0j, "9": 1767.0 + 100.0j},
    capacitors={"7": 200.0, "9": 350.0},
    long_line=False,
    magnetising="none",
    load_impedance=False,
    bypass=1e-6,
)


@dataclass(frozen=True)
class Config:
    """State of the network and of the turbines between two events.

    A bolted fault is at a bus, or at a fraction of a line counted from its first bus.
    """

    lines_out: frozenset[str] = frozenset()
    load_factor: tuple[tuple[str, float], ...] = ()  # (bus, factor on P and Q of its load)
    fault: tuple[str, float | None] | None = None  # (bus, None) or (line, fraction)
    fault_z: complex = 0.0j  # zero: bolted
    Pm_factor: tuple[float, float, float, float] = (1.0, 1.0, 1.0, 1.0)

    @property
    def fault_row(self) -> int | None:
        """Index of the faulted bus: that of its name, or one past the others for a point on a line."""
        if self.fault is None:
            return None
        return BUSES.index(self.fault[0]) if self.fault[1] is None else len(BUSES)


HEALTHY = Config()


def line_pi(case: Case, km: float) -> tuple[complex, complex]:
    """Series admittance and one shunt admittance of a line's pi section [p.u.]."""
    z, y = (LINE_R + 1j * LINE_X) * km, 1j * LINE_B * km
    if case.long_line:
        gl = np.sqrt(z * y)
        z, y = z * np.sinh(gl) / gl, y * np.tanh(gl / 2.0) / (gl / 2.0)
    return 1.0 / z, y / 2.0


def _branch(Y: Complex, a: int, b: int, series: complex, shunt_a: complex, shunt_b: complex) -> None:
    Y[[a, b], [a, b]] += (series + shunt_a, series + shunt_b)
    Y[[a, b], [b, a]] -= series


def admittance(case: Case, config: Config, bypass: float) -> Complex:
    """Bus admittance matrix with transformers, lines and capacitors, without loads [p.u.].

    A fault on a line appends the faulted point as last bus. ``bypass`` is the resistance between the halves
    of the middle bus; zero leaves them apart.
    """
    on_line = config.fault is not None and config.fault[1] is not None
    n = len(BUSES) + on_line
    Y = np.zeros((n, n), dtype=complex)
    side = {"none": (0.0, 0.0), "machine": (1.0, 0.0), "network": (0.0, 1.0), "split": (0.5, 0.5)}
    for low, high in TRANSFORMERS:
        shunts = [share * Y_MAGNETISING for share in side[case.magnetising]]
        _branch(Y, BUSES.index(low), BUSES.index(high), 1.0 / (1j * X_TRANSFORMER), shunts[0], shunts[1])
    for name, (start, stop, km) in LINES.items():
        if name in config.lines_out:
            continue
        a, b = BUSES.index(start), BUSES.index(stop)
        pieces = [(a, b, km)]
        if on_line and config.fault is not None and config.fault[0] == name:
            fraction = float(config.fault[1] or 0.0)
            pieces = [(a, n - 1, km * fraction), (n - 1, b, km * (1.0 - fraction))]
        for p, q, length in pieces:
            series, shunt = line_pi(case, length)
            _branch(Y, p, q, series, shunt, shunt)
    for bus, mvar in case.capacitors.items():
        Y[BUSES.index(bus), BUSES.index(bus)] += 1j * mvar / S_BASE
    if bypass:
        _branch(Y, BUSES.index("w"), BUSES.index("e"), 1.0 / bypass, 0.0j, 0.0j)
    return Y


@dataclass(frozen=True)
class PowerFlow:
    """Solution: bus voltages and powers of the machines, both complex [p.u.], and the worst mismatch."""

    V: Complex
    S: Complex
    residual: float


def power_flow(case: Case, bypass: float = RS) -> PowerFlow:
    """Solve the P and Q mismatches, S_i = V_i conj(sum_j Y_ij V_j), for angles and load-bus voltages.

    ``bypass`` [p.u.] stands for the SSSC. The thesis's four digits are those of a solid middle bus
    (1e-9); with the SSSC's resistance powers and voltages move by up to 1.2e-4.
    """
    Y = admittance(case, HEALTHY, bypass)
    n = len(BUSES)
    demand = np.zeros(n, dtype=complex)
    for bus, power in case.loads.items():
        demand[BUSES.index(bus)] = power / S_BASE
    scheduled = np.r_[np.array(case.P_MW) / S_BASE, np.zeros(n - 4)]
    free = [i for i in range(n) if i != case.slack]

    def voltages(unknown: Array) -> Complex:
        angle, magnitude = np.full(n, case.slack_angle), np.r_[case.V, np.zeros(n - 4)]
        angle[free], magnitude[4:] = unknown[: n - 1], unknown[n - 1 :]
        return np.asarray(magnitude * np.exp(1j * angle))

    def mismatch(unknown: Array) -> Array:
        V = voltages(unknown)
        S = V * np.conj(Y @ V) + demand * (np.abs(V) ** 2 if case.load_impedance else 1.0)
        return np.asarray(np.r_[S.real[free] - scheduled[free], S.imag[4:]])

    # The stiff bypass leaves the first pass at about 1e-9; a second one starts from its answer.
    guess = np.r_[np.full(n - 1, case.slack_angle), np.ones(n - 4)]
    for _ in range(3):
        guess = root(mismatch, guess, method="hybr", options={"xtol": 1e-15}).x
    V = voltages(guess)
    S = V * np.conj(Y @ V)
    return PowerFlow(V=V, S=S[:4], residual=float(np.abs(mismatch(guess)).max()))


def loaded_admittance(case: Case, config: Config, flow: PowerFlow, bypass: float) -> Complex:
    """Admittance with the constant-impedance loads and a fault's impedance.

    A bolted fault is not entered here: its row becomes V = 0 in the dense system of :mod:`.dynamics`.
    """
    Y = admittance(case, config, bypass)
    for bus, power in case.loads.items():
        i = BUSES.index(bus)
        nominal = 1.0 if case.load_impedance else abs(flow.V[i]) ** 2
        Y[i, i] += dict(config.load_factor).get(bus, 1.0) * np.conj(power / S_BASE) / nominal
    row = config.fault_row
    if row is not None and config.fault_z:
        Y[row, row] += 1.0 / config.fault_z
    return Y
