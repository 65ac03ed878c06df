"""The Gymnasium environment: its checker, seeds, studies; the loop's bits; single and vector alike; bad input."""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING, Any

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

import facts_damping as fd
from facts_damping.case.loading import load_case
from facts_damping.errors import InputError, RunError
from facts_damping.monitor_table import TRIPPED
from facts_damping.simulation import loop
from facts_damping.simulation.programs.spec import Spec, spec_of
from facts_damping_gym import NAME
from facts_damping_gym.reward import IndexReward
from facts_damping_gym.single import WideAreaDamping
from facts_damping_gym.vector import WideAreaDampingVector
from facts_damping_gym.window import Window
from tests.plant.running import shipped
from tests.two_plants import path

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

LOSSY = {"up": [{"model": "bernoulli", "loss": 0.3}, {"model": "uniform", "low": 0.0, "high": 0.15}]}
SHORT: Any = {"duration": 2}
ALL_INFORMATION = ("point", "seed", "ITAE", "in_synchronism", "setpoint", "tripped")


def law(seen: NDArray[np.float32]) -> NDArray[np.float64]:
    """A policy of all that is seen."""
    y, age, missing = np.moveaxis(seen[..., 0, :].astype(np.float64), -1, 0)
    u: NDArray[np.float64] = np.clip(
        2.0 * y[..., -1:] - y[..., :1] + 0.1 * (age * missing).sum(axis=-1, keepdims=True), -1.0, 1.0
    )
    return u


def played(env: Any, seed: int | None, steps: int = 10_000) -> list[Any]:
    """An episode by the law: all that `step` gives."""
    seen, info = env.reset(seed=seed)
    steps_seen: list[Any] = [(seen, info)]
    for _ in range(steps):
        steps_seen.append(env.step(law(seen)))
        seen = steps_seen[-1][0]
        if steps_seen[-1][2] or steps_seen[-1][3]:
            break
    return steps_seen


def same(first: Any, other: Any) -> bool:
    return all(np.array_equal(a, b) if isinstance(a, np.ndarray) else a == b for a, b in zip(first, other, strict=True))


def test_gymnasium_finds_nothing_wrong_with_it() -> None:
    check_env(gymnasium.make(NAME, **SHORT).unwrapped)


def test_environment_is_made_by_its_gymnasium_name() -> None:
    env = gymnasium.make(NAME, link="pdci", window=4, controllers=[{"signals": ["w13", "w12"]}], **SHORT)
    assert isinstance(env.unwrapped, WideAreaDamping)
    assert env.observation_space.shape == (4, 2, 3)
    assert env.action_space.shape == (1,)
    environments = gymnasium.make_vec(NAME, 2, "vector_entry_point", **SHORT)
    assert isinstance(environments.unwrapped, WideAreaDampingVector)
    environments.close()


def test_same_seed_is_the_same_episode_bit_for_bit() -> None:
    env = WideAreaDamping(link=LOSSY, **SHORT)
    first, again, other = played(env, 3), played(env, 3), played(WideAreaDamping(link=LOSSY, **SHORT), 4)
    assert all(same(step, two) for step, two in zip(first, again, strict=True))
    assert not all(same(step, two) for step, two in zip(first, other, strict=False))
    third = played(env, None)  # goes on with the generator of the seed before
    assert third[0][1]["seed"] != again[0][1]["seed"]


def test_episode_ends_at_the_end_or_where_synchronism_is_lost() -> None:
    episode = played(WideAreaDamping(**SHORT), 1)
    assert len(episode) == 120
    assert [step[2:4] for step in episode[1:]] == [(False, False)] * 118 + [(False, True)]
    env = WideAreaDamping()
    env.reset(seed=1)
    steps = [env.step(np.zeros(1, np.float32))]
    while not (steps[-1][2] or steps[-1][3]):
        steps.append(env.step(np.zeros(1, np.float32)))
    assert steps[-1][2:4] == (True, False)
    assert steps[-1][1] < -100.0 < min(step[1] for step in steps[:-1])
    record = loop.run(load_case("two_area_large", ["controllers=[]"]))
    assert len(steps) + 1 == len(record.time_ns)
    with pytest.raises(gymnasium.error.ResetNeeded):
        env.step(np.zeros(1, np.float32))
    with pytest.raises(gymnasium.error.ResetNeeded):
        WideAreaDamping().step(np.zeros(1, np.float32))


