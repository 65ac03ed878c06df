"""The streams of a run: PMUs in several of them, configurations that change or do not fit, and hostile ones."""

from __future__ import annotations

from binascii import crc_hqx
from typing import Any

import numpy as np
import pytest

from facts_damping.case.loading import load_case
from facts_damping.errors import InputError
from facts_damping.signals import CHANNELS
from facts_damping_streams.c37118 import frame, session, system_pmus
from facts_damping_streams.c37118.configuration import FORMATS, Configuration
from facts_damping_streams.c37118.session import Instant, Receiver
from facts_damping_streams.parameters import Streams
from facts_damping_streams.streaming.client import Lost
from facts_damping_streams.streaming.pdc import grid_pmus
from facts_damping_streams.streaming.server import Server
from facts_damping_streams.streaming.sources import Sources
from facts_damping_streams.streaming.stream_clock import JUMP_S

CASE = load_case("two_area_large", [])
GRID = grid_pmus(CASE)  # G1 to G4, TIE
FLOATS = dict.fromkeys(FORMATS, True)
SOUTH, NORTH = "tcp://south:4712/1", "tcp://north:4712/2"


def stream(places: list[int], rate: int = 60, nominal: int = 60) -> session.Stream:
    return session.stream(1, system_pmus.configuration([GRID[i] for i in places], rate, nominal, FLOATS))


def instant(places: list[int], k: int) -> Instant:
    values = np.full((len(places), len(CHANNELS)), 0.5)
    values[:, system_pmus.MAGNITUDE] = [1.0 + i for i in places]
    pmus = [GRID[i] for i in places]
    return Instant(
        100 + k // 60, k % 60 * 1_000_000 // 60, 0, system_pmus.to_data(pmus, values, np.zeros(len(pmus), int))
    )


def sources(*servers: str, **more: Any) -> Sources:
    return Sources(CASE, Streams.model_validate({"servers": list(servers), **more}))


