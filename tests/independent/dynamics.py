"""Differential equations of the independent reference model, one method a block."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg.lapack import dgesv

from .network import (
    BUSES,
    HEALTHY,
    RS,
    S_BASE,
    S_MACHINE,
    W0,
    XS,
    Array,
    Case,
    Complex,
    Config,
    loaded_admittance,
    power_flow,
)

# Machines, p.u. on 900 MVA (docs/plant.md, Kundur example 12.6)
XD, XD1, XD2, XQ, XQ1, XQ2, XL, RA = 1.8, 0.3, 0.25, 1.7, 0.55, 0.25, 0.2, 0.0025
TD01, TD02, TQ01, TQ02 = 8.0, 0.03, 0.4, 0.05
H = np.array([6.5, 6.5, 6.175, 6.175])
# Static exciter (table A.2) and DC exciter (2.24-2.30), see docs/plant.md
KA, TR, EFD_MIN, EFD_MAX = 200.0, 0.02, 0.0, 7.0
DC_KA, DC_TA, DC_TE, DC_KE, DC_KF, DC_TF, DC_TR = 20.0, 0.055, 0.36, 1.0, 0.125, 1.8, 0.05
DC_AEX, DC_BEX = 0.0056, 1.075
# SSSC by docs/plant.md
KP, KI, KD, KDI, IN, TAU, U_MAX, SP_MAX, S_MAX = 0.00375, 0.1875, 0.4, 8.0, 10.0, 0.006, 0.1, 0.1, 0.11
I_BLOCK = 0.02
# LLC (appendix B)
LLC_TW, LLC_T1, LLC_T2, LLC_T3, LLC_T4 = 10.0, 0.0761, 0.3, 0.4272, 0.3
Y_WEIGHTS = np.array([2.0, -1.0, 0.0, -1.0])  # w12 + w34 + w13
W, E = BUSES.index("w"), BUSES.index("e")
N_EXCITER = {"constant": 0, "static": 1, "dc": 4}


def _circuits(X: float, X1: float, X2: float, T1: float, T2: float) -> tuple[float, ...]:
    """Mutual reactance, leakage and resistance of the two rotor circuits of one axis (equal-mutual model).

    X - XL = La,  X1 - XL = La || L1,  X2 - XL = La || L1 || L2,  T1 = (La + L1)/(w0 R1),
    T2 = (L2 + La || L1)/(w0 R2): the circuit to which the standard GENROU equations are equivalent.
    """
    La, a1, a2 = X - XL, X1 - XL, X2 - XL
    L1, L2 = 1.0 / (1.0 / a1 - 1.0 / La), 1.0 / (1.0 / a2 - 1.0 / a1)
    return La, L1, (La + L1) / (W0 * T1), L2, (L2 + a1) / (W0 * T2)


LAD, LF, RF, L1D, R1D = _circuits(XD, XD1, XD2, TD01, TD02)
LAQ, L1Q, R1Q, L2Q, R2Q = _circuits(XQ, XQ1, XQ2, TQ01, TQ02)


def subtransient(machine: str, rotor: Array) -> tuple[Array, Array]:
    """Voltages E''d, E''q [p.u.] from the rotor's four states of shape (4, machines)."""
    if machine == "cascade":
        return rotor[2], rotor[3]
    psi_f, psi_1d, psi_1q, psi_2q = rotor
    Eq2 = (XD2 - XL) * (psi_f / LF + psi_1d / L1D)
    return -(XQ2 - XL) * (psi_1q / L1Q + psi_2q / L2Q), Eq2


def rotor_rates(machine: str, rotor: Array, Efd: Array, Id: Array, Iq: Array) -> Array:
    """Time derivatives of the rotor states [p.u./s].

    ``cascade``: (E'd, E'q, E''d, E''q) by (2.3-2.6) as docs/plant.md corrects them; ``genrou``: flux linkages of
    field, d damper and two q dampers, d(psi)/dt = w0 (e - R i).
    """
    if machine == "cascade":
        Ed1, Eq1, Ed2, Eq2 = rotor
        return np.array(
            [
                ((XQ - XQ1) * Iq - Ed1) / TQ01,
                (Efd - (XD - XD1) * Id - Eq1) / TD01,
                (Ed1 + (XQ1 - XQ2) * Iq - Ed2) / TQ02,
                (Eq1 - Eq2 - (XD1 - XD2) * Id) / TD02,
            ]
        )
    Ed2, Eq2 = subtransient(machine, rotor)
    psi_ad, psi_aq = Eq2 - (XD2 - XL) * Id, -Ed2 - (XQ2 - XL) * Iq
    psi_f, psi_1d, psi_1q, psi_2q = rotor
    return W0 * np.array(
        [
            RF * Efd / LAD - RF * (psi_f - psi_ad) / LF,
            -R1D * (psi_1d - psi_ad) / L1D,
            -R1Q * (psi_1q - psi_aq) / L1Q,
            -R2Q * (psi_2q - psi_aq) / L2Q,
        ]
    )


