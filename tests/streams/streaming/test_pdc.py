"""A run's PMUs as instants: as reported, behind a link, with clocks that lose the time; there and back to the bits."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest

from facts_damping.case.loading import load_case
from facts_damping.signals import DELIVERY, NANOSECONDS, NEVER
from facts_damping.simulation import loop
from facts_damping_streams.c37118 import data, mapping, session, stat
from facts_damping_streams.c37118.session import Instant, Receiver
from facts_damping_streams.streaming import recorded, serving
from facts_damping_streams.streaming.pdc import Pdc, grid_pmus
from facts_damping_streams.streaming.serving import Serving

if TYPE_CHECKING:
    from facts_damping.record import Record

EPOCH = 1_700_000_000
NAME = "two_area_large"


def through(sets: list[str], formats: str | None, link: int | None = None) -> tuple[Record, list[Instant]]:
    """A run's record, and what a client receives of it."""
    case = load_case(NAME, sets)
    record = loop.run(case)
    (server,) = serving.servers(case, Serving("", 0, [], 1, formats, each=False), lambda: (0, 0))
    pdc, receiver = Pdc(case, EPOCH, None if link is None else 1.0), Receiver(1)
    receiver.take(session.answers(server.stream, "send_configuration_3", 0, 0))
    sent = [session.data_frame(server.stream, sent_instant) for _, sent_instant in recorded.instants(record, pdc, link)]
    return record, [content for content in receiver.take(sent) if isinstance(content, Instant)]


def number(instant: Instant) -> int:
    return (instant.soc - EPOCH) * 60 + round(instant.fraction * 60 / 1e6)


def test_integers_are_those_that_pmus_of_integers_report() -> None:
    """`quantisation: int16` has the counts of the stream's integers: what arrives is what was measured."""
    sets = ["duration=3", "measurement=p_class", "measurement.quantisation=int16", "controllers=[]"]
    record, instants = through(sets, "polar")
    case = load_case(NAME, sets)
    (server,) = serving.servers(case, Serving("", 0, [], 1, "polar", each=False), lambda: (0, 0))
    where = mapping.places(server.stream.configuration, grid_pmus(case), {})
    assert len(instants) == 179
    for instant in instants:
        values, status, absent = mapping.values_of(where, instant.data)
        k = number(instant) + 1  # the tick in which it was reported
        wanted = record.frames[k]
        step = case.measurement.voltage_range / 65535, case.measurement.current_range / 65535
        np.testing.assert_allclose(values[:, [1, 5, 6, 8]], wanted[:, [1, 5, 6, 8]], atol=1e-9)
        np.testing.assert_allclose(values[:, 0], wanted[:, 0], atol=step[0])
        np.testing.assert_allclose(values[:, 7], wanted[:, 7], atol=step[1])
        assert not status.any()
        assert not absent.any()


def test_behind_a_link_frames_are_aligned_again() -> None:
    """Entries of each PMU late by its own time, some lost: each is in the instant that it describes, or absent."""
    link = (
        "{up: [{stage: network, model: uniform, low: 0.0, high: 0.05}, {stage: network, model: bernoulli, loss: 0.1}]}"
    )
    sets = ["duration=4", f"link={link}"]
    record, instants = through(sets, None, link=0)
    case = load_case(NAME, sets)
    (server,) = serving.servers(case, Serving("", 0, [], 1, None, each=False), lambda: (0, 0))
    where = mapping.places(server.stream.configuration, grid_pmus(case), {})
    rows = record.delivered
    numbers = np.rint(rows["measured_ns"] * 60 / NANOSECONDS).astype(int)
    assert [number(instant) for instant in instants] == sorted(set(numbers[numbers <= number(instants[-1])].tolist()))
    assert len(np.unique(rows["tick"][numbers == 30])) > 1  # they arrived in several ticks
    gone = 0
    for instant in instants[:-1]:
        values, _, absent = mapping.values_of(where, instant.data)
        entries = rows[numbers == number(instant)]
        assert sorted(set(entries["pmu"].tolist())) == np.flatnonzero(~absent).tolist()
        gone += int(absent.sum())
        for row in entries:
            np.testing.assert_allclose(values[row["pmu"]], row["values"], rtol=1e-6, atol=1e-9)
    assert gone > 0


