"""Time alignment, and ticks of streams that are late, lost, stopped, or of another time."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from facts_damping.signals import CHANNELS
from facts_damping_streams.streaming.stream_clock import AlignedFrame, Alignment, Following, PmuReport

if TYPE_CHECKING:
    from facts_damping_streams.streaming.stream_clock import Tick

RATE, WAIT = 60, 0.2
ONE, SOUND, HERE = np.array([0]), np.zeros(1, np.int64), np.zeros(1, bool)


def rows(pmus: int, value: float) -> np.ndarray[tuple[int, int], np.dtype[np.float64]]:
    return np.full((pmus, len(CHANNELS)), value)


@given(st.permutations([(s, k) for s in range(3) for k in range(5)]))
def test_instants_come_in_their_order_once_all_have_spoken(order: list[tuple[int, int]]) -> None:
    """Whatever the order in which PMUs speak, each instant is given once, with what each has said of it."""
    alignment, aligned = Alignment(3), list[AlignedFrame]()
    alignment.put(-1, PmuReport(np.arange(3), rows(3, 0.0), np.zeros(3, np.int64)))
    assert [frame.instant for frame in alignment.take()] == [-1]
    for s, k in order:
        assert alignment.put(k, PmuReport(np.array([s]), rows(1, 10.0 * k + s), SOUND))
        aligned += alignment.take()
    assert [frame.instant for frame in aligned] == list(range(5))
    for frame in aligned:
        assert frame.there.all()
        assert frame.values[:, 0].tolist() == [10.0 * frame.instant + s for s in range(3)]
    assert alignment.late == 0


@given(st.lists(st.tuples(st.integers(0, 3), st.integers(0, 20)), max_size=60), st.integers(0, 4))
def test_time_alignment_gives_or_counts_every_entry(said: list[tuple[int, int]], waits: int) -> None:
    """Each entry is in what is given, or counted as late."""
    alignment, given_entries, put, newest = Alignment(4), 0, set(), 0
    for s, k in said:
        newest = max(newest, k)
        if alignment.put(k, PmuReport(np.array([s]), rows(1, 1.0), SOUND)):
            put.add((s, k))
        given_entries += sum(int(frame.there.sum()) for frame in alignment.take(newest - waits))
    given_entries += sum(int(frame.there.sum()) for frame in alignment.take(99))
    assert given_entries == len(put)
    assert alignment.late + len(put) <= len(said)


def feed(following: Following, instant: int, now: float) -> list[Tick]:
    following.put(instant, PmuReport(ONE, rows(1, float(instant)), SOUND, HERE), now)
    return list(following.take(now))


def test_ticks_are_the_instants_of_a_stream() -> None:
    following, numbers = Following(1, RATE, WAIT), list[tuple[int, float]]()
    for k in range(100):
        ticks = feed(following, 5000 + k, 10.0 + k / RATE + 0.02 * (k % 3))
        numbers += [(tick.number, tick.frame.values[0, 0]) for tick in ticks if tick.frame is not None]
    assert numbers == [(k, 5000.0 + k) for k in range(100)]
    assert (following.alignment.late, following.moved) == (0, 0)


def test_while_nothing_comes_ticks_go_on_empty_and_then_with_the_stream() -> None:
    following, empty, said = Following(1, RATE, WAIT), list[int](), list[int]()
    for n in range(2 * 60 * 5):
        now = n / 120
        if n % 2 == 0 and not 1.0 <= now < 3.0:
            following.put(n // 2, PmuReport(ONE, rows(1, 0.0), SOUND, HERE), now)
        for tick in following.take(now):
            (empty if tick.frame is None else said).append(tick.number)
    assert sorted(empty + said) == list(range(300))
    assert empty == list(range(60, 180))


def test_pause_of_the_source_moves_its_stamps() -> None:
    """It stops for 4 s and then goes on where it stopped: ticks do not wait, stamps are taken for those of now."""
    following, numbers = Following(1, RATE, WAIT), list[int]()
    for n in range(120 * 12):
        now, k = n / 120, n // 2 if n < 240 else n // 2 - 240
        if n % 2 == 0 and not 2.0 <= now < 6.0:
            following.put(k, PmuReport(ONE, rows(1, float(k)), SOUND, HERE), now)
        numbers += [tick.number for tick in following.take(now) if tick.frame is not None]
    assert following.moved == 1
    assert numbers == sorted(set(numbers))
    assert numbers[-1] > 700
    assert 60 <= following.alignment.late <= 70  # those of a second, until that is known


def test_burst_after_a_stall_is_late_and_does_not_move_the_clock() -> None:
    """A connection stands still for 3 s; then all comes at once, and after that in time."""
    following, numbers = Following(1, RATE, WAIT), list[tuple[int, float]]()
    for n in range(120 * 8):
        now = n / 120
        come = [n // 2] if n % 2 == 0 and not 2.0 <= now < 5.0 else []
        for k in range(120, 301) if n == 600 else come:
            following.put(k, PmuReport(ONE, rows(1, float(k)), SOUND, HERE), now)
        numbers += [(tick.number, tick.frame.values[0, 0]) for tick in following.take(now) if tick.frame is not None]
    assert following.moved == 0
    assert all(number == instant for number, instant in numbers)
    assert numbers[-1][0] == 479


def test_stamps_of_another_time_are_taken_for_those_of_now() -> None:
    """A source that begins anew, an hour later or earlier."""
    for jump in (3600 * RATE, -3600 * RATE):
        following, numbers = Following(1, RATE, WAIT), list[int]()
        for k in range(300):
            ticks = feed(following, 10**6 + k + (jump if k >= 100 else 0), k / RATE)
            numbers += [tick.number for tick in ticks if tick.frame is not None]
        assert following.moved == 1
        assert 299 - WAIT * RATE - 2 < numbers[-1] <= 299  # it goes on with the first tick that was not over
        assert len(ticks) < 5


def test_instants_before_the_first_one_are_late_and_shift_no_tick() -> None:
    following = Following(2, RATE, WAIT)
    for instant in (100, *range(50, 100), 101):
        following.put(instant, PmuReport(np.arange(2), rows(2, instant), np.zeros(2, np.int64)), 0.0)
    ticks = [(tick.number, tick.frame.instant) for tick in following.take(0.0) if tick.frame is not None]
    assert ticks == [(0, 100), (1, 101)]
    assert following.alignment.late == 100


def test_stream_that_is_alone_out_of_time_moves_nothing() -> None:
    following = Following(2, RATE, WAIT)
    for k in range(200):
        following.put(k, PmuReport(ONE, rows(1, 0.0), SOUND, HERE), k / RATE)
        following.put(k - 600, PmuReport(np.array([1]), rows(1, 0.0), SOUND, HERE), k / RATE)
        list(following.take(k / RATE))
    assert following.moved == 0
    assert following.alignment.late > 150


def test_station_that_says_that_it_is_absent_is_not_waited_for() -> None:
    following = Following(2, RATE, WAIT)
    following.put(7, PmuReport(np.arange(2), rows(2, 1.0), np.zeros(2, np.int64), np.array([False, True])), 0.0)
    (tick,) = following.take(0.0)
    assert tick.frame is not None
    assert tick.frame.there.tolist() == [True, False]
