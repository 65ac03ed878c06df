"""Random noise of loads: its statistics, and that it is a function of time and of the seed alone."""

from __future__ import annotations

import json
import math
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from facts_damping.case.loading import load_case
from facts_damping.errors import InputError
from facts_damping.nodes.live_plant import LivePlant
from facts_damping.parameters.plant.grid import Load
from facts_damping.parameters.plant.load_noise import LoadNoise
from facts_damping.plant.integration import advance
from facts_damping.plant.load_noise import RATE, draw
from facts_damping.plant.measurement import measure
from facts_damping.plant.model import workspace
from facts_damping.signals import CHANNELS, DEVICE_TRUTH, MACHINE_TRUTH, SETPOINT
from facts_damping.simulation import loop
from facts_damping.simulation.assembly import build_plant
from tests.plant.island import P, island

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from facts_damping.case.model import Case

MANY = [Load(name=f"load_{i}", bus="B", P=100.0) for i in range(200)]


def many(duration: float = 20.0, seed: int = 1, **noise: Any) -> NDArray[np.float64]:
    """Noise of many loads, (loads, points, 2)."""
    return np.array(list(draw(LoadNoise(**noise), MANY, duration, seed).values()))


@pytest.mark.parametrize("T", [0.2, 2.0])
def test_load_noise_is_an_ornstein_uhlenbeck_process(T: float) -> None:
    """Variance s^2 (1 - exp(-2 t / T)) from a start at 0; correlation exp(-lag / T); 400 processes: within 5 sigma."""
    x = many(std=0.03, time_constant=T)
    x = np.concatenate([x[..., 0], x[..., 1]])
    t = np.arange(x.shape[1]) / RATE
    assert (x[:, 0] == 0.0).all()
    sure = 5 / math.sqrt(2 * len(x))
    for k in (int(0.3 * T * RATE), int(3 * T * RATE), x.shape[1] - 1):
        assert x[:, k].std() == pytest.approx(0.03 * math.sqrt(1 - math.exp(-2 * t[k] / T)), rel=sure)
    assert np.abs(x[:, -1].mean()) < 5 * 0.03 / math.sqrt(len(x))
    lag = int(T * RATE / 2)
    assert np.corrcoef(x[:, -1], x[:, -1 - lag])[0, 1] == pytest.approx(math.exp(-lag / RATE / T), abs=0.2)


@pytest.mark.parametrize("correlation", [-0.5, 0.0, 1.0])
def test_p_and_q_go_together_as_far_as_asked_and_loads_do_not(correlation: float) -> None:
    x = many(correlation=correlation, time_constant=0.05)[:, 60:]
    coefficient = np.corrcoef(x[..., 0].ravel(), x[..., 1].ravel())[0, 1]
    assert coefficient == pytest.approx(correlation, abs=0.01)
    assert np.abs(np.corrcoef(x[:50, :, 0]) - np.eye(50)).max() < 0.25


def test_load_has_a_stream_of_its_own() -> None:
    whole = draw(LoadNoise(), MANY, 2.0, 7)
    other = draw(LoadNoise(loads={"load_1": {"std": 0.0}, "load_2": {"std": 0.05}}), MANY, 1.0, 7)  # type: ignore[dict-item]
    assert "load_1" not in other
    assert np.array_equal(other["load_0"], whole["load_0"][: RATE + 1])
    assert other["load_2"] == pytest.approx(5 * whole["load_2"][: RATE + 1])
    assert not np.allclose(draw(LoadNoise(), MANY, 2.0, 8)["load_0"], whole["load_0"])


def case(*sets: str, **load: Any) -> Case:
    """The machine by itself, whose load is noisy, without an event."""
    system = island(**load).model_dump(by_alias=True)
    common = [f"system={json.dumps(system)}", "scenario=[]", "devices=[]", "controllers=[]", "duration=2", "seed=3"]
    return load_case(None, [*common, "load_noise={std: 0.05, time_constant: 0.5}", *sets])


@pytest.mark.parametrize("rate", [60, 50, 7])
def test_machine_gives_what_the_load_draws(rate: int) -> None:
    """P (1 + noise) at every frame, the noise between its points along a line."""
    asked = case(f"frame_rate={rate}")
    drawn = draw(asked.run.load_noise, asked.system.loads, 2.0, 3)["load"]
    record = loop.run(asked)
    expected = P * (1 + np.interp(record.time_s, np.arange(len(drawn)) / RATE, drawn[:, 0]))
    assert record.machines["electrical_power"][:, 0] == pytest.approx(expected, rel=1e-7)  # points are rounded to ns
    assert np.ptp(expected) > 0.05