POLICY = """
import sys
sys.path.insert(0, {root!r})
from facts_damping_gym.window import Window
from tests.gym.test_environment import law

class Mine:
    once_a_tick = True

    def __init__(self, spec):
        self.window, self.limits = Window(spec, 8), spec.limits

    def reset(self):
        self.window.reset()

    def step(self, t_s, y, age_s, fresh):
        return law(self.window.push(t_s, y, age_s, fresh)) * self.limits
"""


def as_class(folder: Path, **fields: Any) -> Any:
    """The record of the law as a class, where the environment has its agent."""
    (folder / "mine.py").write_text(POLICY.format(root=str(__file__).rpartition("/tests/")[0]))
    controller = {"name": "mine", "policy": f"{folder / 'mine.py'}:Mine"}
    return fd.simulate("two_area_large", controllers=[controller], **SHORT, **fields)


@pytest.mark.parametrize("link", ["ideal", "pdci", "delay_100ms", "plc", "satellite", LOSSY], ids=str)
def test_law_in_the_environment_is_the_same_law_as_a_class(tmp_path: Path, link: Any) -> None:
    """Bit for bit, its window too: both act once a tick, at the last arrival."""
    env = WideAreaDamping(link=link, **SHORT)
    seed = played(env, 5)[0][1]["seed"]
    ours, theirs = env.record(), as_class(tmp_path, link=link, seed=seed)
    assert np.unique(theirs.issued["tick"], return_counts=True)[1].max() == 1
    assert len(ours.issued) > 30
    ticks = len(ours.time_ns) - 1  # of the last one nothing was answered
    before = theirs.issued[theirs.issued["tick"] < ticks]
    assert ours.issued.tobytes() == before.tobytes()
    assert ours.machines[:ticks].tobytes() == theirs.machines[:ticks].tobytes()


