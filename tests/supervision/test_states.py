"""States of a supervisor, whatever it is told: who may act, how softly that changes, within which authority."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from facts_damping.monitor_table import MONITORS
from facts_damping.simulation.measured_plant import tick_ns
from tests.supervision.guarded import LIMITS, RATE, TICK, Guarded, Told, watching
from tests.supervision.operators_model import Model, Settings

# Times beside the ticks': whether one more tick is needed is no matter of rounding.
RAMPS = {"ramp": 0.115, "trip_ramp": 0.062, "fall_back_ramp": 0.082, "recovery": 0.141}
WILD = [math.nan, math.inf, -math.inf, 1e300, -1e300, 0.0, 0.3, -0.3, 7.0]


class Tick(NamedTuple):
    """What happens in a tick."""

    controller: list[float] | None
    reserve: list[float] | None
    speed: float | None
    late: float
    blocked: bool
    command: str | None


def setpoints(devices: int, values: st.SearchStrategy[float]) -> st.SearchStrategy[list[float] | None]:
    said = st.lists(values, min_size=devices, max_size=devices)
    return st.one_of(st.none(), *[said] * 15)


def short(devices: int, values: st.SearchStrategy[float]) -> st.SearchStrategy[list[Tick]]:
    """Any ticks, which can be made simpler where a test fails."""
    said = setpoints(devices, values)
    commands = st.sampled_from([*[None] * 6, *["arm"] * 6, "reset", "reset", "disarm"])
    late = st.sampled_from([0.0, 0.0, 0.05])
    tick = st.builds(Tick, said, said, st.sampled_from([0.0, 0.001, None]), late, st.booleans(), commands)
    return st.lists(tick, min_size=1, max_size=30)


def long(seed: int, devices: int, wild: bool) -> list[Tick]:
    """Four hundred ticks in which what lasts, lasts long enough to matter, and which come to all states."""
    random, ticks = np.random.default_rng(seed), list[Tick]()

    def said() -> list[float] | None:
        values = random.uniform(-0.4, 0.4, devices)
        values[random.random(devices) < 0.002 * wild] = random.choice(WILD)
        return values.tolist()  # type: ignore[no-any-return]

    while len(ticks) < 400:
        command = random.choice(["", "arm", "reset", "disarm"], p=[0.3, 0.5, 0.17, 0.03])
        silent, lone = random.random(2) < [0.05, 0.1]
        speed = None if random.random() < 0.1 else random.uniform(-0.01, 0.01)
        late, blocked = random.choice([0.0, 0.05], p=[0.9, 0.1]), bool(random.random() < 0.05)
        for k in range(random.integers(1, 25)):
            who = None if silent else said(), None if lone else said()
            ticks.append(Tick(*who, speed, float(late), blocked, None if k else str(command) or None))
    return ticks


def scripts(devices: int = 1, *, wild: bool = True) -> st.SearchStrategy[list[Tick]]:
    values = st.floats(-0.4, 0.4) if not wild else st.one_of(*[st.floats(-0.4, 0.4)] * 9, st.sampled_from(WILD))
    seeds = st.integers(0, 2**32 - 1)
    return st.one_of(short(devices, values), *[seeds.map(lambda seed: long(seed, devices, wild))] * 2)


def play(guarded: Guarded, script: list[Tick]) -> list[Told]:
    return [
        guarded.give(t.controller, t.reserve, speed=t.speed, late=t.late, blocked=t.blocked, command=t.command)
        for t in script
    ]


ACTING = ("armed", "fallback")
MONITORED = {
    "missing": {"limit": 0.05, "lasts": 0.0, "follows": "fall_back"},
    "stale": {"limit": 0.03, "lasts": 0.04, "follows": "fall_back"},
    "local": {"limit": 0.04, "lasts": 0.0, "follows": "trip"},
    "silent": {"limit": 0.04, "lasts": 0.0, "follows": "fall_back"},
    "non_finite": {"limit": 0.0, "lasts": 0.0, "follows": "trip"},
    "reversals": {"limit": 4.0, "lasts": 0.02, "follows": "warn"},
    "device": {"limit": 0.5, "lasts": 0.07, "follows": "trip"},
}


def shuffled(follows: dict[str, str], authority: dict[str, Any]) -> dict[str, Any]:
    """A supervision in which monitors are followed by something else than in the table."""
    monitors = {
        name: {**MONITORED[name], "follows": follows.get(name, MONITORED[name]["follows"])} for name in MONITORED
    }
    off = {name: "off" for name in MONITORS if name not in monitors}
    return {"monitors": {**off, **monitors}, "arming": RAMPS, "authority": authority}


FOLLOWS = st.dictionaries(st.sampled_from(list(MONITORED)), st.sampled_from(["warn", "fall_back", "trip"]))


def model_of(supervision: dict[str, Any], arm_at: float | None) -> Model:
    of = {name: row for name, row in supervision["monitors"].items() if row != "off"}
    follows, limit, lasts = ({m: row[key] for m, row in of.items()} for key in ("follows", "limit", "lasts"))
    return Model(Settings(follows, limit, lasts, RAMPS["recovery"], arm_at, float(of["local"]["limit"])))


def see(model: Model, tick_told: Told, t: Tick, k: int) -> None:
    start, end = (tick_ns(i, RATE) * 1e-9 for i in (k, k + 1))
    model.see(tick_told.values, None if t.reserve is None else (start + end) / 2.0, end)


@settings(max_examples=80)
@given(script=scripts(), follows=FOLLOWS, arm_at=st.sampled_from([None, 0.0, 0.21]))
def test_states_are_those_of_a_model_by_other_means(
    script: list[Tick], follows: dict[str, str], arm_at: float | None
) -> None:
    """States, causes and refusals, tick by tick, from what the monitors see."""
    supervision = shuffled(follows, {})
    guarded, model = Guarded(supervision, arm_at=arm_at), model_of(supervision, arm_at)
    for k, t in enumerate(script):
        tick_told = play(guarded, [t])[0]
        model.ask(t.command, tick_ns(k, RATE) * 1e-9)
        see(model, tick_told, t, k)
        assert (tick_told.state, tick_told.cause, tick_told.refused) == (model.state, model.why, model.refused), k


@settings(max_examples=80)
@given(
    script=scripts(devices=2),
    fraction=st.sampled_from([1.0, 0.4]),
    rate=st.sampled_from([None, 0.5]),
    follows=FOLLOWS,
)
def test_whatever_it_is_told_its_setpoints_stay_within_authority_and_ramps(
    script: list[Tick], fraction: float, rate: float | None, follows: dict[str, str]
) -> None:
    """From what was said last before a change, b of a ramp's time later, no further than b of what is allowed."""
    supervision = shuffled(follows, {"fraction": fraction, "rate": rate})
    guarded, model = Guarded(supervision, list(LIMITS)), model_of(supervision, None)
    limits, latest, before = guarded.limits, {0: (0, 0.0), 1: (0, 0.0)}, (model.state, model.entered)
    assert limits == pytest.approx(fraction * np.array(list(LIMITS.values())))
    begun, ramp = {0: 0.0, 1: 0.0}, RAMPS["trip_ramp"]

    def change() -> None:
        """A ramp's begin, if there is one."""
        nonlocal before, begun, ramp
        now = model.state, model.entered
        if now != before:
            begun = {d: v for d, (_, v) in latest.items()}
            ramp = RAMPS["trip_ramp"] if now[0] not in ACTING else RAMPS["fall_back_ramp"]
            ramp = RAMPS["ramp"] if (before[0], now[0]) == ("shadow", "armed") else ramp
            before = now

    for k, t in enumerate(script):
        model.ask(t.command, tick_ns(k, RATE) * 1e-9)
        change()
        tick_told = play(guarded, [t])[0]
        for row in tick_told.said:
            d, at, v = int(row["device"]), int(row["issued_ns"]), float(row["value"])
            assert abs(v) <= limits[d]
            assert tick_ns(k, RATE) <= at < tick_ns(k + 1, RATE)
            if rate is not None:
                assert abs(v - latest[d][1]) <= rate * (at - latest[d][0]) * 1e-9 + 1e-12
            else:
                b = min(1.0, (at * 1e-9 - model.entered) / ramp)
                assert abs(v - begun[d]) <= b * (abs(begun[d]) + limits[d]) + 1e-9
                assert model.state in ACTING or b < 1.0 or v == 0.0
            latest[d] = (at, v)
        assert model.state in ACTING or len(tick_told.said) == 2  # a device is never without a word
        see(model, tick_told, t, k)
        change()