def rotor_start(machine: str, Efd: Array, Id: Array, Iq: Array) -> Array:
    """Steady rotor states."""
    if machine == "cascade":
        Ed1, Eq1 = (XQ - XQ1) * Iq, Efd - (XD - XD1) * Id
        return np.array([Ed1, Eq1, Ed1 + (XQ1 - XQ2) * Iq, Eq1 - (XD1 - XD2) * Id])
    psi_ad, psi_aq = Efd - LAD * Id, -LAQ * Iq
    return np.array([psi_ad + LF * Efd / LAD, psi_ad, psi_aq, psi_aq])


def sssc_voltage(size: float, u: float, x: Array) -> tuple[float, float, float, Array]:
    """Converter voltages vcp, vcq [p.u.] along and across the current's phasor, d(vcq)/d|I| and state rates.

    ``u`` is the drop's reference (minus the setpoint), ``x`` = (x_ac, x_dc, vdc). The proportional path sees
    the voltage that it makes, vcq = sq vdc: solved exactly,
    sq = (u + x_ac - xs|I| + Kp(u - xs|I|))/(1 + Kp vdc). An integrator is held while its output is limited.
    """
    x_ac, x_dc, vdc = x
    sp_free = min(1.0, IN / size) * (KD * (1.0 - vdc) + x_dc)
    sp = min(max(sp_free, -SP_MAX), SP_MAX)
    limit = np.sqrt(S_MAX**2 - sp**2)
    sq_free = (u + x_ac - XS * size + KP * (u - XS * size)) / (1.0 + KP * vdc)
    sq = min(max(sq_free, -limit), limit)
    slope = -XS * (1.0 + KP) / (1.0 + KP * vdc) * vdc if sq == sq_free else 0.0
    rates = np.array(
        [
            KI * (u - sq * vdc - XS * size) if sq == sq_free else 0.0,
            KDI * (1.0 - vdc) if sp == sp_free else 0.0,
            sp * size / TAU,
        ]
    )
    return sp * vdc, sq * vdc, slope, rates


def sssc_current(v0: complex, Z: Array, u: float, x: Array) -> tuple[complex, Array]:
    """Solve the port equation v0 + Z i = zs i + (vcp + j vcq) i/|i| for the current i by Newton's method.

    ``Z`` is the (2, 2) real response of Vw - Ve to the current. Returns the current and the state rates; when
    there is no solution, or the current is below 0.02 p.u., the converter is blocked: no
    voltage, states held.
    """
    A = Z - np.array([[RS, -XS], [XS, RS]])
    det = A[0, 0] * A[1, 1] - A[0, 1] * A[1, 0]
    base = -complex(A[1, 1] * v0.real - A[0, 1] * v0.imag, A[0, 0] * v0.imag - A[1, 0] * v0.real) / det
    i = base
    for _ in range(30):
        size = abs(i)
        if size < I_BLOCK:
            break
        e = i / size
        p, q, slope, _ = sssc_voltage(size, u, x)
        f = v0 + complex(A[0] @ (i.real, i.imag), A[1] @ (i.real, i.imag)) - complex(p, q) * e
        # d/di of (p + jq) e: radial part through the magnitudes, tangential through the direction. The
        # current rating's effect on p (|I| > 10 p.u.) is left to the iteration.
        radial, turning = 1j * slope * e, complex(p, q) * 1j * e / size
        a, b = radial * e.real - turning * e.imag, radial * e.imag + turning * e.real
        j00, j01, j10, j11 = A[0, 0] - a.real, A[0, 1] - b.real, A[1, 0] - a.imag, A[1, 1] - b.imag
        d = j00 * j11 - j01 * j10
        step = complex(j11 * f.real - j01 * f.imag, j00 * f.imag - j10 * f.real) / d
        i -= step
        if abs(step) < 1e-12 * (1.0 + size):
            return i, sssc_voltage(abs(i), u, x)[3]
    return base, np.zeros(3)