def test_impedance_is_scaled_as_a_whole() -> None:
    """P + j Q over |V|^2, at 60 Hz as the frames have it; V0 is 1 p.u."""
    asked = case(P_fractions={"impedance": 1.0}, Q=20.0)
    drawn = draw(asked.run.load_noise, asked.system.loads, 2.0, 3)["load"][::2]
    frame = loop.run(asked).frames[:, 0]
    for channel, power, column in ((3, P, 0), (4, 0.2, 1)):
        assert frame[:, channel] / frame[:, 0] ** 2 == pytest.approx(power * (1 + drawn[:-1, column]), rel=1e-9)


def test_noisy_load_gives_the_same_however_time_is_divided() -> None:
    built, other = build_plant(case()), build_plant(case())
    work, none = workspace(built.plant, built.state), np.zeros(0, SETPOINT)
    ends = [int(1e9 * t) for t in (0.0, 0.013, 0.0171, 0.5, 0.50001, 1.0)]
    for start, end in pairwise(ends):
        advance(built.plant, built.state, start, end, none, 0, work)
    advance(other.plant, other.state, 0, ends[-1], none, 0, work)
    assert abs(built.state.x[1]) > 1e-4
    assert built.state.x == pytest.approx(other.state.x, rel=1e-7)


def test_after_its_end_it_runs_backwards() -> None:
    built = build_plant(case("duration=1"))
    work, machines = workspace(built.plant, built.state), np.zeros(1, MACHINE_TRUTH)

    def power(t: float) -> float:
        frame = np.zeros((1, len(CHANNELS)))
        measure(built.plant, built.state, int(t * 1e9), frame, machines, np.zeros(0, DEVICE_TRUTH), work)
        return float(machines["electrical_power"][0])

    assert power(1.25) == pytest.approx(power(0.75), rel=1e-9)
    assert power(2.3) == pytest.approx(power(0.3), rel=1e-9)
    assert power(0.75) != pytest.approx(power(0.3), rel=1e-3)


NOISY = ["scenario=small", "duration=1.5", "load_noise.std=0.02"]


def test_runs_that_share_a_plant_have_the_bits_of_each_seed() -> None:
    frames, other, again = (loop.run(load_case(None, [*NOISY, f"seed={seed}"])).frames for seed in (0, 1, 0))
    assert np.array_equal(frames, again, equal_nan=True)
    assert not np.array_equal(frames, other, equal_nan=True)


def test_plant_of_a_node_has_the_same_bits() -> None:
    asked = load_case(None, [*NOISY, "controllers=[]"])
    plant, frames = LivePlant(asked), []
    for tick in range(asked.ticks):
        plant.measure(tick)
        frames.append(plant.frame.copy())
        plant.advance([])
    assert np.array_equal(np.array(frames), loop.run(asked).frames, equal_nan=True)


def test_event_that_is_asked_for_leaves_the_noise_as_it_was() -> None:
    asked = load_case(None, ["scenario=training", "devices=[]", "controllers=[]", "load_noise.std=0.02"])
    plant = LivePlant(asked)
    before = plant._measured.plant.load_noise
    plant.ask_event("{kind: load_step, load: load_1, change: 0.1}")(0)
    assert np.array_equal(plant._measured.plant.load_noise, before)


@pytest.mark.parametrize("sets", [[], ["load_noise=off"], ["load_noise.std=0"]])
def test_without_noise_a_run_has_the_bits_of_one_that_knows_none(sets: list[str]) -> None:
    asked = load_case(None, ["duration=1.2", *sets])
    assert len(build_plant(asked).plant.ports) == 1  # the SSSC's alone
    assert np.array_equal(loop.run(asked).frames, loop.run(load_case(None, ["duration=1.2"])).frames, equal_nan=True)


@pytest.mark.parametrize(
    ("setting", "message"),
    [
        ("load_noise.std=0.5", r"load_noise\.std: 0\.5 given; allowed: less than or equal to 0\.2"),
        ("load_noise.time_constant=0", "load_noise.time_constant: 0 given; allowed: greater than or equal to 0.05"),
        ("load_noise.correlation=2", "load_noise.correlation: 2 given; allowed: less than or equal to 1"),
        ("load_noise.loads.load_9.std=0", r"'load_9' given \(did you mean load_2\?\); allowed: load_1, load_2"),
        ("load_noise.sigma=1", "load_noise.sigma"),
    ],
)
def test_bad_input_is_told(setting: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        load_case(None, [setting])