def test_ramp_has_its_share_of_what_is_allowed_however_much_is_asked_for() -> None:
    """From 0 to all that a controller may have in the ramp's time, also where it asks for more."""
    for asked in (0.3, 1e300):
        guarded = Guarded({"monitors": watching(), "authority": {"fraction": 0.5}, "arming": {"ramp": 1.0}})
        guarded.arm()
        begun = tick_ns(guarded.tick - 1, RATE)
        for _ in range(70):
            (row,) = guarded.give([asked]).said
            assert row["value"] == pytest.approx(0.15 * min(1.0, (row["issued_ns"] - begun) * 1e-9), rel=1e-9)


@given(said=st.lists(st.floats(-0.3, 0.3), min_size=1, max_size=40))
def test_armed_and_ramped_setpoints_are_the_controller_s_to_the_bit(said: list[float]) -> None:
    guarded = Guarded({"monitors": watching(), "arming": {"ramp": 0.0}})
    guarded.arm()
    for value in said:
        (row,) = guarded.give([value]).said
        assert row["value"].tobytes() == np.float64(value).tobytes()


@pytest.mark.parametrize(("energy", "devices"), [(0.5, 2), (6.0, 1)])
def test_supervised_setpoints_keep_within_the_energy_of_a_minute(energy: float, devices: int) -> None:
    """Of a controller that asks for all there is, now and then for some of it, and rests at times."""
    fields = {"monitors": watching(), "arming": {"ramp": 0.0}, "authority": {"energy": energy}}
    guarded, random = Guarded(fields, list(LIMITS)[:devices]), np.random.default_rng(0)
    guarded.arm()
    asked = np.repeat(random.choice([0.0, 0.5, 1.0, 1.0, 1e300], 45), 2 * RATE)
    said = np.array([guarded.give([factor * limit for limit in guarded.limits]).said["value"] for factor in asked])
    used = np.sum((said / guarded.limits) ** 2, axis=1) * TICK
    total = np.concatenate([[0.0], np.cumsum(used)])
    minute = total[60 * RATE :] - total[: -60 * RATE]
    assert np.max(minute) <= energy + devices * TICK + 1e-9
    assert np.max(minute) > 0.9 * energy  # and what is allowed may be used