def test_window_holds_what_was_delivered() -> None:
    """Against the record: newest values and ages by tick, and which ticks brought nothing."""
    env = WideAreaDamping(link=LOSSY, window=3, **SHORT)
    episode = played(env, 2)
    record, case = env.record(), env.episode.case
    weights = case.system.signals["speed"].weights
    held: dict[str, Any] = {}
    for tick, seen in enumerate(step[0] for step in episode):
        rows = record.delivered[record.delivered["tick"] == tick]
        before = max((row["measured_ns"] for row in held.values()), default=-1)
        arrived = -1
        for row in rows:
            name = record.pmus[row["pmu"]]
            if name in weights and row["measured_ns"] > (held[name]["measured_ns"] if name in held else -1):
                held[name] = row.copy()
            newest = max((entry["measured_ns"] for entry in held.values()), default=-1)
            if len(held) == len(weights) and newest > before:
                arrived, before = row["arrival_ns"], newest
        if len(held) < len(weights):
            assert seen[-1].tolist() == [[0.0, 0.0, 1.0]]
            continue
        assert seen[-1, 0, 2] == float(arrived < 0)
        assert -100.0 < seen[-1, 0, 0] < 100.0
        age = (arrived if arrived >= 0 else (tick + 1) * 10**9 // 60) - before
        assert seen[-1, 0, 1] == pytest.approx(age * 1e-9, abs=1e-6)
        if tick > 1:
            assert np.array_equal(seen[:-1], episode[tick - 1][0][1:])


def test_rewards_are_minus_the_index() -> None:
    """By the rectangle rule, in units of 0.01 p.u.; effort at its price."""
    for index, unit in (("ISE", 1e4), ("IAE", 100.0), ("ITSE", 1e4), ("ITAE", 100.0)):
        env = WideAreaDamping(reward=IndexReward(index, effort=0.0), **SHORT)
        total = sum(step[1] for step in played(env, 1)[1:])
        assert total == pytest.approx(-unit * fd.summarise(env.record())["indices"][index], rel=0.05)
    priced = WideAreaDamping(reward=IndexReward(effort=3.0), **SHORT)
    free = WideAreaDamping(reward=IndexReward(effort=0.0), **SHORT)
    for env in (priced, free):
        env.reset(seed=1)
    costs = [free.step(np.array([0.5]))[1] - priced.step(np.array([0.5]))[1] for _ in range(3)]
    assert costs == pytest.approx([3.0 * 0.25 / 60] * 3)


def test_information_is_that_of_the_record() -> None:
    """At each step: the index so far, the setpoint that acts, what was drawn."""
    env = WideAreaDamping(link="delay_100ms", **SHORT)
    episode, record = played(env, 1), env.record()
    infos = [episode[0][1], *(step[4] for step in episode[1:])]
    assert infos[-1]["ITAE"] == pytest.approx(fd.summarise(record)["indices"]["ITAE"], rel=1e-9)
    assert all(before["ITAE"] <= after["ITAE"] for before, after in pairwise(infos))
    assert [info["setpoint"].tolist() for info in infos] == record.devices["setpoint"].tolist()
    assert np.ptp(record.devices["setpoint"]) > 0.0
    drawn = {(info["point"], info["seed"], info["in_synchronism"], info["tripped"]) for info in infos}
    assert drawn == {(0, infos[0]["seed"], True, False)}


def test_index_counts_frequencies_where_there_is_no_rotor() -> None:
    content = shipped(path("battery")).model_dump(by_alias=True)
    content["signals"] = {"f": {"channel": "frequency", "weights": {"G1": 1.0, "BATTERY": -1.0}}}
    content["measures"] = {"local": ["f"]}
    agent = [{"name": "LLC", "devices": ["pod_p"], "signals": ["f"]}]
    events = [{"time": 0.5, "kind": "fault", "bus": "B1", "duration": 0.05}]
    env = WideAreaDamping(None, system=content, devices=["pod_p"], controllers=agent, scenario=events, duration=2)
    last = played(env, 1)[-1][4]
    index = fd.summarise(env.record())["indices"]["ITAE"]
    assert index > 1e-4
    assert last["ITAE"] == pytest.approx(index, rel=1e-9)


def test_information_tells_a_trip_and_the_loss_of_synchronism() -> None:
    env = WideAreaDamping("two_area_supervised", duration=7)
    env.reset(seed=1)
    infos = [env.step(np.ones(1))[4] for _ in range(400)]  # at its limit
    record = env.record()
    trips = record.supervision["tick"][record.supervision["state"] == TRIPPED]
    assert [info["tripped"] for info in infos].index(True) == trips[0]  # told by the step that answers that tick
    lost = WideAreaDamping()
    info = lost.reset(seed=1)[1]
    while info["in_synchronism"]:
        *_, terminated, _, info = lost.step(np.zeros(1))
    assert terminated


@pytest.mark.parametrize("many", [False, True])
@pytest.mark.parametrize(
    ("action", "said"),
    [
        (np.nan, "nan given; allowed: a finite number, -1 to 1"),
        (-np.inf, "-inf given; allowed: a finite number, -1 to 1"),
        ("full", "'full' given; allowed: numbers of shape"),
        ([0.0, 0.0, 0.0], "shape (3,) given; allowed: ("),
        ([[0.0, 0.0, 0.0]], "shape (1, 3) given; allowed: ("),
    ],
)
def test_action_that_is_none_is_refused_by_what_was_given(many: bool, action: Any, said: str) -> None:
    env: Any = WideAreaDampingVector(2, **SHORT) if many else WideAreaDamping(**SHORT)
    env.reset(seed=1)
    wrong = np.array([[0.0], [action]]) if many and isinstance(action, float) else action
    with pytest.raises(ValueError, match=r"^action") as error:
        env.step(wrong)
    assert said in str(error.value)
    env.step(np.zeros((2, 1) if many else 1))  # nothing has happened meanwhile
    env.close()


def test_reward_of_ones_own_is_taken() -> None:
    def reward(dt: float, t_s: Any, deviations: Any, action: Any) -> Any:
        return t_s + dt * np.abs(deviations).max(axis=-1) + action[..., 0]

    env = WideAreaDamping(reward=reward, **SHORT)
    env.reset(seed=1)
    assert env.step(np.array([0.5]))[1] == pytest.approx(0.5 + 1 / 60, abs=1e-3)


STUDY = """
run: two_area_small
set: {duration: 1.5, link: pdci}
sweep:
  - {field: scenario, values: [small, large]}
  - {field: system.loads.0.P, values: [950, 967, 980]}
modes: false
"""


@pytest.fixture
def study(tmp_path: Path) -> str:
    path = tmp_path / "study.yaml"
    path.write_text(STUDY)
    return str(path)


def test_episodes_are_drawn_from_a_study(study: str) -> None:
    env = WideAreaDamping(study=study)
    infos = [env.reset(seed=seed)[1] for seed in range(30)]
    assert {info["point"] for info in infos} == set(range(6))
    assert len({info["seed"] for info in infos}) == 30
    for info in infos:
        assert info["system.loads.0.P"] == [950, 967, 980][info["point"] % 3]
    _, info = env.reset(seed=1, options={"point": 5, "seed": 7})
    assert (info["point"], info["seed"], info["scenario"]) == (5, 7, "large")
    assert env.episode.case.system.loads[0].P == 980
    assert env.episode.case.run.link == "pdci"
    with pytest.raises(InputError, match="point: 6 given; allowed: 0 to 5"):
        env.reset(options={"point": 6})


@pytest.mark.parametrize("threads", [1, 2])
def test_many_at_once_are_those_by_themselves_bit_for_bit(study: str, threads: int) -> None:
    """Beyond the end of an episode: the next one is drawn from the same generator."""
    many, ones = (
        WideAreaDampingVector(5, study=study, threads=threads),
        [WideAreaDamping(study=study) for _ in range(5)],
    )
    seen, infos = many.reset(seed=11)
    alone, ones_infos = (list(row) for row in zip(*(env.reset(seed=11 + i) for i, env in enumerate(ones)), strict=True))
    ended = [False] * 5
    assert np.array_equal(seen, np.array(alone))
    for _ in range(200):
        actions = law(seen)
        for i, info in enumerate(ones_infos):
            assert all(np.array_equal(infos[name][i], info[name]) for name in ALL_INFORMATION)
        seen, rewards, lost, over, infos = many.step(actions)
        for i, env in enumerate(ones):
            if ended[i]:
                (alone[i], ones_infos[i]), ended[i] = env.reset(), False
                assert (rewards[i], lost[i], over[i]) == (0.0, False, False)
                continue
            alone[i], reward, terminated, truncated, ones_infos[i] = env.step(actions[i])
            ended[i] = terminated or truncated
            assert (rewards[i], lost[i], over[i]) == (pytest.approx(reward, rel=1e-12), terminated, truncated)
        assert np.array_equal(seen, np.array(alone))
    many.close()


def test_agents_among_other_controllers_have_the_place_of_theirs() -> None:
    rows = [{"name": "LLC", "devices": ["statcom"]}, {"name": "LLC", "devices": ["sssc"], "signals": ["w13"]}]
    env = WideAreaDamping(devices=["sssc", "statcom"], controllers=rows, controller=1, **SHORT)
    played(env, 1)
    record = env.record()
    assert record.controller_names == ["controller_0_LLC", "controller_1_agent"]
    assert set(record.issued["controller"]) == {0, 1}
    rest = loop.run(load_case("two_area_large", ["duration=0.5"]))
    assert len(rest.issued) == 30


def test_agent_has_the_place_of_a_fallback() -> None:
    rows = [{}, {"fallback_of": 0, "signals": ["power"]}]
    env = WideAreaDamping(controllers=rows, controller=1, supervision="standard", arm_at=0.1, duration=1)
    env.reset(seed=1)
    for _ in range(30):
        env.step(np.array([0.5]))
    record = env.record()
    assert {float(value) for value in record.issued["value"][record.issued["controller"] == 1]} == {0.05}
    assert set(record.supervised["controller"]) == {0}


@pytest.mark.parametrize("many", [False, True])
def test_class_beside_the_agent_that_fails_is_named(tmp_path: Path, many: bool) -> None:
    step = "def step(self, t_s, y, age_s, fresh): return 1 / (t_s < 0.5)"
    (tmp_path / "bad.py").write_text(f"class Bad:\n    def __init__(self, spec): pass\n    {step}\n")
    rows = [{"devices": ["sssc"]}, {"name": "bad", "policy": f"{tmp_path / 'bad.py'}:Bad", "devices": ["statcom"]}]
    settings: Any = {"devices": ["sssc", "statcom"], "controllers": rows, **SHORT}
    env: Any = WideAreaDampingVector(2, **settings) if many else WideAreaDamping(**settings)
    env.reset(seed=1)
    action = np.zeros((2, 1) if many else 1)
    for _ in range(30):  # to 0.5 s
        env.step(action)
    with pytest.raises(RunError, match=r"controllers\.1\.policy: bad\.py:3: ZeroDivisionError.* at 0\.5 s"):
        env.step(action)
    env.close()


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        ({"run": "nowhere"}, "nowhere"),
        ({"devices": [], "controllers": []}, "no device is installed; allowed: a run with a controller of a device"),
        ({"controllers": []}, "controller: 0 given; 0 there; allowed: a run with a controller of a device"),
        ({"controller": 3}, "controller: 3 given; 1 there"),
        ({"link": "nowhere"}, "'nowhere' given"),
        ({"study": "nowhere"}, "nowhere"),
        ({"window": 0}, "window: 0 given; allowed: 1 or more ticks"),
        ({"reward": IndexReward("ISO")}, "reward.of: 'ISO' given (did you mean ISE?); allowed: ITAE, IAE, ITSE, ISE"),
        ({"scale": [1.0, 2.0]}, "scale: 2 numbers given; allowed: one, or 1, one a signal"),
    ],
)
def test_bad_settings_are_input_errors(settings: dict[str, Any], said: str) -> None:
    with pytest.raises(InputError) as error:
        played(WideAreaDamping(**settings), 1)
    assert said in str(error.value)
    assert "\n" not in str(error.value)


def test_study_whose_points_are_for_other_agents_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "study.yaml"
    path.write_text("run: two_area_small\nsweep: [{field: controllers.0.signals, values: [[w12], [w12, w13]]}]\n")
    env = WideAreaDamping(study=str(path))
    with pytest.raises(InputError, match="study: point 1 has other signals, devices or frame_rate"):
        env.reset(options={"point": 1})


def test_window_of_a_class_begins_empty_and_again() -> None:
    case = load_case("two_area_large", [])
    spec: Spec = spec_of(case, 0)
    window = Window(spec, 2)
    first = window.push(0.1, np.array([0.01]), np.array([0.05]), np.array([True]))
    assert first[-1].tolist() == [[1.0, np.float32(0.05), 0.0]]
    window.reset()
    again = window.push(0.1, np.array([0.01]), np.array([0.05]), np.array([True]))
    assert np.array_equal(first, again)