def rows(source: Sources, now_s: float) -> list[list[tuple[int, int, float]]]:
    """PMU, time and voltage of the entries of each tick."""
    rows = [source.rows(tick, tick.number * 10**9 // 60) for tick in source.following.take(now_s)]
    return [
        [(int(entry["pmu"]), int(entry["measured_ns"]), round(float(entry["values"][0]), 6)) for entry in tick]
        for tick in rows
    ]


def test_stations_of_several_servers_are_one_frame() -> None:
    source = sources(SOUTH, NORTH)
    assert source.take(0, 0.0, stream([0, 1]).configuration) == f"{SOUTH}: 2 PMUs, 60 frames/s; PMUs: G1, G2"
    source.take(1, 0.0, stream([2, 3]).configuration)
    assert source.flaws() == ["absent: G1, G2, G3, G4", "in no stream: TIE"]
    source.take(0, 0.01, instant([0, 1], 0))
    assert rows(source, 0.01) == []
    source.take(1, 0.05, instant([2, 3], 0))
    assert rows(source, 0.05) == [[(0, 0, 1.0), (1, 0, 2.0), (2, 0, 3.0), (3, 0, 4.0)]]
    source.take(0, 0.06, instant([0, 1], 1))
    assert rows(source, 0.3)[0] == [(0, 16666666, 1.0), (1, 16666666, 2.0)]
    assert source.flaws() == ["absent: G1, G2, G3, G4", "in no stream: TIE"]


def test_server_that_is_lost_is_told_once_and_is_back_with_its_configuration() -> None:
    source = sources(SOUTH)
    assert source.take(0, 0.0, Lost("refused")) == f"{SOUTH}: refused"
    assert source.take(0, 1.0, Lost("refused")) == ""
    assert f"{SOUTH}: refused" in source.flaws()
    before = source.unknown()
    source.take(0, 2.0, stream([0]).configuration)
    assert (before, source.unknown()) == (True, False)
    assert f"{SOUTH}: refused" not in source.flaws()
    source.take(0, 3.0, Lost("closed"))
    assert source.take(0, 4.0, stream([0]).configuration) == f"{SOUTH}: is back"


def test_server_that_is_lost_is_not_waited_for() -> None:
    source = sources(SOUTH, NORTH)
    source.take(0, 0.0, stream([0]).configuration)
    source.take(1, 0.0, stream([1]).configuration)
    source.take(1, 0.0, Lost("closed"))
    source.take(0, 0.0, instant([0], 0))
    assert rows(source, 0.0) == [[(0, 0, 1.0)]]
    assert "absent: G2" in source.flaws()


def test_stations_that_are_not_there_or_there_twice_are_said() -> None:
    with pytest.raises(InputError, match=r"pmus: 'G9' given.*; allowed: G1, G2"):
        sources(SOUTH, pmus={"G9": {"pmu": 3}})
    source = sources(SOUTH, NORTH)
    source.take(0, 0.0, stream([0, 1]).configuration)
    message = source.take(1, 0.0, stream([1, 2]).configuration)
    assert f"{NORTH}: PMU G2: in this stream and in {SOUTH}; allowed: each PMU in one" in message


def test_time_that_cannot_be_relied_on_is_unsynchronised() -> None:
    source = sources(SOUTH)
    source.take(0, 0.0, stream([0]).configuration)
    source.take(0, 0.0, instant([0], 0)._replace(quality=0x2F))
    (tick,) = source.following.take(0.0)
    assert source.rows(tick, 0)["status"].tolist() == [0x2000]


@pytest.mark.parametrize(
    ("other", "message"),
    [
        (stream([0], rate=30), "DATA_RATE: 30 frames/s given; allowed: 60, the run's frame_rate"),
        (stream([0], nominal=50), "FNOM: 50 Hz given by G1; allowed: 60 Hz, the system's"),
    ],
)
def test_configuration_that_does_not_fit_takes_its_stations_away(other: session.Stream, message: str) -> None:
    source = sources(SOUTH)
    source.take(0, 0.0, stream([0]).configuration)
    wrong = [source.wrong]
    assert message in source.take(0, 0.0, other.configuration)
    assert [*wrong, source.wrong] == [False, True]
    source.take(0, 0.0, instant([0], 0))
    assert source.following.first is None
    source.take(0, 0.0, stream([0]).configuration)
    source.take(0, 0.0, instant([0], 0))
    assert rows(source, 0.0) == [[(0, 0, 1.0)]]


def test_message_about_a_server_is_one_line_whatever_its_names_are() -> None:
    pmus = stream([0, 1]).configuration.pmus
    hostile = pmus[1]._replace(name="\x1b[31m\nERROR\n" + 2000 * "n", nominal_hz=50)
    text = sources(SOUTH).take(0, 0.0, Configuration((pmus[0], hostile), 60))
    assert text.isprintable()
    assert len(text) < 1300


def test_messages_about_a_server_are_few_and_the_others_counted() -> None:
    source = sources(SOUTH)
    turns = [stream([0]).configuration, stream([1]).configuration]
    texts = [source.take(0, 0.1 * k, turns[k % 2]) for k in range(100)]
    assert sum(map(bool, texts)) == source.counts()["omitted_messages"] // 9 == 10
    assert source.take(0, 100.0, Lost("refused"))


def test_group_delay_of_configuration_3_puts_ticks_behind_stamps() -> None:
    late = stream([0]).configuration
    pmus = tuple(pmu._replace(site=pmu.site._replace(group_delay_us=100_000)) for pmu in late.pmus)
    source = sources(SOUTH)
    hours = tuple(pmu._replace(site=pmu.site._replace(group_delay_us=2**32 - 1)) for pmu in pmus)
    message = "GRP_DLY: 4294.97 s given by G1; allowed: 0 to 10 s"
    assert message in source.take(0, 0.0, late._replace(pmus=hours))
    source.take(0, 0.0, late._replace(pmus=pmus))
    source.take(0, 0.0, instant([0], 0))
    assert rows(source, 0.0) == [*[[]] * 6, [(0, 0, 1.0)]]


MUTATED = 5000  # frames


def mutated(rng: np.random.Generator, raw: bytes, fits: bool) -> bytes:
    """Some bytes changed, and a check word that fits again, or not."""
    changed = bytearray(raw)
    for _ in range(int(rng.integers(1, 4))):
        changed[int(rng.integers(len(changed)))] = int(rng.integers(256))
    if fits:
        changed[0], changed[2:4] = frame.SYNC, len(changed).to_bytes(2, "big")
        changed[-2:] = crc_hqx(bytes(changed[:-2]), 0xFFFF).to_bytes(2, "big")
    return bytes(changed)


def test_hostile_servers_end_nothing() -> None:
    """Of mutated frames each is refused, read, or of no use; none ends the client, and ticks stay few."""
    served, rng, receiver, source = stream([0, 1, 2]), np.random.default_rng(3), Receiver(), sources(SOUTH)
    good = [raw for kind in (2, 3) for raw in session.answers(served, f"send_configuration_{kind}", 1, 0)]
    good += [session.data_frame(served, instant([0, 1, 2], k)) for k in range(6)]
    ticks = 0
    for i in range(MUTATED):
        now_s = i / 600
        for what in receiver.take([mutated(rng, good[i % len(good)], fits=i % 4 > 0)]):
            if not isinstance(what, str):
                source.take(0, now_s, what)
        ticks += len(rows(source, now_s))
    assert sum(receiver.refused.values()) > MUTATED / 4
    assert ticks <= 60 * (MUTATED / 600 + (1 + source.following.moved) * (JUMP_S + 1.0))


def test_hostile_clients_end_nothing_and_are_counted() -> None:
    server, rng = Server(stream([0]), lambda: (1, 0)), np.random.default_rng(4)
    answered = 0
    for i in range(20_000):
        answers, turned = server.answer(mutated(rng, frame.command(1, list(frame.COMMANDS)[i % 7], 5), fits=i % 2 > 0))
        answered += bool(answers) or turned is not None
    refused = sum(server.counts.refused.values())
    assert refused > 10_000
    assert answered > 100
    assert refused + answered <= 20_000