def test_clock_that_is_off_by_more_than_half_a_frame_costs_no_frame() -> None:
    """Of two PMUs; the stamp is that of a frame all the same."""
    case = load_case("lead_lag_smib", ["duration=2", "measurement.pmus.G1={clock: {offset: 0.01}}", "controllers=[]"])
    instants = [instant for _, instant in recorded.instants(loop.run(case), Pdc(case, EPOCH))]
    assert len(instants) == 120
    assert len({(instant.soc, instant.fraction) for instant in instants}) == 120


@pytest.mark.parametrize("formats", ["none", "polar", "float_phasors", "polar,float_phasors", None])
def test_absent_pmu_is_absent_in_every_format(formats: str | None) -> None:
    case = load_case(NAME, [])
    (server,) = serving.servers(case, Serving("", 0, [], 1, formats, each=False), lambda: (0, 0))
    row = np.zeros(1, DELIVERY)
    row["pmu"], row["values"] = 3, 0.5
    (instant,) = Pdc(case, EPOCH).take(0, row)
    receiver = Receiver(1)
    receiver.take(session.answers(server.stream, "send_configuration_2", 0, 0))
    (received,) = receiver.take([session.data_frame(server.stream, instant)])
    assert isinstance(received, Instant)
    where = mapping.places(server.stream.configuration, grid_pmus(case), {})
    values, _, absent = mapping.values_of(where, received.data)
    assert absent.tolist() == [True, True, True, False, True]
    assert np.isnan(values[0]).all()


def test_late_measurement_is_left_out_and_counted() -> None:
    case = load_case(NAME, [])
    pdc = Pdc(case, EPOCH, 0.1)

    def rows(*of: tuple[int, int]) -> np.ndarray[tuple[int], np.dtype[np.void]]:
        entries = np.zeros(len(of), DELIVERY)
        for row, (pmu, k) in zip(entries, of, strict=True):
            row["pmu"], row["measured_ns"] = pmu, k * NANOSECONDS // 60
        return entries

    assert pdc.take(0, rows((0, 0), (1, 0))) == []
    (instant,) = pdc.take(6, rows((2, 1)))
    assert instant.data.status.tolist() == [0, 0, *[0x8000] * 3]
    assert pdc.take(6, rows((2, 0))) == []
    assert pdc.alignment.late == 1


def test_clocks_that_lose_the_time_say_so() -> None:
    """From 1 s on G2 drifts by 1 us/s: unsynchronised, with the quality that follows; the others are sound."""
    sets = ["duration=13", "controllers=[]", "measurement.pmus.G2={clock: {lost: 1.0, drift: 1.0e-6}}"]
    _, instants = through(sets, None)
    for instant in instants:
        for_s = number(instant) / 60 - 1.0
        words = instant.data.status.tolist()
        assert words[0] == words[2] == 0
        if for_s < -0.01:
            assert (words[1], instant.quality) == (0, 0)
        elif min(abs(for_s - edge) for edge in (0.0, 0.1, 1.0, 10.0)) > 0.01:
            assert words[1] & 0x2000
            assert words[1] >> 4 & 3 == (1 if for_s >= 10.0 else 0)
            assert words[1] >> 6 & 7 == (1 if for_s < 0.1 else 2 if for_s < 1.0 else 3 if for_s < 10.0 else 4)
            error_s = for_s * 1e-6
            assert 10.0 ** (instant.quality - 11) < error_s * 1.001
            assert error_s < 1.001 * 10.0 ** (instant.quality - 10)


def test_bad_data_are_data_errors_not_absences() -> None:
    sets = ["duration=2", "controllers=[]", "measurement=p_class"]
    bad = "measurement.bad_data=[{kind: invalid, pmus: [G3], start: 0.5, duration: 0.5}]"
    record, instants = through([*sets, bad], None)
    for instant in instants:
        wrong = 30 <= number(instant) < 60
        assert instant.data.status[2] >> 14 == (stat.DO_NOT_USE if wrong else 0)
        assert np.isnan(instant.data.phasors[4]).all() == wrong
    assert (record.measured_ns[1:] != NEVER).all()
    assert isinstance(instants[0].data, data.Data)


@pytest.mark.parametrize(("each", "names"), [(False, 1), (True, 5)])
def test_servers_have_one_stream_or_one_for_each_station(each: bool, names: int) -> None:
    built = serving.servers(load_case(NAME, []), Serving("", 0, [], 40, None, each=each), lambda: (0, 0))
    assert [server.stream.idcode for server in built] == list(range(40, 40 + names))
    assert sum(len(server.stream.configuration.pmus) for server in built) == 5
