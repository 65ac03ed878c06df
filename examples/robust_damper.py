"""A robust damping controller by python-control: H-infinity loop shaping of the linearised two-area system.

    facts-damping modes two_area --devices sssc --linear plant.npz
    python examples/robust_damper.py plant.npz damper.npz

Glover and McFarlane's controller tolerates every error of the plant's normalised coprime factors below 1 / gamma
(S. Skogestad, I. Postlethwaite, Multivariable Feedback Control, 2nd ed. 2005, 9.4). The plant is reduced to its
interarea mode; the delay that the loop has anyway is a Pade term of the shaped plant.
"""

import sys

import control
import numpy as np

SIGNAL, DEVICE = "speed", "sssc"
DELAY = 0.1  # s, of the link and of the hold
GAIN = 12.0  # of the shaped plant: more damps more and tolerates less


def interarea(plant: control.StateSpace) -> control.StateSpace:
    """The plant's least damped electromechanical mode alone, in two states."""
    values, right = np.linalg.eig(plant.A)
    swings = np.flatnonzero((values.imag > 1.0) & (values.imag < 10.0))
    k = swings[np.argmax(values[swings].real / np.abs(values[swings]))]
    b, c = np.linalg.solve(right, plant.B)[k], plant.C @ right[:, k]
    s, w = values[k].real, values[k].imag
    residue = (c * b).item()  # of 1 / (s - lambda)
    return control.ss([[s, w], [-w, s]], [[1.0], [0.0]], [[2.0 * residue.real, 2.0 * residue.imag]], 0.0)


def loop_shaping(shaped: control.StateSpace, above: float = 1.2) -> tuple[control.StateSpace, float]:
    """The controller with `above` times the least gamma, for u = K y, and that gamma; the plant has D = 0."""
    A, B, C = shaped.A, shaped.B, shaped.C
    X, _, _ = control.care(A, B, C.T @ C)
    Z, _, _ = control.care(A.T, C.T, B @ B.T)
    gamma = above * np.sqrt(1.0 + np.max(np.linalg.eigvals(X @ Z).real))
    n = len(A)
    L = (1.0 - gamma**2) * np.eye(n) + X @ Z
    H = gamma**2 * np.linalg.solve(L.T, Z @ C.T)
    return control.ss(A - B @ B.T @ X + H @ C, H, B.T @ X, 0.0), gamma


def main(source: str, target: str) -> None:
    """Design a controller on a plant's file, and write its matrices."""
    with np.load(source) as file:
        signals, devices = file["signals"].tolist(), file["devices"].tolist()
        row, column = signals.index(SIGNAL), devices.index(DEVICE)
        plant = control.ss(file["A"], file["B"][:, [column]], file["C"][[row]], file["D"][[row]][:, [column]])
    pade = control.ss(control.tf(*control.pade(DELAY, 2)))
    washout = control.ss(control.tf([10.0, 0.0], [10.0, 1.0]))  # a setpoint of 0 at rest
    weight = GAIN * washout
    K, gamma = loop_shaping(interarea(plant) * pade * weight)
    law = weight * K
    np.savez(target, A=law.A, B=law.B, C=law.C, D=law.D)
    print(f"gamma {gamma:.2f}, a controller of {law.nstates} states, poles up to {law.poles().real.max():.3f} 1/s")


if __name__ == "__main__":
    main(*sys.argv[1:])
