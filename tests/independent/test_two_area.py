"""The independent reference model against published figures and ANDES."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import root

from .dynamics import LLC_T1, LLC_T2, LLC_T3, LLC_T4, LLC_TW, Y_WEIGHTS, sssc_current, sssc_voltage
from .network import RS, XS, Config
from .two_area import (
    HEALTHY,
    KUNDUR_12_6,
    TWO_AREA,
    System,
    build,
    bus_fault,
    large,
    linearise,
    modes,
    multiple,
    power_flow,
    radau,
    ramp,
)

ANDES = Path(__file__).parents[2] / "config" / "references"
INSTANTS = (0.99, 1.1, 1.3, 1.6, 2.0, 3.0, 5.0, 8.0, 12.0, 16.0, 20.0)


def andes_fault() -> np.ndarray:
    """Rows of ANDES nearest to some instants: t, w1 to w4 (p.u.), d1 to d4 (rad)."""
    rows = np.loadtxt(ANDES / "kundur_12_6_bus8_fault_andes.csv", delimiter=",", skiprows=1)
    return rows[[np.abs(rows[:, 0] - t).argmin() for t in INSTANTS]]


@pytest.fixture(scope="module")
def thesis() -> System:
    """Return two_area with the SSSC."""
    return build(TWO_AREA, device=True)


@pytest.fixture(scope="module")
def kundur() -> System:
    """Return kundur_12_6 with constant field voltage."""
    return build(KUNDUR_12_6)


def test_power_flow_gives_the_four_digits_of_the_thesis() -> None:
    """A solid middle bus, magnetising branches at the machines and impedance loads give every digit."""
    flow = power_flow(TWO_AREA, 1e-9)
    assert flow.residual < 1e-9
    printed = [0.7778 + 0.1021j, 0.7777 + 0.1307j, 0.7989 + 0.0914j, 0.7778 + 0.0919j]
    np.testing.assert_array_equal(np.round(flow.S / 9.0, 4), printed)
    np.testing.assert_array_equal(np.round(np.abs(flow.V[[6, 9]]), 4), [0.9916, 1.0028])


def test_the_resistance_of_the_sssc_moves_the_power_flow_in_the_fourth_digit(thesis: System) -> None:
    """With rs in the tie the powers are within 1.5e-4 of the thesis's."""
    printed = [0.7778 + 0.1021j, 0.7777 + 0.1307j, 0.7989 + 0.0914j, 0.7778 + 0.0919j]
    assert np.abs(thesis.flow.S / 9.0 - printed).max() < 1.5e-4
    assert thesis.flow.residual < 1e-9


def test_power_flow_of_kundur_12_6(kundur: System) -> None:
    """Published voltages and reactive powers (docs/validation.md), a unit in the last place allowed."""
    V = np.abs(kundur.flow.V)[[4, 5, 6, 7, 9, 10, 11]]
    np.testing.assert_allclose(V, [1.0065, 0.9781, 0.9610, 0.9486, 0.9714, 0.9835, 1.0083], atol=6e-5)
    np.testing.assert_allclose(kundur.flow.S.imag * 100.0, [185, 235, 176, 202], atol=0.6)
    assert kundur.flow.residual < 1e-9


@pytest.mark.parametrize("exciter", ["constant", "static", "dc"])
@pytest.mark.parametrize("machine", ["cascade", "genrou"])
@pytest.mark.parametrize("device", [False, True])
def test_start_is_an_equilibrium(machine: str, exciter: str, *, device: bool) -> None:
    """The right-hand side is zero at the start for every combination."""
    system = System(TWO_AREA, machine, exciter, device=device, llc=10.0 if device else 0.0)
    assert np.abs(system.rhs(0.0, system.x0)).max() < 1e-9


def test_kundur_eigenvalues_are_those_of_andes(kundur: System) -> None:
    """All but the three that hang on the reference angle and the load's drift, to 5e-5."""
    rows = np.loadtxt(ANDES / "kundur_12_6_eigenvalues_andes.csv", delimiter=",", skiprows=1)
    theirs = rows @ [1.0, 1.0j]
    theirs = theirs[(np.abs(theirs) > 0.1) & (theirs.imag >= 0.0)]
    assert len(theirs) == 18
    found = np.linalg.eigvals(linearise(kundur)[0])
    assert np.abs(found[:, None] - theirs).min(axis=0).max() < 5e-5


