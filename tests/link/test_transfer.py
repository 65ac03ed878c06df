from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from facts_damping.link.chain import DirectionSpec, longest_delay_ns
from facts_damping.link.transfer import Links, downlink, links, merge, uplink
from facts_damping.parameters.link import Link
from facts_damping.parameters.stages import Constant, Wait
from facts_damping.signals import CHANNELS, DELIVERY, NEVER, SETPOINT, to_ns
from facts_damping.simulation.measured_plant import tick_ns

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

PMUS, DEVICES, TICKS = 3, 2, 40
SOUND = np.zeros(PMUS, np.int64)  # status of entries
MS = 1_000_000  # ns
some = settings(deadline=None, max_examples=25)
rates = st.integers(1, 1000)
nanoseconds = st.integers(0, 2_000_000_000)


def stages(*delays_ns: int) -> list[Any]:
    return [Constant(delay=d * 1e-9) for d in delays_ns]


def ways(rate: int, commands: int) -> tuple[DirectionSpec, DirectionSpec]:
    """PMUs s0, s1, ... and devices d0, d1, ..."""
    pmus, devices = [f"s{i}" for i in range(PMUS)], [f"d{i}" for i in range(DEVICES)]
    up = DirectionSpec(pmus, {}, len(CHANNELS), PMUS, rate, TICKS, (0, 0))
    return up, DirectionSpec(devices, {}, 1, 2 * commands, rate, TICKS, (0, 1))


class Sent(NamedTuple):
    """What a direction was given, and what it delivered, each entry with the number of its tick."""

    way: Any
    given: NDArray[Any]
    delivered: NDArray[Any]
    ticks: int


def alone(up: Sequence[Any], down: Sequence[Any], per_tick: int, rate: int) -> Links:
    """A link by itself, used by one controller, with room for `per_tick` setpoints."""
    return links([Link(up=list(up), down=list(down))], [0], *ways(rate, per_tick))


def send_up(delays_ns: Sequence[int], rate: int, ticks: int = TICKS) -> Sent:
    """Frames through a chain; each value says tick, PMU and channel."""
    link = alone(stages(*delays_ns), [], 1, rate)
    way = link.up.each[0]
    frames, out = [], []
    for k in range(ticks):
        start, end = tick_ns(k, rate), tick_ns(k + 1, rate)
        frame = k + 0.1 * np.arange(PMUS)[:, None] + 0.01 * np.arange(len(CHANNELS))
        entries = np.zeros(PMUS, DELIVERY)
        entries["pmu"], entries["measured_ns"], entries["values"] = np.arange(PMUS), start, frame
        frames.append(entries)
        count = uplink(link, 0, k, start, end, frame, np.full(len(frame), start), SOUND)
        assert count == way.ring[2]
        out.append(way.out[:count].copy())
        assert (out[-1]["tick"] == k).all()
        assert (out[-1]["arrival_ns"] < end).all()
    return Sent(way, np.concatenate(frames), np.concatenate(out), ticks)


def send_down(delays_ns: Sequence[int], issued_ns: Sequence[int], rate: int, ticks: int = TICKS) -> Sent:
    """Setpoints, each issued at its own instant, in the tick that holds it; values count them."""
    link = alone([], stages(*delays_ns), len(issued_ns), rate)
    way = link.down.each[0]
    setpoints = np.zeros(len(issued_ns), SETPOINT)
    setpoints["issued_ns"] = setpoints["effective_ns"] = np.sort(issued_ns)
    setpoints["device"], setpoints["value"] = np.arange(len(setpoints)) % DEVICES, np.arange(len(setpoints))
    out = []
    for k in range(ticks):
        start, end = tick_ns(k, rate), tick_ns(k + 1, rate)
        due = setpoints[(setpoints["issued_ns"] >= start) & (setpoints["issued_ns"] < end)]
        count = downlink(link, 0, k, end, due, len(due))
        out.append(way.out[:count].copy())
        assert (out[-1]["tick"] == k).all()
        assert ((out[-1]["effective_ns"] < end) & (out[-1]["effective_ns"] >= start)).all()
    return Sent(way, setpoints[setpoints["issued_ns"] < tick_ns(ticks, rate)], np.concatenate(out), ticks)