@dataclass(frozen=True)
class Outputs:
    """Algebraic quantities at one instant: V per bus, Id, Iq, Pe per machine (900 MVA), SSSC's current."""

    V: Complex
    Id: Array
    Iq: Array
    Pe: Array
    i_sssc: complex
    sssc_rates: Array


class System:
    """Two-area system: ``x`` = delta, dw, rotor (4 rows), exciter rows, SSSC (x_ac, x_dc, vdc), LLC (3).

    ``llc`` is the gain kG of a continuous lead-lag controller, zero for none (then it has no states).
    """

    def __init__(
        self,
        case: Case,
        machine: str,
        exciter: str,
        *,
        device: bool = False,
        llc: float = 0.0,
    ) -> None:
        """Solve the power flow and the equilibrium."""
        self.machine, self.exciter, self.device, self.llc = machine, exciter, device, llc
        self.case, self.flow = case, power_flow(case, RS if device else case.bypass)
        self._dense: dict[Config, Array] = {}
        V, S = self.flow.V[:4], self.flow.S * S_BASE / S_MACHINE
        current = np.conj(S / V)
        delta = np.angle(V + (RA + 1j * XQ) * current)
        to_dq = np.exp(-1j * (delta - np.pi / 2.0))
        v, i = V * to_dq, current * to_dq
        Efd = v.imag + RA * i.imag + XD * i.real
        self.Pm = (v * np.conj(i)).real + RA * np.abs(i) ** 2
        self.Efd0 = Efd
        rows: list[Array] = []
        if exciter == "static":
            self.Vref, rows = np.abs(V) + Efd / KA, [np.abs(V)]
        elif exciter == "dc":
            VR = DC_KE * Efd + DC_AEX * np.exp(DC_BEX * Efd) * Efd
            self.Vref, rows = np.abs(V) + VR / DC_KA, [np.abs(V), VR, -DC_KF / DC_TF * Efd, Efd]
        rotor = rotor_start(machine, Efd, i.real, i.imag)
        parts = [delta, np.zeros(4), rotor.ravel(), *rows]
        parts += [np.array([0.0, 0.0, 1.0])] if device else []
        parts += [np.zeros(3)] if llc else []
        self.x0: Array = np.concatenate(parts)
        self.i_sssc = 24 + 4 * N_EXCITER[exciter]
        self.i_llc = self.i_sssc + (3 if device else 0)

    def _constant_part(self, config: Config) -> Array:
        """Dense system in (Re V, Im V, Id, Iq) without rotor angles: Kirchhoff's laws, then the stators."""
        if config not in self._dense:
            Y = loaded_admittance(self.case, config, self.flow, 0.0 if self.device else self.case.bypass)
            n, k = len(Y), np.arange(4)
            M = np.zeros((2 * n + 8, 2 * n + 8))
            M[: 2 * n, : 2 * n] = np.block([[Y.real, -Y.imag], [Y.imag, Y.real]])
            M[2 * n + k, 2 * n + k], M[2 * n + k, 2 * n + 4 + k] = RA, -XQ2
            M[2 * n + 4 + k, 2 * n + k], M[2 * n + 4 + k, 2 * n + 4 + k] = XD2, RA
            self._dense[config] = M
        return self._dense[config]

    def solve(self, x: Array, u: float, config: Config) -> Outputs:
        """Stator, network and SSSC together; ``u`` is the SSSC's setpoint v_q (capacitive positive)."""
        M = self._constant_part(config).copy()
        size = len(M)
        n, k = (size - 8) // 2, np.arange(4)
        s, c = np.sin(x[:4]), np.cos(x[:4])
        scale = S_MACHINE / S_BASE
        # vd + j vq = V exp(-j(delta - pi/2)); the current goes back with the inverse rotation
        M[k, 2 * n + k], M[k, 2 * n + 4 + k] = -scale * s, -scale * c
        M[n + k, 2 * n + k], M[n + k, 2 * n + 4 + k] = scale * c, -scale * s
        M[2 * n + k, k], M[2 * n + k, n + k] = s, -c
        M[2 * n + 4 + k, k], M[2 * n + 4 + k, n + k] = c, s
        Ed2, Eq2 = subtransient(self.machine, x[8:24].reshape(4, 4))
        rhs = np.zeros((size, 3 if self.device else 1))
        rhs[2 * n : 2 * n + 4, 0], rhs[2 * n + 4 :, 0] = Ed2, Eq2
        if self.device:
            rhs[W, 1] = rhs[n + W, 2] = -1.0
            rhs[E, 1] = rhs[n + E, 2] = 1.0
        row = config.fault_row
        if row is not None and not config.fault_z:
            M[[row, n + row]] = 0.0
            M[row, row] = M[n + row, n + row] = 1.0
            rhs[[row, n + row]] = 0.0
        z = dgesv(M, rhs, overwrite_a=1, overwrite_b=1)[2]
        i_sssc, rates, y = 0.0j, np.zeros(3), z[:, 0]
        if self.device:
            port = np.array([z[W] - z[E], z[n + W] - z[n + E]])
            state = x[self.i_sssc : self.i_sssc + 3]
            i_sssc, rates = sssc_current(complex(port[0, 0], port[1, 0]), port[:, 1:], -u, state)
            y = z @ (1.0, i_sssc.real, i_sssc.imag)
        Id, Iq = y[2 * n : 2 * n + 4], y[2 * n + 4 :]
        Pe = Ed2 * Id + Eq2 * Iq + (XQ2 - XD2) * Id * Iq
        return Outputs(y[:n] + 1j * y[n : 2 * n], Id, Iq, Pe, i_sssc, rates)

    def lead_lag(self, x: Array) -> tuple[float, Array]:
        """Output and state rates of kG s Tw/(1 + s Tw) (1 + s T1)/(1 + s T2) (1 + s T3)/(1 + s T4)."""
        xw, x1, x2 = x[self.i_llc :]
        o1 = self.llc * (Y_WEIGHTS @ x[4:8]) - xw
        o2 = x1 + LLC_T1 / LLC_T2 * (o1 - x1)
        rates = np.array([o1 / LLC_TW, (o1 - x1) / LLC_T2, (o2 - x2) / LLC_T4])
        return float(x2 + LLC_T3 / LLC_T4 * (o2 - x2)), rates

    def setpoint(self, x: Array, u: float) -> float:
        """SSSC's setpoint [p.u.]: ``u`` plus the continuous LLC, within +-0.1 p.u."""
        total = u + (self.lead_lag(x)[0] if self.llc else 0.0)
        return min(max(total, -U_MAX), U_MAX)

    def rhs(self, t: float, x: Array, u: float = 0.0, config: Config = HEALTHY) -> Array:
        """Time derivative of the state; ``u`` [p.u.] is the ramped setpoint v_q of the SSSC."""
        out = self.solve(x, self.setpoint(x, u), config)
        dx = np.empty_like(x)
        dx[:4] = W0 * x[4:8]
        dx[4:8] = (self.Pm * np.array(config.Pm_factor) - out.Pe) / (2.0 * H)
        Efd, V = self.Efd0, np.abs(out.V[:4])
        exciter = x[24 : self.i_sssc].reshape(-1, 4)
        if self.exciter == "static":
            Efd = np.clip(KA * (self.Vref - exciter[0]), EFD_MIN, EFD_MAX)
            dx[24:28] = (V - exciter[0]) / TR
        elif self.exciter == "dc":
            Va, VR, VC, Efd = exciter
            dx[24:40] = np.concatenate(
                [
                    (V - Va) / DC_TR,
                    (DC_KA * (self.Vref - Va - DC_KF / DC_TF * Efd - VC) - VR) / DC_TA,
                    (-DC_KF / DC_TF * Efd - VC) / DC_TF,
                    (VR - DC_KE * Efd - DC_AEX * np.exp(DC_BEX * Efd) * Efd) / DC_TE,
                ]
            )
        dx[8:24] = rotor_rates(self.machine, x[8:24].reshape(4, 4), Efd, out.Id, out.Iq).ravel()
        if self.device:
            dx[self.i_sssc : self.i_sssc + 3] = out.sssc_rates
        if self.llc:
            dx[self.i_llc :] = self.lead_lag(x)[1]
        return dx
