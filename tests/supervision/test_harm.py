"""What the monitor `harm` says beside what the linearised closed loop says, which is derived by other means."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from facts_damping.case.loading import load_case
from facts_damping.monitor_table import MONITORS, STATES
from facts_damping.simulation import loop
from facts_damping.simulation.assembly import plant_residues
from facts_damping_studies.margins.linear_closed_loop import delayed_loop, link_delays, sampled

HARM = list(MONITORS).index("harm")
SYSTEMS = {"two_area": ["scenario=small"], "smib": ["system=smib", "scenario=nominal"]}
SMALL = 1e-2  # gain, p.u./p.u., at which the change of an eigenvalue is linear
SETTLED_S = 5.0  # the phasors, after an event at 1 s


def links(up: float, down: float) -> list[str]:
    return [f"link.up.0.delay={up}", f"link.down.0.delay={down}"]


@cache
def change(system: str, up: float, down: float) -> complex:
    """How the mode's eigenvalue changes by the gain of a lead-lag controller, 1/s: the loop from frame to frame."""
    eigenvalues = []
    for gain in (0.0, SMALL):
        case = load_case(None, [*SYSTEMS[system], *links(up, down), f"controllers.0.parameters.gain={max(gain, 1e-6)}"])
        known = plant_residues(case)
        assert known is not None
        z = np.linalg.eigvals(sampled(delayed_loop(case), min(link_delays(case)))).astype(complex)
        values = np.log(z[np.abs(z) > 1e-6]) * case.run.frame_rate
        eigenvalues.append(complex(values[np.argmin(np.abs(values - known.eigenvalue))]))
    return (eigenvalues[1] - eigenvalues[0]) / (SMALL - 1e-6)


@cache
def seen(system: str, gain: float, up: float, down: float) -> float:
    """What the monitor sees, on average, of a controller that does not act."""
    sets = [*SYSTEMS[system], *links(up, down), f"controllers.0.parameters.gain={gain}"]
    record = loop.run(load_case(None, ["supervision=standard", "duration=9", *sets]))
    return float(np.mean(record.supervision["values"][record.time_s > SETTLED_S, HARM]))


@pytest.mark.parametrize("system", SYSTEMS)
@pytest.mark.parametrize(
    ("gain", "delays"),
    [(8.0, (0.0, 0.0)), (-8.0, (0.1, 0.0)), (8.0, (0.0, 0.1)), (15.0, (0.15, 0.15)), (8.0, (0.2, 0.25))],
    ids=str,
)
def test_harm_is_what_the_controller_adds_to_the_growth_of_the_mode(
    system: str, gain: float, delays: tuple[float, float]
) -> None:
    """Within a tenth of the eigenvalue's change: half a frame of hold, other modes, phasors of a mode that decays."""
    of_loop = gain * change(system, *delays)
    assert abs(of_loop) > 0.1  # 1/s
    assert seen(system, gain, *delays) == pytest.approx(of_loop.real, abs=0.1 * abs(of_loop))


def test_delay_alone_turns_help_into_harm() -> None:
    """The same controller, trusted with 0 ms, takes damping away with 300 ms."""
    assert seen("two_area", 8.0, 0.0, 0.0) < -0.1
    assert seen("two_area", 8.0, 0.2, 0.25) > 0.03


def test_controller_that_harms_in_shadow_is_not_armed() -> None:
    for gain, state in ((15.0, "armed"), (-15.0, "shadow")):
        sets = ["supervision=standard", "arm_at=6", "duration=6.1", f"controllers.0.parameters.gain={gain}"]
        report = loop.run(load_case(None, sets)).supervision[-1]
        assert (STATES[report["state"]], int(report["refused"])) == (state, -1 if gain > 0.0 else HARM)