def check_statistics(sent: Sent, channel_of: str, delay_ns: int) -> None:
    """Sent = delivered + under way + lost, a channel each; the delays are those of the chain."""
    way, under_way = sent.way, sent.way.ring[1]
    head = way.ring[0]
    waiting = [way.entries[(head + i) % len(way.entries)][channel_of] for i in range(under_way)]
    for channel, s in enumerate(way.statistics):
        assert s["sent"] == (sent.given[channel_of] == channel).sum()
        assert s["delivered"] == (sent.delivered[channel_of] == channel).sum()
        assert s["lost"] == 0
        assert s["sent"] == s["delivered"] + waiting.count(channel)
        assert s["delay_sum_ns"] == delay_ns * s["delivered"]
        if s["delivered"]:
            assert s["delay_min_ns"] == s["delay_max_ns"] == delay_ns


@some
@given(rate=rates, delay=nanoseconds)
@example(rate=60, delay=0)
def test_delay_shifts_every_entry_by_itself(rate: int, delay: int) -> None:
    """To the nanosecond, whatever the frames; nothing lost, nothing twice, in order."""
    sent = send_up([delay], rate)
    n = len(sent.delivered)
    np.testing.assert_array_equal(sent.delivered["arrival_ns"], sent.given["measured_ns"][:n] + delay)
    for name in ("pmu", "measured_ns", "values"):
        np.testing.assert_array_equal(sent.delivered[name], sent.given[name][:n])
    assert n == (sent.given["measured_ns"] + delay < tick_ns(TICKS, rate)).sum()
    tick_of = [next(k for k in range(TICKS) if t < tick_ns(k + 1, rate)) for t in sent.delivered["arrival_ns"]]
    assert sent.delivered["tick"].tolist() == tick_of
    check_statistics(sent, "pmu", delay)


@some
@given(rate=rates, delays=st.lists(st.integers(0, 500_000_000), max_size=5))
@example(rate=60, delays=[])
def test_chain_delays_by_the_sum_of_its_stages(rate: int, delays: list[int]) -> None:
    chained, single = send_up(delays, rate), send_up([sum(delays)], rate)
    np.testing.assert_array_equal(chained.delivered, single.delivered)
    assert longest_delay_ns(alone(stages(*delays), [], 1, rate).up.chain) == sum(delays)


@some
@given(rate=st.integers(5, 1000), delay=nanoseconds, data=st.data())
def test_setpoints_go_down_as_frames_go_up(rate: int, delay: int, data: st.DataObject) -> None:
    """Each from its own instant of issue, not from its tick's."""
    end = tick_ns(TICKS, rate) - 1
    issued = data.draw(st.lists(st.integers(0, end), max_size=20))
    sent = send_down([delay], issued, rate)
    n = len(sent.delivered)
    assert n == (sent.given["issued_ns"] + delay <= end).sum()
    np.testing.assert_array_equal(sent.delivered["effective_ns"], sent.given["issued_ns"][:n] + delay)
    for name in ("device", "value", "issued_ns"):
        np.testing.assert_array_equal(sent.delivered[name], sent.given[name][:n])
    check_statistics(sent, "device", delay)