def test_kundur_bus_8_fault_is_that_of_andes(kundur: System) -> None:
    """Angles within 0.01 degree and speeds within 0.1 % of the peak over 20 s."""
    theirs = andes_fault()
    run = radau(kundur, bus_fault("w"), [], 20.0, theirs[:, 0], 1e-8, method="LSODA")
    angles = run.x[:, :4] - run.x[:, 2:3]
    np.testing.assert_allclose(np.rad2deg(angles - theirs[:, 5:] + theirs[:, 7:8]), 0.0, atol=0.01)
    np.testing.assert_allclose(run.speeds, theirs[:, 1:5] - 1.0, atol=0.001 * 6.4e-3)


def test_modes_of_the_thesis_system(thesis: System) -> None:
    """Interarea and local modes and the residue angle (docs/validation.md)."""
    interarea, local1, local2 = modes(thesis)[:3]
    assert interarea.hertz == pytest.approx(0.630, abs=5e-4)
    assert interarea.damping == pytest.approx(-0.0139, abs=1.5e-4)
    assert (local1.hertz, local2.hertz) == pytest.approx((1.121, 1.157), abs=1e-3)
    assert np.rad2deg(np.angle(interarea.residue)) == pytest.approx(177.0, abs=1.0)


def test_modes_with_the_standard_machine() -> None:
    """Genrou in two_area: the model that reproduces ANDES's eigenvalues above.

    Converters.md has 0.6235 Hz and local modes at 1.049 and 1.085 Hz (0.13). Exactly these come out when the
    subtransient term of dE'd/dt (Xq1 - Xq2)/(Xq1 - Xl)^2 (psi2q + (Xq1 - Xl) Iq + E'd) has its sign reversed.
    """
    system = System(TWO_AREA, "genrou", "static", device=True)
    interarea, local1, local2 = (m for m in modes(system) if m.damping < 0.3)
    assert (interarea.hertz, interarea.damping) == pytest.approx((0.6320, -0.0158), abs=1e-4)
    assert (local1.hertz, local1.damping) == pytest.approx((1.1435, 0.0743), abs=1e-4)
    assert (local2.hertz, local2.damping) == pytest.approx((1.1779, 0.0704), abs=1e-4)


def delayed_mode(system: System, weights: np.ndarray, delay: float, guess: complex) -> complex:
    """Root s of 1 = K(s) exp(-s delay) weights (s - A)^-1 b near ``guess``, kG = 10."""
    A, b = linearise(system)

    def characteristic(v: np.ndarray) -> tuple[float, float]:
        s = complex(*v)
        lead = (1 + s * LLC_T1) / (1 + s * LLC_T2) * (1 + s * LLC_T3) / (1 + s * LLC_T4)
        K = 10.0 * s * LLC_TW / (1 + s * LLC_TW) * lead * np.exp(-s * delay)
        value = 1.0 - K * (weights @ np.linalg.solve(s * np.eye(len(b)) - A, b)[4:8])
        return value.real, value.imag

    return complex(*root(characteristic, [guess.real, guess.imag], tol=1e-12).x)


@pytest.mark.parametrize(
    ("weights", "delay", "damping"),
    [
        ((1, 0, -1, 0), 0.0, 0.036),
        ((1, 0, -1, 0), 0.1, 0.022),
        ((1, 0, -1, 0), 0.2, 0.002),
        (tuple(Y_WEIGHTS), 0.0, 0.038),
        (tuple(Y_WEIGHTS), 0.1, 0.019),
        (tuple(Y_WEIGHTS), 0.2, -0.005),
        (tuple(Y_WEIGHTS), 0.177, 0.0),
    ],
)
def test_damping_with_lead_lag_and_delay(
    thesis: System, weights: tuple[float, ...], delay: float, damping: float
) -> None:
    """Damping and delay margin of the linear loop as computed by an earlier, separate program, to three decimals."""
    s = delayed_mode(thesis, np.array(weights, dtype=float), delay, -0.08 + 4.13j)
    assert s.imag == pytest.approx(4.1, abs=0.1)
    assert -s.real / abs(s) == pytest.approx(damping, abs=1e-3)


