"""Loads that depend on the frequency, against a machine by itself, which can be calculated by hand."""

from __future__ import annotations

import json
import math
from typing import Any

import numpy as np
import pytest

from facts_damping.case.loading import load_case, load_system
from facts_damping.plant.build import build
from facts_damping.simulation import loop
from facts_damping.small_signal.linearisation import linearise
from facts_damping.small_signal.modal_tables import analyse
from tests.plant.island import H, P, V, X, island

OMEGA_0 = 2 * math.pi * 60


@pytest.mark.parametrize(("kpf", "T"), [(1.5, 0.02), (1.5, 0.5), (6.0, 0.1)])
def test_load_is_a_damping_torque(kpf: float, T: float) -> None:
    """Eigenvalues of 2 H domega/dt = -dP, dP = kpf P dw_bus, dw_bus = s theta / (omega_0 (1 + s T)^2).

    theta = delta - phi with P = E^2 sin(2 phi) / (2 X) where the load draws no reactive power: dphi = a dP. So
    2 H s ((1 + s T)^2 + kpf P a s / omega_0) + kpf P = 0, and s = 0, for no angle is a reference. With T = 0 it is
    s = -kpf P / (2 H).
    """
    phi = math.atan(X * P / V**2)  # E leads V: E cos(phi) = V, E sin(phi) = X P / V
    E = V / math.cos(phi)
    a = X / (E**2 * math.cos(2 * phi))
    expected = np.roots([2 * H * T**2, 2 * H * (2 * T + kpf * P * a / OMEGA_0), 2 * H, kpf * P])
    built = build(island(kpf=kpf, T_f=T), [], [])
    values = np.linalg.eigvals(linearise(built)[0])
    assert built.state_names == ["G.delta", "G.omega", "load.theta", "load.theta_w"]
    moving = values[np.abs(values) > 1e-4]
    assert np.sort_complex(moving) == pytest.approx(np.sort_complex(expected), rel=1e-5)
    if T == 0.02:
        slowest = moving[np.argmin(np.abs(moving))]
        assert slowest.real == pytest.approx(-kpf * P / (2 * H), rel=0.01)


def run(events: list[dict[str, Any]], **load: Any) -> Any:
    """The machine by itself for a minute."""
    system = island(**load).model_dump(by_alias=True)
    sets = [f"system={json.dumps(system)}", f"scenario={json.dumps(events)}", "duration=60"]
    return loop.run(load_case(None, [*sets, "devices=[]", "controllers=[]"]))


@pytest.mark.parametrize("change", [0.1, -0.2])
def test_load_step_ends_at_the_frequency_at_which_the_load_draws_what_it_did(change: float) -> None:
    """P (1 + change) (1 + kpf dw) = P."""
    kpf = 3.0
    record = run([{"time": 1.0, "kind": "load_step", "load": "load", "change": change}], kpf=kpf)
    speed = record.machines["speed_deviation"][:, 0]
    assert abs(speed[59]) < 1e-15
    assert speed[-1] == pytest.approx((1 / (1 + change) - 1) / kpf, rel=1e-3)


def test_reactive_power_follows_the_frequency_by_its_own_factor() -> None:
    """With kqf alone and a lossless machine, P and so the speed stay; off the nominal speed Q does what it should."""
    event = {"time": 1.0, "kind": "mechanical_power_step", "machine": "G", "change": 1e-4}
    record = run([event], Q=30.0, Q_fractions={"power": 1.0}, kqf=-2.0)
    speed, drawn = record.machines["speed_deviation"][:, 0], record.frames[:, 0, 4]
    assert speed[-1] == pytest.approx(1e-4 * P * 59 / (2 * H), rel=1e-3)
    assert drawn[-1] == pytest.approx(0.3 * (1 - 2.0 * speed[-1]), rel=1e-6)  # the filter is 40 ms late
    assert drawn[-1] < 0.3 - 1e-4


def test_bolted_fault_at_the_load_is_survived() -> None:
    record = run([{"time": 1.0, "kind": "fault", "bus": "B", "duration": 0.1}], kpf=1.5)
    assert record.in_synchronism.all()
    speed = record.machines["speed_deviation"][:, 0]
    assert speed.max() == pytest.approx(P * 0.1 / (2 * H), rel=0.05)
    assert speed[-1] == pytest.approx(speed.max() * math.exp(-1.5 * P / (2 * H) * 58.9), rel=0.05)


def test_without_it_nothing_is_added() -> None:
    built = build(load_system("two_area"), ["sssc"], [])
    assert len(built.plant.loads) == 0
    assert not any(name.endswith(".theta") for name in built.state_names)


def test_frequency_dependent_load_damps_swings_and_the_common_speed() -> None:
    without = analyse(load_system("two_area"), ["sssc"])
    with_it = analyse(load_system("two_area", ["loads.0.kpf=1.5", "loads.1.kpf=1.5"]), ["sssc"])
    swings = [next(mode for mode in modal.swings if mode.label == "interarea") for modal in (without, with_it)]
    assert swings[1].damping_ratio > swings[0].damping_ratio + 0.002
    assert swings[1].frequency_hz == pytest.approx(swings[0].frequency_hz, rel=0.01)
    slow = [mode.eigenvalue.real for mode in with_it.modes if mode.label == "common"]
    system = load_system("two_area")
    equivalent = -1.5 * sum(x.P for x in system.loads) / (2 * sum(m.H * m.rating for m in system.machines))
    # Impedances draw more as their voltage rises when they draw less: less than the single machine's damping.
    assert min(slow) == pytest.approx(equivalent, rel=0.35)
    assert min(slow) > equivalent