@some
@given(issued=st.lists(st.integers(0, 999_999_999), min_size=1, max_size=12), delay=st.integers(0, 400_000_000))
def test_setpoints_issued_in_any_order_are_delivered_by_arrival(issued: list[int], delay: int) -> None:
    """Setpoints of several controllers come in any order of issue: out by arrival, first come first at one instant."""
    link = alone([], stages(delay), len(issued), 60)
    (out,) = link.down.out
    setpoints = np.zeros(len(issued), SETPOINT)
    setpoints["issued_ns"], setpoints["value"] = issued, np.arange(len(issued))
    assert downlink(link, 0, 0, delay, setpoints, len(setpoints)) == 0
    count = downlink(link, 0, 1, 1_000_000_000 + delay, setpoints, 0)
    order = np.argsort(issued, kind="stable")
    np.testing.assert_array_equal(out[:count]["value"], order)
    np.testing.assert_array_equal(out[:count]["effective_ns"], np.array(issued)[order] + delay)
    assert downlink(link, 0, 2, 5_000_000_000, setpoints, 0) == 0


def test_entry_that_arrives_on_a_boundary_belongs_to_the_tick_that_starts() -> None:
    rate = 50
    sent = send_up([20_000_000], rate, 3)
    assert sent.delivered["tick"].tolist() == [1] * PMUS + [2] * PMUS
    early = send_up([19_999_999], rate, 3)
    assert early.delivered["tick"].tolist() == [k for k in range(3) for _ in range(PMUS)]


def test_ring_goes_round_many_times() -> None:
    """The queue holds a second's worth and more: here ten times its size goes through."""
    rate, delay = 100, 50_000_000
    sent = send_up([delay], rate, 1200)
    assert len(sent.given) > 10 * len(sent.way.entries)
    np.testing.assert_array_equal(sent.delivered["values"], sent.given["values"][: len(sent.delivered)])
    check_statistics(sent, "pmu", delay)


def test_setpoint_that_finds_the_link_full_is_counted_as_lost() -> None:
    """Sent = delivered + under way + lost, and those that are there arrive."""
    link = alone([], stages(to_ns(1.0)), 1, 10)
    way = link.down.each[0]
    room = len(way.entries)
    setpoints = np.zeros(room + 7, SETPOINT)
    setpoints["value"] = np.arange(len(setpoints))
    assert downlink(link, 0, 0, 1, setpoints, len(setpoints)) == 0
    s = way.statistics[0]
    assert (s["sent"], s["delivered"], s["lost"], way.ring[1]) == (room + 7, 0, 7, room)
    count = downlink(link, 0, 1, to_ns(2.0), setpoints, 0)
    assert way.out[:count]["value"].tolist() == list(range(room))
    assert (s["delivered"], way.ring[1]) == (room, 0)


@pytest.mark.parametrize("delay", [0.0, 0.1, 60.0])
def test_directions_have_room_for_the_longest_delay(delay: float) -> None:
    """Every tick full, for as long as entries are under way."""
    built = links([Link(up=[Constant(delay=delay)], down=[Constant(delay=delay)])], [0], *ways(30, 2))
    up, down = built.up.each[0], built.down.each[0]
    frame, setpoints = np.zeros((PMUS, len(CHANNELS))), np.zeros(4, SETPOINT)
    for k in range(round(delay * 30) + 60):
        start, end = tick_ns(k, 30), tick_ns(k + 1, 30)
        setpoints["issued_ns"] = start
        uplink(built, 0, k, start, end, frame, np.full(len(frame), start), SOUND)
        downlink(built, 0, k, end, setpoints, len(setpoints))
    assert up.statistics["lost"].sum() == down.statistics["lost"].sum() == 0
    assert up.statistics["delivered"].min() > 0
    assert len(up.statistics) == PMUS
    assert len(down.statistics) == DEVICES


def test_directions_do_not_share_their_state() -> None:
    up, down, _ = alone([Constant(delay=0.02)], [Constant(delay=0.03)], 1, 60)
    assert (longest_delay_ns(up.chain), longest_delay_ns(down.chain)) == (20_000_000, 30_000_000)
    assert (up.entries.dtype, down.entries.dtype) == (DELIVERY, SETPOINT)


