"""Example 12.6 as Kundur's book computes it: rotors as circuits, saturation by the air-gap flux; eigenvalues.

P. Kundur, Power System Stability and Control, 1994: circuits and standard parameters 4.2, saturation 3.8, small
signals with incremental saturation 12.3, all machines and the network 12.6. Active power of loads goes with the
voltage, reactive power with its square. Exciters and stabilisers are those of the reference model; a machine without
has a constant field voltage. The power flow is the package's.

    python -m tests.independent.kundur_circuits     writes kundur_12_6_excitation_book.csv of config/references
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from facts_damping.case.loading import load_system
from facts_damping.plant.grid.power_flow import solve

from .reference_controls import Damper, exciter_of

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from facts_damping.parameters.plant.system import System

    Array = NDArray[np.float64]
    Complex = NDArray[np.complex128]

STEP = 1e-6  # of the central differences
FILE = Path(__file__).parents[2] / "config" / "references" / "kundur_12_6_excitation_book.csv"
SYSTEMS = ("kundur_12_6_dc", "kundur_12_6_thyristor", "kundur_12_6_thyristor_tgr", "kundur_12_6_thyristor_pss")


class Saturation(NamedTuple):
    """Current that the iron takes beyond the air gap: A exp(B (psi - threshold)) above the threshold, p.u."""

    A: float
    B: float
    threshold: float


BOOK = Saturation(0.015, 9.6, 0.9)


def network(system: System) -> Complex:
    """Bus admittances of lines (pi), transformers and capacitors, p.u."""
    index = {bus.name: i for i, bus in enumerate(system.buses)}
    Y = np.zeros((len(index), len(index)), np.complex128)
    branches = [
        (line.from_bus, line.to_bus, complex(line.r, line.x) * line.length, 0.5j * line.b * line.length)
        for line in system.lines
    ]
    branches += [
        (t.from_bus, t.to_bus, complex(t.r, t.x) * system.base_power / t.rating, 0j) for t in system.transformers
    ]
    for a, b, z, half in branches:
        i, j = index[a], index[b]
        Y[i, i] += 1 / z + half
        Y[j, j] += 1 / z + half
        Y[i, j] -= 1 / z
        Y[j, i] -= 1 / z
    for shunt in system.shunts:
        Y[index[shunt.bus], index[shunt.bus]] += 1j * shunt.Q / system.base_power
    return Y


def jacobian(function: Callable[[Array], Array], at: Array) -> Array:
    """Derivatives of a function by central differences."""
    moves = STEP * np.eye(len(at))
    return np.transpose([(function(at + move) - function(at - move)) / (2 * STEP) for move in moves])


def _beside(a: Array, b: Array) -> Array:
    return np.asarray(a * b / (a + b))


def eigenvalues(system: System, saturation: Saturation | None) -> Complex:
    """Eigenvalues, 1/s. States of all machines: angle, speed, flux linkages of fd, 1d, 1q, 2q; then their controls."""
    flow = solve(system)
    index = {name: i for i, name in enumerate(flow.names)}
    at = np.array([index[m.bus] for m in system.machines])
    Y, n, w0 = network(system), len(flow.names), 2 * np.pi * system.frequency
    H, Ra, Xl, Xd, Xd1, Xd2, Xq, Xq1, Xq2, Td01, Td02, Tq01, Tq02, rating = np.array(
        [
            (m.H, m.Ra, m.Xl, m.Xd, m.Xd1, m.Xd2, m.Xq, m.Xq1, m.Xq2, m.Td01, m.Td02, m.Tq01, m.Tq02, m.rating)
            for m in system.machines
        ],
        float,
    ).T
    ratio = rating / system.base_power

    # Standard parameters to circuits, all unsaturated.
    Lad, Laq = Xd - Xl, Xq - Xl
    Lfd, L1q = 1 / (1 / (Xd1 - Xl) - 1 / Lad), 1 / (1 / (Xq1 - Xl) - 1 / Laq)
    L1d, L2q = 1 / (1 / (Xd2 - Xl) - 1 / (Xd1 - Xl)), 1 / (1 / (Xq2 - Xl) - 1 / (Xq1 - Xl))
    Rfd, R1q = (Lad + Lfd) / (w0 * Td01), (Laq + L1q) / (w0 * Tq01)
    R1d, R2q = (L1d + _beside(Lad, Lfd)) / (w0 * Td02), (L2q + _beside(Laq, L1q)) / (w0 * Tq02)

    # Steady state: both axes saturated by the same factor K.
    V = flow.voltage[at]
    current = np.conj(np.array([flow.generation[m.name] for m in system.machines]) / V) / ratio
    psi = np.abs(V + (Ra + 1j * Xl) * current)
    A, B, threshold = saturation or (0.0, 0.0, np.inf)
    above = psi > threshold
    iron = above * A * np.exp(B * np.where(above, psi - threshold, 0.0))
    slope = B * iron
    K = psi / (psi + iron)
    delta = np.angle(V + (Ra + 1j * (K * Laq + Xl)) * current)
    turn = np.exp(-1j * (delta - np.pi / 2))
    v, i = V * turn, current * turn
    ad, aq = v.imag + Ra * i.imag + Xl * i.real, -(v.real + Ra * i.real) + Xl * i.imag
    field = ad / (K * Lad) + i.real
    torque = ad * i.imag - aq * i.real

    # Efd is 1 where the unsaturated machine has 1 p.u. open-circuit voltage.
    exciters = {row.machine: row for row in system.exciters}
    stabilisers = {row.machine: row for row in system.stabilisers}
    excited = [
        exciter_of(exciters.get(m.name), float(abs(u)), float(Efd))
        for m, u, Efd in zip(system.machines, V, Lad * field, strict=True)
    ]
    damped = [Damper(stabilisers.get(m.name)) for m in system.machines]
    controls = [value for e, s in zip(excited, damped, strict=True) for value in (*e.start, *[0.0] * len(s.states))]
    rotors = 6 * len(at)

    # Small signals: the mutual inductances are incremental ones.
    Md, Mq = Lad / (1 + slope), Laq / (1 + slope)
    fixed_d, fixed_q = ad - Md * (field - i.real), aq + Mq * i.imag
    x0 = np.concatenate([delta, 0 * delta, ad + Lfd * field, ad, aq, aq, controls])
    y0 = np.concatenate([flow.voltage.real, flow.voltage.imag, i.real, i.imag])

    def fluxes(x: Array, y: Array) -> tuple[Array, Array]:
        _, _, fd, d1, q1, q2 = x[:rotors].reshape(6, -1)
        Id, Iq = y[2 * n :].reshape(2, -1)
        return (
            (Md * (fd / Lfd + d1 / L1d - Id) + fixed_d) / (1 + Md / Lfd + Md / L1d),
            (Mq * (q1 / L1q + q2 / L2q - Iq) + fixed_q) / (1 + Mq / L1q + Mq / L2q),
        )

    def controlled(x: Array, y: Array) -> tuple[Array, list[float]]:
        """Field voltages, and derivatives of the controls' states."""
        Efd, rates, first = [], [], rotors
        for g, (exciter, damper) in enumerate(zip(excited, damped, strict=True)):
            second = first + len(exciter.states)
            last = second + len(damper.states)
            u, w = float(np.hypot(y[at[g]], y[n + at[g]])), float(x[len(at) + g])
            z, s = x[first:second].tolist(), x[second:last].tolist()
            signal = damper.output(s, w)
            Efd.append(exciter.field(z, u, signal))
            rates += [*exciter.rates(z, u, signal), *damper.rates(s, w)]
            first = last
        return np.array(Efd), rates

    def slopes(x: Array, y: Array) -> Array:
        _, w, fd, d1, q1, q2 = x[:rotors].reshape(6, -1)
        d, q = fluxes(x, y)
        Id, Iq = y[2 * n :].reshape(2, -1)
        Efd, rates = controlled(x, y)
        swing = [w0 * w, (torque - (d * Iq - q * Id)) / (2 * H)]
        circuits = [
            w0 * Rfd * (Efd / Lad - (fd - d) / Lfd),
            -w0 * R1d * (d1 - d) / L1d,
            -w0 * R1q * (q1 - q) / L1q,
            -w0 * R2q * (q2 - q) / L2q,
        ]
        return np.concatenate([*swing, *circuits, rates])

    def balance(x: Array, y: Array) -> Array:
        bus, (Id, Iq) = y[:n] + 1j * y[n : 2 * n], y[2 * n :].reshape(2, -1)
        d, q = fluxes(x, y)
        turn = np.exp(1j * (x[: len(at)] - np.pi / 2))
        stator = (-Ra * Id - (q - Xl * Iq)) + 1j * (-Ra * Iq + (d - Xl * Id)) - bus[at] / turn
        missing = Y @ bus
        missing[at] -= ratio * (Id + 1j * Iq) * turn
        for load in system.loads:
            k = index[load.bus]
            r = abs(bus[k]) / abs(flow.voltage[k])
            missing[k] += np.conj(complex(load.P * r, load.Q * r**2) / system.base_power / bus[k])
        return np.concatenate([missing.real, missing.imag, stator.real, stator.imag])

    assert max(np.abs(slopes(x0, y0)).max(), np.abs(balance(x0, y0)).max()) < 1e-8
    fx, fy = jacobian(lambda x: slopes(x, y0), x0), jacobian(lambda y: slopes(x0, y), y0)
    gx, gy = jacobian(lambda x: balance(x, y0), x0), jacobian(lambda y: balance(x0, y), y0)
    return np.asarray(np.linalg.eigvals(fx - fy @ np.linalg.solve(gy, gx)))


def swings(system: System) -> list[complex]:
    """The interarea mode, those local to area 1 and to area 2, with the book's saturation."""
    modes = [complex(value) for value in eigenvalues(system, BOOK) if value.imag > 2 and -value.real < 0.3 * abs(value)]
    return sorted(modes, key=lambda value: value.imag)


def main() -> None:
    """Write the file."""
    rows = [f"{name},{v.real:.6f},{v.imag:.6f}" for name in SYSTEMS for v in swings(load_system(name))]
    FILE.write_text("\n".join(["system,re,im", *rows, ""]), encoding="utf-8")


if __name__ == "__main__":
    main()
