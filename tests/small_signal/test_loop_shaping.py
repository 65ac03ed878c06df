"""H-infinity loop shaping: beside python-control, its margin, and what it tolerates in the whole plant."""

from __future__ import annotations

from typing import TYPE_CHECKING

import control
import numpy as np
import pytest

from facts_damping.case.loading import load_case
from facts_damping.cli.main import main
from facts_damping.simulation.assembly import plant_residues
from facts_damping.small_signal import loop_shaping

if TYPE_CHECKING:
    from facts_damping.control.linear_law import Matrices

BOTH = ["devices=[sssc, statcom]", "controllers.0.devices=[sssc, statcom]", "controllers.0.signals=[speed, power]"]
HINF = "controllers.0.name=Hinf"


def shaped(sets: list[str], gain: list[float], delay: float) -> Matrices:
    """The shaped plant of a case."""
    case = load_case(None, [HINF, *sets])
    plant = plant_residues(case)
    assert plant is not None
    mode = loop_shaping.least_damped(plant, case.system, case.controllers[0])
    weights = loop_shaping.washouts(np.array(gain), np.full(len(gain), 10.0))
    return loop_shaping.series(weights, loop_shaping.series(loop_shaping.pade(delay, len(gain)), mode))


@pytest.mark.parametrize(("sets", "gain"), [([], [12.0]), (BOTH, [12.0, 3.0])], ids=["one", "both"])
def test_riccati_and_gamma_are_those_of_python_control(sets: list[str], gain: list[float]) -> None:
    weighed = shaped(sets, gain, 0.1)
    plant = control.ss(*weighed)
    for A, B, C in ((weighed.A, weighed.B, weighed.C), (weighed.A.T, weighed.C.T, weighed.B.T)):
        known, _, _ = control.care(A, B, C.T @ C)
        np.testing.assert_allclose(loop_shaping.continuous_riccati(A, B, C), known, rtol=1e-7, atol=1e-7 * known.max())
    law, gamma = loop_shaping.tolerant(weighed, 1.2)
    X, Z = (
        loop_shaping.continuous_riccati(*weighed[:3]),
        loop_shaping.continuous_riccati(weighed.A.T, weighed.C.T, weighed.B.T),
    )
    assert gamma == pytest.approx(1.2 * np.sqrt(1.0 + np.linalg.eigvals(X @ Z).real.max()))
    closed = control.feedback(plant, control.ss(*law), sign=1)
    assert closed.poles().real.max() < 0.0


def test_norm_that_it_promises_holds() -> None:
    """||[K; 1] (1 - G K)^-1 [G, 1]|| is at most gamma: what a coprime factor may be wrong by is 1 / gamma."""
    weighed = shaped([], [12.0], 0.1)
    law, gamma = loop_shaping.tolerant(weighed, 1.2)
    G, K = control.ss(*weighed), control.ss(*law)
    worst = 0.0
    for w in np.geomspace(1e-3, 1e3, 2000):
        g, k = G(1j * w), K(1j * w)
        g, k = complex(np.squeeze(g)), complex(np.squeeze(k))
        whole = np.array([[k], [1.0]]) / (1.0 - g * k) @ np.array([[g, 1.0]])
        worst = max(worst, float(np.linalg.norm(whole, 2)))
    assert 0.9 * gamma < worst <= gamma * (1.0 + 1e-6)


def test_mode_is_that_of_the_plant() -> None:
    """Residues at its eigenvalue, once delays are put back in."""
    case = load_case(None, [HINF, *BOTH, "system.devices.0.dead_time=0.05"])
    plant = plant_residues(case)
    assert plant is not None
    mode = loop_shaping.least_damped(plant, case.system, case.controllers[0])
    values, right = np.linalg.eig(mode.A)
    k = int(np.argmax(values.imag))
    assert values[k] == pytest.approx(plant.eigenvalue)
    residue = np.outer(mode.C @ right[:, k], np.linalg.inv(right)[k] @ mode.B)
    rows = [plant.signals.index(name) for name in ("speed", "power")]
    late = np.exp(-plant.eigenvalue * np.array([0.05, 0.0]))
    np.testing.assert_allclose(residue * late, plant.residue[rows], rtol=1e-9)


@pytest.mark.parametrize("link", ["ideal", "delay_100ms", "pdci"])
def test_hinf_controller_damps_behind_a_known_delay(link: str, capsys: pytest.CaptureFixture[str]) -> None:
    sets = ["--set", HINF, "--set", "controllers.0.parameters.gain=12", "--set", f"link={link}"]
    assert main(["simulate", "two_area_large", *sets]) == 0
    assert "damped" in capsys.readouterr().out