@settings(max_examples=40)
@given(script=scripts(), seed=st.integers(0, 2**32 - 1))
def test_setpoints_of_a_tripped_or_disarmed_controller_never_act(script: list[Tick], seed: int) -> None:
    """Two runs alike but for what a controller says while it may not act: the same setpoints."""
    supervision = shuffled({"non_finite": "warn"}, {})
    first, other = Guarded(supervision), Guarded(supervision)
    values = np.random.default_rng(seed).choice([*WILD, 0.1, -0.2], len(script)).tolist()
    for t, value in zip(script, values, strict=True):
        silent = first.row["state"] not in (1, 2, 3)  # neither shadow, armed nor fallback
        said = [value] if silent and t.controller is not None and t.command is None else t.controller
        a, b = play(first, [t])[0], play(other, [t._replace(controller=said)])[0]
        assert (a.state, a.said.tobytes()) == (b.state, b.said.tobytes())


@settings(max_examples=40)
@given(script=scripts(wild=False))
def test_trip_is_left_by_an_operator_alone_and_by_way_of_shadow(script: list[Tick]) -> None:
    guarded = Guarded(shuffled({}, {}), arm_at=0.05)
    before = "shadow"
    for t in script:
        after = play(guarded, [t])[0].state
        if before == "tripped" and after != "tripped":
            assert (t.command, after) in (("reset", "shadow"), ("disarm", "disarmed"))
        if before == "disarmed" and after != "disarmed":
            assert (t.command, after) == ("reset", "shadow")
        before = after


def test_transfer_to_the_fallback_and_back_is_bumpless() -> None:
    """From the controller to the fallback in its ramp, and back, in steps of a ramp's tick."""
    guarded = Guarded(
        {"monitors": watching(missing="fall_back"), "arming": {"ramp": 0.0, "fall_back_ramp": 0.5, "recovery": 1.0}}
    )
    guarded.arm()
    values, states = [], []
    for k in range(240):
        tick_told = guarded.give([0.2], [-0.1], speed=None if 30 <= k < 60 else 0.0)
        values += tick_told.said["value"].tolist()
        states.append(tick_told.state)
    assert [states[i] for i in (29, 50, 100, 239)] == ["armed", "fallback", "fallback", "armed"]
    assert np.abs(np.diff(values)).max() == pytest.approx(0.3 * TICK / 0.5, rel=1e-6)
    assert (values[0], min(values), values[-1]) == (0.2, -0.1, 0.2)