def test_lead_lag_states_give_the_same_mode(thesis: System) -> None:
    """The controller integrated with the system has the root of the transfer function."""
    mode = modes(build(TWO_AREA, device=True, llc=10.0))[0]
    assert mode.eigenvalue == pytest.approx(delayed_mode(thesis, Y_WEIGHTS, 0.0, -0.15 + 4.09j), abs=1e-4)


def test_newton_agrees_with_the_closed_form(thesis: System) -> None:
    """|I| = sqrt(|I0|^2 - Im(a)^2) - Re(a), arg(I0) - arg(|I| + a): docs/plant.md."""
    rng, compared = np.random.default_rng(1), 0
    for _ in range(50):
        v0, u = complex(*rng.normal(size=2)) * 0.4, rng.uniform(-0.1, 0.1)
        x, Zth = (
            np.array([rng.uniform(-0.01, 0.01), rng.uniform(-0.02, 0.02), rng.uniform(0.9, 1.1)]),
            0.01 + 0.07j,
        )
        i, _ = sssc_current(v0, -np.array([[Zth.real, -Zth.imag], [Zth.imag, Zth.real]]), u, x)
        Y = 1.0 / (Zth + RS + 1j * XS)
        p, q, _, _ = sssc_voltage(abs(i), u, x)
        a, I0 = Y * complex(p, q), Y * v0
        if abs(a.imag) < 0.9 * abs(I0) and i != I0:
            compared += 1
            size = np.sqrt(abs(I0) ** 2 - a.imag**2) - a.real
            assert i == pytest.approx(size * np.exp(1j * (np.angle(I0) - np.angle(size + a))), abs=1e-9)
    assert compared > 40
    assert abs(thesis.solve(thesis.x0, 0.0, HEALTHY).i_sssc) == pytest.approx(4.15, abs=0.005)


def test_bolted_fault_is_the_limit_of_a_small_impedance(thesis: System) -> None:
    """The row V = 0 against a fault of 1e-9 p.u."""
    faults = [Config(fault=("4", 0.9), fault_z=z) for z in (0.0j, 1e-9 + 0.0j)]
    exact, near = (thesis.solve(thesis.x0, 0.02, fault) for fault in faults)
    assert abs(exact.V[-1]) < 1e-12
    np.testing.assert_allclose(near.V, exact.V, atol=1e-6)


def test_losses_of_synchronism(thesis: System) -> None:
    """Without damping large and multiple lose synchronism; LLC holds large, which is the harder one."""
    t = np.arange(0.0, 20.0, 0.01)
    for events, lost in ((large(), 16.17), (multiple(), 15.28)):
        end = lost + 0.05
        free = radau(thesis, events, [], end, t[t <= end], 1e-7, method="LSODA")
        assert free.lost_at() == pytest.approx(lost, abs=0.02)
    controlled = build(TWO_AREA, device=True, llc=10.0)
    assert radau(controlled, large(), [], 20.0, t, 1e-7, method="LSODA").lost_at() == np.inf


def test_ramp_has_the_rate_limit_and_the_clip() -> None:
    """A target is reached at 5 p.u./s, or left unfinished at the next one; targets are within +-0.1."""
    t, u = ramp([(0.0, 0.0), (1.0, 0.3), (1.01, -0.1)], 2.0)
    np.testing.assert_allclose(
        np.interp([0.99, 1.004, 1.01, 1.03, 1.04, 2.0], t, u), [0, 0.02, 0.05, -0.05, -0.1, -0.1]
    )


def test_radau_and_lsoda_agree_on_the_large_disturbance(thesis: System) -> None:
    """Two integrators, with a moving setpoint over the fault."""
    setpoint, t = [(0.5, 0.05), (1.05, -0.08), (1.3, 0.1)], np.linspace(0.0, 1.6, 33)
    runs = [radau(thesis, large(), setpoint, 1.6, t, method=method).x for method in ("Radau", "LSODA")]
    np.testing.assert_allclose(runs[0], runs[1], atol=1e-7)
