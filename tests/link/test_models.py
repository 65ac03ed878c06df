"""What each kind of stage does: moments and fractions against the textbook; order, alignment, bad data, changes."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import TypeAdapter
from scipy import stats

from facts_damping.case.loading import load_case
from facts_damping.link.chain import DirectionSpec
from facts_damping.link.transfer import Links, changed, downlink, links, uplink
from facts_damping.parameters.link import Link, Stage
from facts_damping.signals import CHANNELS, DELIVERY, SETPOINT, to_ns
from facts_damping.simulation.measured_plant import tick_ns

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

RATE, PMUS, DEVICES = 50, 3, 2
SOUND = np.zeros(PMUS, np.int64)  # status of entries
CROWD = 30  # PMUs, of which one frame gives many draws
PERIOD_NS = 20_000_000
MANY = 2_000  # frames of the crowd of which fractions are taken
one_stage: TypeAdapter[Any] = TypeAdapter(Stage)


def way_up(ticks: int, seed: int = 0, pmus: int = PMUS) -> DirectionSpec:
    groups = {"both": ["s0", "s2"]}
    return DirectionSpec([f"s{i}" for i in range(pmus)], groups, len(CHANNELS), pmus, RATE, ticks, (seed, 0))


def way_down(ticks: int, seed: int = 0) -> DirectionSpec:
    return DirectionSpec([f"d{i}" for i in range(DEVICES)], {}, 1, 2 * DEVICES, RATE, ticks, (seed, 1))


def built_links(
    up: Sequence[dict[str, Any]], down: Sequence[dict[str, Any]], ticks: int, seed: int = 0, pmus: int = PMUS
) -> Links:
    link = Link.model_validate({"up": list(up), "down": list(down)})
    return links([link], [0], way_up(ticks, seed, pmus), way_down(ticks, seed))


def values(tick: int, pmus: int = PMUS) -> NDArray[np.float64]:
    """A frame whose values say tick, PMU and channel."""
    return np.asarray(tick + 0.1 * np.arange(pmus)[:, None] + 0.01 * np.arange(len(CHANNELS)))


def send(link: Links, ticks: int, first: int = 0) -> NDArray[Any]:
    """Everything that is delivered while a frame a tick is sent."""
    out, pmus = [np.zeros(0, DELIVERY)], link.up.statistics.shape[1]
    sound = np.zeros(pmus, np.int64)
    for k in range(first, first + ticks):
        start, end = tick_ns(k, RATE), tick_ns(k + 1, RATE)
        count = uplink(link, 0, k, start, end, values(k, pmus), np.full(pmus, start), sound)
        out.append(link.up.out[0, :count].copy())
    return np.concatenate(out)


def up(stages: Sequence[dict[str, Any]], ticks: int, seed: int = 0, pmus: int = PMUS) -> NDArray[Any]:
    """All that becomes of `ticks` frames: with those after them, which are left out, all have arrived."""
    entries = send(built_links(stages, [], ticks, seed, pmus), ticks + 2 * RATE)
    return entries[entries["measured_ns"] < ticks * PERIOD_NS]


def late_s(entries: NDArray[Any]) -> NDArray[np.float64]:
    return np.asarray((entries["arrival_ns"] - entries["measured_ns"]) * 1e-9)


def lateness(entries: NDArray[Any], ticks: int, pmus: int = PMUS) -> NDArray[np.float64]:
    """Delay of each frame's entries, s, (ticks, PMUs); NaN: it did not come."""
    table = np.full((ticks, pmus), math.nan)
    table[entries["measured_ns"] // PERIOD_NS, entries["pmu"]] = late_s(entries)
    return table


def truncated(mean: float, std: float, low: float, high: float) -> Any:
    return stats.truncnorm((low - mean) / std, (high - mean) / std, mean, std)


JITTER = {"model": "uniform", "low": 0.0, "high": 0.1}
DISTRIBUTIONS: dict[str, tuple[dict[str, Any], Any]] = {
    "uniform": ({"model": "uniform", "low": 0.1, "high": 0.15}, stats.uniform(0.1, 0.05)),
    "normal": (
        {"model": "normal", "mean": 0.1, "std": 0.03, "low": 0.08, "high": 0.2},
        truncated(0.1, 0.03, 0.08, 0.2),
    ),
    "half a normal": ({"model": "normal", "mean": 0.0, "std": 0.05}, stats.halfnorm(0.0, 0.05)),
    "gamma": ({"model": "gamma", "delay": 0.069, "shape": 2.6, "scale": 0.005}, stats.gamma(2.6, 0.069, 0.005)),
    "lognormal": (
        {"model": "lognormal", "delay": 0.02, "median": 0.05, "sigma": 0.5},
        stats.lognorm(0.5, 0.02, 0.05),
    ),
}


@pytest.mark.parametrize("case", DISTRIBUTIONS.values(), ids=DISTRIBUTIONS)
def test_delays_have_the_distribution_that_they_are_named_after(case: tuple[dict[str, Any], Any]) -> None:
    """Kolmogorov and Smirnov's test against SciPy's, and moments within three standard errors."""
    stage, expected = case
    late = late_s(up([stage], 700, pmus=CROWD))
    n = len(late)
    assert n == 700 * CROWD
    assert abs(late.mean() - expected.mean()) < 3.0 * expected.std() / math.sqrt(n)
    fourth = float(expected.stats(moments="k")) + 3.0
    assert abs(late.var() - expected.var()) < 3.0 * expected.var() * math.sqrt((fourth - 1.0) / n)
    assert stats.kstest(late, expected.cdf).pvalue > 1e-3


def test_entries_draw_by_themselves() -> None:
    """Neither channels nor successive entries are correlated: within three standard errors of zero."""
    late = lateness(up([JITTER], 5000), 5000).T
    bound = 3.0 / math.sqrt(5000)
    assert np.abs(np.corrcoef(late)[np.triu_indices(PMUS, 1)]).max() < bound
    assert max(abs(np.corrcoef(column[1:], column[:-1])[0, 1]) for column in late) < bound


def test_seed_decides_and_places_do_not_share_draws() -> None:
    first = lateness(up([JITTER], 100, 7), 100)
    np.testing.assert_array_equal(lateness(up([JITTER], 100, 7), 100), first)
    assert (lateness(up([JITTER], 100, 8), 100) != first).all()
    second = lateness(up([JITTER, JITTER], 100, 7), 100) - first
    assert abs(np.corrcoef(first.ravel(), second.ravel())[0, 1]) < 0.2


@pytest.mark.parametrize("loss", [0.0, 0.02, 0.3, 1.0])
def test_share_is_lost(loss: float) -> None:
    link = built_links([{"model": "bernoulli", "loss": loss}], [], MANY, pmus=CROWD)
    entries, n = send(link, MANY), MANY * CROWD
    assert abs(len(entries) / n - (1.0 - loss)) <= 3.0 * math.sqrt(loss * (1.0 - loss) / n)
    assert link.up.statistics[0]["lost"].sum() == n - len(entries)


def test_losses_come_in_bursts_of_the_length_that_the_chain_has() -> None:
    """Share loss_B p_GB / (p_GB + p_BG), and with loss_B = 1 bursts of geometric length with mean 1 / p_BG."""
    p_gb, p_bg = 0.02, 0.25
    stage = {"model": "gilbert_elliott", "p_GB": p_gb, "p_BG": p_bg}
    there = ~np.isnan(lateness(up([stage], MANY, pmus=CROWD), MANY, CROWD))
    lengths: list[int] = []
    for present in there.T:
        edges = np.flatnonzero(np.diff(np.concatenate([[True], present, [True]])))
        lengths += (edges[1::2] - edges[::2]).tolist()
    fraction, both = p_gb / (p_gb + p_bg), p_gb + p_bg
    error = math.sqrt(fraction * (1.0 - fraction) / there.size * (2.0 - both) / both)  # of a chain of two states
    assert abs((~there).mean() - fraction) < 3.0 * error
    spread = math.sqrt((1.0 - p_bg) / p_bg**2 / len(lengths))
    assert abs(np.mean(lengths) - 1.0 / p_bg) < 3.0 * spread


def test_good_state_may_lose_and_a_bad_one_may_deliver() -> None:
    stage = {"model": "gilbert_elliott", "p_GB": 0.1, "p_BG": 0.1, "loss_G": 0.05, "loss_B": 0.5}
    there, fraction = len(up([stage], MANY, pmus=CROWD)) / (MANY * CROWD), (0.05 + 0.5) / 2.0
    assert abs(1.0 - there - fraction) < 3.0 * math.sqrt(fraction / (MANY * CROWD) * (2.0 - 0.2) / 0.2)


def test_copies_go_their_own_way() -> None:
    """With a probability of 1 every entry comes twice; a copy draws by itself what comes after it was made."""
    twice = {"model": "duplicate", "probability": 1.0}
    key = ["pmu", "measured_ns", "arrival_ns"]
    entries = up([JITTER, twice], 100)
    assert (len(entries), len(np.unique(entries[key]))) == (2 * 100 * PMUS, 100 * PMUS)
    apart = up([twice, JITTER], 100)
    assert (len(apart), len(np.unique(apart[key]))) == (2 * 100 * PMUS, 2 * 100 * PMUS)


def test_share_is_copied() -> None:
    link = built_links([{"model": "duplicate", "probability": 0.2}], [], MANY, pmus=CROWD)
    entries, n = send(link, MANY), MANY * CROWD
    assert abs(len(entries) / n - 1.2) < 3.0 * math.sqrt(0.2 * 0.8 / n)
    assert link.up.statistics[0]["duplicated"].sum() == len(entries) - n


def test_entries_overtake_unless_they_are_kept_in_order() -> None:
    """In order each leaves when it came, or with the latest before it."""
    plain, ordered = lateness(up([JITTER], 300), 300), lateness(up([JITTER, {"model": "in_order"}], 300), 300)
    sent = np.arange(300)[:, None] / RATE
    assert (np.diff(sent + plain, axis=0) < 0.0).any()
    np.testing.assert_allclose(sent + ordered, np.maximum.accumulate(sent + plain, axis=0), atol=1e-9)


@pytest.mark.parametrize("reference", ["first", "stamp"])
@pytest.mark.parametrize("sends", ["complete", "timeout"])
def test_concentrator_sends_what_came_within_its_wait_together(reference: str, sends: str) -> None:
    """The definitions of both references and ways to send, applied to the arrivals without it."""
    before = [{"model": "uniform", "low": 0.005, "high": 0.05}, {"model": "bernoulli", "loss": 0.1}]
    wait = {"model": "wait", "wait": 0.03, "reference": reference, "send": sends}
    partly = 0
    for came, left in zip(lateness(up(before, 500), 500), lateness(up([*before, wait], 500), 500), strict=True):
        if np.isnan(came).all():
            assert np.isnan(left).all()
            continue
        deadline = 0.03 + (np.nanmin(came) if reference == "first" else 0.0)
        in_time = came <= deadline + 1e-12
        leaves = came.max() if in_time.all() and sends == "complete" else deadline
        np.testing.assert_allclose(left, np.where(in_time, leaves, math.nan), atol=2e-9)
        partly += not in_time.all()
    assert 50 < partly < 450


def test_concentrator_may_hold_the_last_entry_in_the_place_of_one_that_is_missing() -> None:
    """The values are the last ones that it sent of this PMU, the stamp is the frame's; they are counted as held."""
    lossy = [{"model": "bernoulli", "loss": 0.3, "channels": ["s1"]}]
    lost = np.isnan(lateness(up(lossy, 300), 300)[:, 1])
    link = built_links([*lossy, {"model": "wait", "wait": 0.05, "missing": "hold"}], [], 300)
    entries = send(link, 300)
    said = {int(row["measured_ns"] // PERIOD_NS): row for row in entries[entries["pmu"] == 1]}
    newest, held = -1, 0
    for k in range(300):
        newest = newest if lost[k] else k
        held += newest >= 0 and newest != k
        if newest < 0:
            assert k not in said
        elif k < 297:  # later ones may be under way
            np.testing.assert_allclose(said[k]["values"], values(newest)[1])
            assert said[k]["arrival_ns"] - said[k]["measured_ns"] == (0 if newest == k else to_ns(0.05))
    assert held > 50
    s = link.up.statistics[0, 1]
    assert (s["held"], s["lost"]) == (held, lost.sum())


def test_playout_buffer_makes_the_delay_constant_for_what_is_in_time() -> None:
    plain, smooth = (
        lateness(up(stages_of_link, 500), 500)
        for stages_of_link in ([JITTER], [JITTER, {"model": "playout", "delay": 0.08}])
    )
    np.testing.assert_allclose(smooth, np.maximum(plain, 0.08), atol=1e-9)
    assert 0.1 < (plain > 0.08).mean() < 0.3


def test_setpoints_play_out_by_the_age_of_what_they_rest_on() -> None:
    link, row = built_links([], [{"model": "playout", "delay": 0.2}], 10), np.zeros(1, SETPOINT)
    row["measured_ns"], row["issued_ns"] = to_ns(0.01), to_ns(0.07)
    assert downlink(link, 0, 0, to_ns(0.1), row, 1) == 0
    assert downlink(link, 0, 1, to_ns(0.3), row, 0) == 1
    assert link.down.out[0, 0]["effective_ns"] == to_ns(0.21)


def test_trace_is_replayed_entry_by_entry_and_again() -> None:
    delays = [0.03, 0.01, None, 0.05]
    table = lateness(up([{"model": "trace", "delays": delays}], 8), 8)
    wanted = [math.nan if d is None else d for d in delays * 2]
    np.testing.assert_allclose(table, np.array(wanted)[:, None] * np.ones(PMUS))
    lateness_found = lateness(up([{"model": "trace", "delays": {"s1": [0.02]}}], 5), 5)
    np.testing.assert_allclose(lateness_found, [[0.0, 0.02, 0.0]] * 5)


@pytest.mark.parametrize(("names", "who"), [(["s1"], [1]), (["both"], [0, 2]), (["both", "s1"], [0, 1, 2])])
def test_stages_act_on_stations_or_on_those_of_signals(names: list[str], who: list[int]) -> None:
    table = lateness(up([{"delay": 0.03, "channels": names}], 5), 5)
    np.testing.assert_allclose(table, [[0.03 * (s in who) for s in range(PMUS)]] * 5)


def test_stages_act_on_devices() -> None:
    link, rows = built_links([], [{"delay": 0.03, "channels": ["d1"]}], 5), np.zeros(2, SETPOINT)
    rows["device"] = [0, 1]
    assert downlink(link, 0, 0, 1, rows, 2) == 1
    assert link.down.out[0, 0]["device"] == 0


def test_step_of_the_delay_is_two_stages_one_until_and_one_from_then_on() -> None:
    """By the time of sending: nothing has both delays, nothing has none."""
    table = lateness(up([{"delay": 0.05, "duration": 0.2}, {"delay": 0.15, "start": 0.2}], 30), 30)
    np.testing.assert_allclose(table, np.where(np.arange(30) < 10, 0.05, 0.15)[:, None] * np.ones(PMUS))


SPEED = list(CHANNELS).index("speed_deviation")
T = np.arange(40) / RATE
DURING = (np.arange(40) >= 15) & (np.arange(40) < 25)
DISTURBED: dict[str, tuple[dict[str, Any], Callable[[NDArray[np.float64]], NDArray[np.float64]]]] = {
    "freeze": ({}, lambda y: np.where(DURING, y[15], y)),
    "replay": ({"window": 0.1}, lambda y: np.where(DURING, y[10 + np.arange(40) % 5], y)),
    "bias": ({"bias": 0.5}, lambda y: y + 0.5 * DURING),
    "scale": ({"factor": -2.0}, lambda y: np.where(DURING, -2.0 * y, y)),
    "ramp": ({"rate": 3.0}, lambda y: y + 3.0 * (T - 0.3) * DURING),
}


@pytest.mark.parametrize("measurement", [None, "speed_deviation"])
@pytest.mark.parametrize(("model", "case"), DISTURBED.items(), ids=DISTURBED)
def test_disturbed_data(
    model: str, case: tuple[dict[str, Any], Callable[[NDArray[np.float64]], NDArray[np.float64]]], measurement: Any
) -> None:
    """From 0.3 to 0.5 s, one PMU, all its values or one; the others and the times stay as they are."""
    fields, wanted = case
    stage = {"model": model, **fields, "start": 0.3, "duration": 0.2, "channels": ["s1"], "measurement": measurement}
    entries, plain = up([stage], 40), up([], 40)
    np.testing.assert_array_equal(entries["arrival_ns"], plain["arrival_ns"])
    for s in range(PMUS):
        for j in range(len(CHANNELS)):
            y = plain["values"][plain["pmu"] == s][:, j]
            struck = s == 1 and (measurement is None or j == SPEED)
            np.testing.assert_allclose(entries["values"][entries["pmu"] == s][:, j], wanted(y) if struck else y)


def added(stages: Sequence[dict[str, Any]], ticks: int, seed: int = 0) -> NDArray[np.float64]:
    """What stages add to values that are zero, (ticks, PMUs, channels)."""
    link, differences = built_links(stages, [], ticks, seed), np.zeros((ticks, PMUS, len(CHANNELS)))
    for k in range(ticks):
        count = uplink(
            link,
            0,
            k,
            tick_ns(k, RATE),
            tick_ns(k + 1, RATE),
            np.zeros(differences.shape[1:]),
            np.full(differences.shape[1], tick_ns(k, RATE)),
            SOUND,
        )
        assert count == PMUS
        differences[k, link.up.out[0, :count]["pmu"]] = link.up.out[0, :count]["values"]
    return differences


def test_flipped_bits_are_one_of_an_entry_and_as_many_as_is_said() -> None:
    n, fraction = 4000, 0.1
    series = added([{"model": "flip", "probability": fraction}], n)
    words = series.view(np.int64)
    turned = np.array([int(word).bit_count() for word in np.abs(words.ravel())]).reshape(words.shape)
    negative = words < 0  # of zero the sign's bit alone
    entries = ((turned > 0) | negative).sum(axis=2)
    assert set(np.unique(entries)) == {0, 1}
    assert abs(entries.mean() - fraction) < 4.0 * math.sqrt(fraction * (1.0 - fraction) / entries.size)
    bits = np.unique(words)
    assert {int(word) & (2**64 - 1) for word in bits} <= {0, *(1 << k for k in range(64))}
    assert len(bits) > 60
    noise = added([{"model": "flip", "probability": 1.0, "measurement": "frequency"}], 50)
    assert set(np.flatnonzero((noise.view(np.int64) != 0).any(axis=(0, 1)))) == {list(CHANNELS).index("frequency")}


def test_signed_message_with_a_flipped_bit_is_lost() -> None:
    flip = "link={up: [{model: flip, probability: 0.3}], down: [{model: flip, probability: 0.2, start: 1}]}"
    case = load_case(None, [flip, "security={keys: any.yaml}"])
    assert [
        (stage.model, getattr(stage, "loss", None), stage.start) for stage in (*case.links[0].up, *case.links[0].down)
    ] == [
        ("bernoulli", 0.3, 0.0),
        ("bernoulli", 0.2, 1.0),
    ]
    assert case.link.up[0].model == "flip"  # as the user wrote it


def test_noise_is_normal_white_and_apart_in_every_value() -> None:
    """Mean 0, the deviation, the distribution, and no correlation: within four standard errors, of 15 x 15 pairs."""
    n, std = 10_000, 2.5
    series = added([{"model": "noise", "std": std}], n).reshape(n, -1).T
    assert np.abs(series.mean(axis=1)).max() < 4.0 * std / math.sqrt(n)
    assert np.abs(series.std(axis=1) / std - 1.0).max() < 4.0 / math.sqrt(2.0 * n)
    assert min(stats.kstest(values_of_noise / std, "norm").pvalue for values_of_noise in series) > 1e-4
    assert np.abs(np.corrcoef(series)[np.triu_indices(len(series), 1)]).max() < 4.5 / math.sqrt(n)
    for lag in (1, 2, 7):
        later = [[np.corrcoef(a[lag:], b[:-lag])[0, 1] for a in series] for b in series]
        assert np.abs(later).max() < 4.5 / math.sqrt(n)


def test_noise_is_the_seeds_and_grows_with_its_deviation() -> None:
    noise = {"model": "noise", "std": 1.0}
    first = added([noise], 50, 7)
    assert added([noise], 50, 7).tobytes() == first.tobytes()
    np.testing.assert_array_equal(added([noise | {"std": 0.25}], 50, 7), 0.25 * first)
    assert (added([noise], 50, 8) != first).all()
    assert added([noise | {"std": 0.0}], 50, 7).tobytes() == np.zeros_like(first).tobytes()
    both = added([noise, noise], 50, 7)  # another place, other draws
    assert np.abs(np.corrcoef(first.ravel(), (both - first).ravel())[0, 1]) < 4.0 / math.sqrt(first.size)


def test_noise_is_where_it_is_said_to_be() -> None:
    """In its window, on its PMUs, in its measurement, and there it is what it is everywhere."""
    within = {"start": 0.3, "duration": 0.2, "channels": ["both"], "measurement": "speed_deviation"}
    whole, part = (added([{"model": "noise", "std": 1.0, **more}], 40) for more in ({}, within))
    wanted = np.zeros_like(whole)
    for pmu in (0, 2):
        wanted[DURING, pmu, SPEED] = whole[DURING, pmu, SPEED]
    np.testing.assert_array_equal(part, wanted)


def test_setpoints_have_noise_of_their_own() -> None:
    link, rows = built_links([], [{"model": "noise", "std": 0.1}], 400), np.zeros(DEVICES, SETPOINT)
    rows["device"] = range(DEVICES)
    noise = np.zeros((400, DEVICES))
    for k in range(400):
        rows["issued_ns"] = tick_ns(k, RATE)
        assert downlink(link, 0, k, tick_ns(k + 1, RATE), rows, DEVICES) == DEVICES
        noise[k, link.down.out[0, :DEVICES]["device"]] = link.down.out[0, :DEVICES]["value"]
    assert np.abs(noise.std(axis=0) / 0.1 - 1.0).max() < 4.0 / math.sqrt(800.0)
    assert abs(np.corrcoef(noise.T)[0, 1]) < 4.0 / 20.0


def test_deviation_of_noise_may_be_changed() -> None:
    """From then on, with the draws as they were."""
    link = built_links([{"model": "noise", "std": 1.0}], [], 20)
    whole, before = send(built_links([{"model": "noise", "std": 1.0}], [], 20), 20), send(link, 10)
    more = changed(link.up, 0, 0, one_stage.validate_python({"model": "noise", "std": 3.0}), way_up(20))
    entries, plain = np.concatenate([before, send(link._replace(up=more), 10, 10)]), send(built_links([], [], 20), 20)
    factor = np.where(plain["measured_ns"] < 10 * PERIOD_NS, 1.0, 3.0)[:, None]
    noise = whole["values"] - plain["values"]
    np.testing.assert_allclose(entries["values"] - plain["values"], factor * noise, atol=1e-12)


def test_time_stamps_may_be_wrong() -> None:
    entries = send(built_links([{"model": "spoof", "offset": -0.5, "start": 0.1}], [], 10), 10)
    stamp = np.repeat(np.arange(10) * PERIOD_NS, PMUS)
    np.testing.assert_array_equal(entries["arrival_ns"], stamp)
    np.testing.assert_array_equal(entries["measured_ns"], stamp - np.where(stamp >= to_ns(0.1), to_ns(0.5), 0))


def test_setpoints_are_disturbed_too() -> None:
    link = built_links([], [{"model": "scale", "factor": 0.5, "channels": ["d0"]}, {"model": "bias", "bias": 1.0}], 5)
    rows = np.zeros(2, SETPOINT)
    rows["device"], rows["value"] = [0, 1], [4.0, 4.0]
    assert downlink(link, 0, 0, 1, rows, 2) == 2
    assert link.down.out[0, :2]["value"].tolist() == [3.0, 5.0]


def test_delay_that_is_changed_holds_for_what_is_sent_after() -> None:
    """Also where it needs more room than there was; what is under way arrives as it was sent."""
    link = built_links([{"delay": 0.1}], [{"delay": 0.1}], 100)
    before = send(link, 50)
    longer = changed(link.up, 0, 0, one_stage.validate_python({"delay": 30.0}), way_up(100))
    later = link._replace(up=longer)
    ticks = 50 + 31 * RATE
    table = lateness(np.concatenate([before, send(later, ticks - 50, 50)]), ticks)
    np.testing.assert_allclose(table[:50], 0.1)
    np.testing.assert_allclose(table[50:90], 30.0)
    assert later.up.ring[0, 3] == later.up.statistics[0]["lost"].sum() == 0


def stage(model: str, **fields: Any) -> st.SearchStrategy[dict[str, Any]]:
    some = {"start": st.sampled_from([0.0, 0.0, 0.5]), "duration": st.none() | st.floats(0.01, 1.0)}
    return st.fixed_dictionaries({"model": st.just(model), **some, **fields})


delays, fractions = st.floats(0.0, 1.0), st.floats(0.0, 1.0)
anything = st.one_of(
    stage("constant", delay=delays),
    stage("uniform", low=st.floats(0.0, 0.1), high=st.floats(0.1, 1.0)),
    stage("normal", mean=delays, std=delays),
    stage("gamma", delay=delays, shape=st.floats(0.1, 9.0), scale=st.floats(0.0, 0.2)),
    stage("lognormal", median=st.floats(0.0, 0.3), sigma=st.floats(0.0, 3.0)),
    stage("trace", delays=st.lists(st.none() | delays, min_size=1, max_size=9)),
    stage("bernoulli", loss=fractions),
    stage("gilbert_elliott", p_GB=fractions, p_BG=fractions),
    stage("duplicate", probability=fractions),
    stage("in_order"),
    stage("playout", delay=delays),
    stage("freeze"),
    stage("replay", window=st.floats(0.01, 0.5), start=st.just(0.5)),
    stage("bias", bias=st.floats(-9.0, 9.0)),
    stage("scale", factor=st.floats(-9.0, 9.0)),
    stage("ramp", rate=st.floats(-9.0, 9.0)),
    stage("noise", std=st.floats(0.0, 9.0)),
    stage("spoof", offset=st.floats(-1.0, 1.0)),
)
waits = stage(
    "wait",
    wait=delays,
    reference=st.sampled_from(["first", "stamp"]),
    send=st.sampled_from(["complete", "timeout"]),
    missing=st.sampled_from(["drop", "hold"]),
)


@settings(deadline=None, max_examples=100)
@given(chain=st.lists(anything | waits, max_size=6), down=st.lists(anything, max_size=4), seed=st.integers(0, 2**32))
def test_random_chains_keep_count_and_order(chain: list[dict[str, Any]], down: list[dict[str, Any]], seed: int) -> None:
    """Every entry is delivered, lost or under way; a tick gets what arrives in it, in order, none before it is sent."""
    link, setpoints = built_links(chain, down, 40, seed), np.zeros(DEVICES, SETPOINT)
    setpoints["device"] = range(DEVICES)
    for k in range(60):
        start, end = tick_ns(k, RATE), tick_ns(k + 1, RATE)
        count = uplink(link, 0, k, start, end, values(k), np.full(len(values(k)), start), SOUND)
        setpoints["issued_ns"] = setpoints["measured_ns"] = start
        there = downlink(link, 0, k, end, setpoints, DEVICES)
        for arrival in (link.up.out[0, :count]["arrival_ns"], link.down.out[0, :there]["effective_ns"]):
            assert (np.diff(arrival) >= 0).all()
            assert ((arrival >= start) & (arrival < end)).all()
    for way in (link.up, link.down):
        s = way.statistics[0]
        under_way = s["sent"] + s["duplicated"] + s["held"] - s["delivered"] - s["lost"]
        assert (under_way >= 0).all()
        assert under_way.sum() == way.ring[0, 1]
        assert way.ring[0, 3] == 0
        assert (s["delay_min_ns"][s["delivered"] > 0] >= 0).all()