class Several(NamedTuple):
    """Delays (up, down) of links in ns, by stages; the link that each controller uses; setpoints as issued."""

    chains: list[tuple[list[int], list[int]]]
    used: list[int]
    issued: list[tuple[int, int]]  # (controller, ns)
    rate: int


@st.composite
def several(draw: st.DrawFn) -> Several:
    delays = st.lists(st.sampled_from([0, 1, 16_666_667, 100_000_000, 123_400_000]), max_size=3)
    chains = draw(st.lists(st.tuples(delays, delays), min_size=1, max_size=4))
    used = draw(st.lists(st.integers(0, len(chains) - 1), min_size=1, max_size=5))
    rate = draw(st.sampled_from([7, 60, 1000]))
    end = tick_ns(TICKS, rate) - 1
    instants = st.sampled_from([0, end // 3, end // 2]) | st.integers(0, end)
    issued = draw(st.lists(st.tuples(st.integers(0, len(used) - 1), instants), max_size=20))
    return Several(chains, used, sorted(issued, key=lambda pair: pair[1]), rate)


def through(case: Several, order: Sequence[int]) -> list[tuple[NDArray[Any], NDArray[Any]]]:
    """What all links deliver, up and (merged) down, tick by tick; the links are served in an order."""
    built = links(
        [Link(up=stages(*up), down=stages(*down)) for up, down in case.chains],
        case.used,
        *ways(case.rate, max(len(case.issued), 1)),
    )
    setpoints = np.zeros(len(case.issued), SETPOINT)
    setpoints["controller"], setpoints["issued_ns"] = np.array(case.issued, np.int64).reshape(-1, 2).T
    setpoints["value"] = np.arange(len(setpoints))
    table, by_tick = np.zeros(built.down.out.size, SETPOINT), []
    for k in range(TICKS):
        start, end = tick_ns(k, case.rate), tick_ns(k + 1, case.rate)
        due = setpoints[(setpoints["issued_ns"] >= start) & (setpoints["issued_ns"] < end)]
        for link in order:
            uplink(built, link, k, start, end, np.full((PMUS, len(CHANNELS)), float(k)), np.full(PMUS, start), SOUND)
            downlink(built, link, k, end, due, len(due))
        count, up = 0, []
        for link in range(len(case.chains)):
            up.append(built.up.out[link, : built.up.ring[link, 2]].copy())
            count = merge(table, count, built.down.out[link], built.down.ring[link, 2])
        by_tick.append((np.concatenate(up), table[:count].copy()))
    assert built.up.statistics["lost"].sum() == built.down.statistics["lost"].sum() == 0
    return by_tick


@some
@given(case=several(), data=st.data())
def test_links_side_by_side_deliver_what_each_delivers_alone(case: Several, data: st.DataObject) -> None:
    """Whatever the others are, and whichever is served first."""
    order = data.draw(st.permutations(range(len(case.chains))))
    whole = through(case, order)
    for link, chains in enumerate(case.chains):
        setpoints_of_link = [issued for issued in case.issued if case.used[issued[0]] == link]
        values = [i for i, issued in enumerate(case.issued) if case.used[issued[0]] == link]
        by_itself = through(Several([chains], [0] * len(case.used), setpoints_of_link, case.rate), [0])
        for (up, down), (up_alone, down_alone) in zip(whole, by_itself, strict=True):
            down_alone["value"], up_alone["link"] = [values[int(v)] for v in down_alone["value"]], link
            np.testing.assert_array_equal(up[up["link"] == link], up_alone)
            np.testing.assert_array_equal(down[np.isin(down["value"], values)], down_alone)


@some
@given(case=several())
def test_setpoints_of_all_links_are_ordered_by_time_then_by_link(case: Several) -> None:
    """Each setpoint once, as late as its own link is long; the plant takes them as they stand."""
    setpoints = np.concatenate([down for _, down in through(case, range(len(case.chains)))])
    link = np.array(case.used)[setpoints["controller"]]
    late = np.array([sum(down) for _, down in case.chains])[link]
    np.testing.assert_array_equal(setpoints["effective_ns"], setpoints["issued_ns"] + late)
    order = np.lexsort((setpoints["value"], link, setpoints["effective_ns"]))
    np.testing.assert_array_equal(order, np.arange(len(setpoints)))
    by_time = {
        i for i, (c, ns) in enumerate(case.issued) if ns + sum(case.chains[case.used[c]][1]) < tick_ns(TICKS, case.rate)
    }
    assert sorted(setpoints["value"]) == sorted(by_time)


def test_merged_table_keeps_what_was_there_before_what_comes_at_the_same_time() -> None:
    table, count = np.zeros(6, SETPOINT), 0
    for value, times in ((1.0, [10, 20, 20]), (2.0, [5, 20, 30])):
        rows = np.zeros(3, SETPOINT)
        rows["effective_ns"], rows["value"] = times, value
        count = merge(table, count, rows, 3)
    assert count == 6
    assert table["effective_ns"].tolist() == [5, 10, 20, 20, 20, 30]
    assert table["value"].tolist() == [2.0, 1.0, 1.0, 1.0, 2.0, 2.0]


def test_stages_that_fill_up_a_chain_do_not_delay() -> None:
    short, long = Link(up=[Constant(delay=0.02)]), Link(up=[Constant(delay=0.01)] * 4, down=[Constant(delay=0.5)])
    built = links([short, long], [0, 1], *ways(60, 1))
    assert built.up.chain.rows.shape == (2, 4)
    arrived: list[list[int]] = [[], []]
    for k in range(6):
        for link in range(2):
            count = uplink(
                built,
                link,
                k,
                tick_ns(k, 60),
                tick_ns(k + 1, 60),
                np.zeros((PMUS, len(CHANNELS))),
                np.full(PMUS, tick_ns(k, 60)),
                SOUND,
            )
            out = built.up.out[link, :count]
            arrived[link] += (out["arrival_ns"] - out["measured_ns"]).tolist()
    assert [set(arrivals) for arrivals in arrived] == [{20_000_000}, {40_000_000}]


def test_absent_station_stays_absent_and_others_keep_their_own_stamps() -> None:
    """As in frames of a data concentrator that waits for nobody: of PMU 1 there is none, 2 measured earlier."""
    link = alone(stages(MS), [], 1, 100)
    frame = np.arange(PMUS * len(CHANNELS), dtype=np.float64).reshape(PMUS, len(CHANNELS))
    measured = np.array([10 * MS, NEVER, 7 * MS], np.int64)
    frame[1] = np.nan
    count = uplink(link, 0, 1, 10 * MS, 20 * MS, frame, measured, np.array([0, 0, 8192]))
    out = link.up.out[0, :count]
    assert out["pmu"].tolist() == [0, 2]
    assert out["measured_ns"].tolist() == [10 * MS, 7 * MS]
    assert out["status"].tolist() == [0, 8192]
    assert out["arrival_ns"].tolist() == [11 * MS, 11 * MS]
    assert link.up.statistics[0]["sent"].tolist() == [1, 0, 1]


def test_value_held_for_an_absent_station_has_the_current_stamp() -> None:
    link = alone([Wait(wait=0.002, missing="hold", model="wait")], [], 1, 100)
    frame = np.full((PMUS, len(CHANNELS)), 5.0)
    assert uplink(link, 0, 0, 0, 10 * MS, frame, np.zeros(PMUS, np.int64), SOUND) == PMUS
    absent = np.array([10 * MS, NEVER, 10 * MS], np.int64)
    count = uplink(link, 0, 1, 10 * MS, 20 * MS, frame + 1.0, absent, SOUND)
    out = link.up.out[0, :count]
    (held,) = out[out["pmu"] == 1]
    assert held["measured_ns"] == 10 * MS
    assert np.all(held["values"] == 5.0)
