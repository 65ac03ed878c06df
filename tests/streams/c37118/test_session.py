"""Both ends of a stream: commands and their answers, what a client makes of bytes, however they are cut."""

from __future__ import annotations

import os
import re
from binascii import crc_hqx

import numpy as np
import pytest

from facts_damping_streams.c37118 import configuration, data, frame, session, stat
from facts_damping_streams.c37118.configuration import Analog, Configuration, Digital, Phasor, PmuConfiguration
from facts_damping_streams.c37118.data import Data
from facts_damping_streams.c37118.frame import FrameError
from facts_damping_streams.c37118.session import Instant, Receiver

MUTATED = int(os.environ.get("MUTATED_FRAMES", "40000"))
WIDE = Configuration(
    tuple(
        PmuConfiguration(
            f"P{i}", i, (Phasor("V"), Phasor("I", current=True)), (Analog("P"),), float_phasors=True, polar=True
        )
        for i in range(1, 4)
    ),
    60,
)


def instant(c: Configuration, k: int, status: int = 0) -> Instant:
    rng, pmus = np.random.default_rng(k), len(c.pmus)
    phasors = rng.uniform(0.0, 3.0, (sum(len(p.phasors) for p in c.pmus), 2)).astype(np.float32).astype(float)
    analogs = rng.integers(-100, 100, sum(len(p.analogs) for p in c.pmus)).astype(float)
    none = np.zeros(0, np.int64)
    return Instant(
        k // 60, k, 0, Data(np.full(pmus, status), phasors, np.full(pmus, 60.0), np.zeros(pmus), analogs, none)
    )


def same(received: object, other: Instant) -> bool:
    assert isinstance(received, Instant)
    return (received.soc, received.fraction) == (other.soc, other.fraction) and np.array_equal(
        received.data.phasors, other.data.phasors
    )


@pytest.mark.parametrize("kind", ["configuration_1", "configuration_2", "configuration_3"])
def test_command_is_answered(kind: str) -> None:
    served = session.stream(9, WIDE, "three PMUs")
    received = Receiver().take(session.answers(served, f"send_{kind}", 5, 0))
    assert received == ([] if kind == "configuration_1" else [WIDE])  # 1 says what could be sent
    assert Receiver().take(session.answers(served, "send_header", 5, 0)) == ["three PMUs"]
    assert session.answers(served, "turn_on", 5, 0) == []


@pytest.mark.parametrize("size", [1, 7, 1000])
def test_however_bytes_come(size: int) -> None:
    served, receiver = session.stream(9, WIDE), Receiver()
    wanted = [instant(WIDE, k) for k in range(40)]
    sent = session.data_frame(served, wanted[0]) + session.answers(served, "send_configuration_2", 1, 2)[0]
    sent += b"".join(session.data_frame(served, measured_instant) for measured_instant in wanted)
    contents = [content for i in range(0, len(sent), size) for content in receiver.feed(sent[i : i + size])]
    assert contents[0] == WIDE
    assert len(contents) == 41  # but the data before it
    assert all(same(*pair) for pair in zip(contents[1:], wanted, strict=True))
    assert (receiver.lost_bytes, receiver.refused) == (0, {})


def test_configuration_that_changes_is_asked_for_again() -> None:
    served, receiver = session.stream(9, WIDE), Receiver()
    asked = [receiver.changed]
    receiver.take(session.answers(served, "send_configuration_2", 1, 0))
    asked.append(receiver.changed)
    receiver.take([session.data_frame(served, instant(WIDE, 1, stat.CHANGE))])
    assert [*asked, receiver.changed] == [True, False, True]
    narrow = WIDE._replace(pmus=WIDE.pmus[:2])
    after = session.stream(9, narrow)
    assert receiver.take([session.data_frame(after, instant(narrow, 2))]) == []
    assert receiver.refused == {"FRAMESIZE": 1}
    receiver.take(session.answers(after, "send_configuration_2", 1, 0))
    (received,) = receiver.take([session.data_frame(after, instant(narrow, 3))])
    assert same(received, instant(narrow, 3))


def test_parts_of_a_configuration_3_that_do_not_fit_are_refused() -> None:
    names = tuple(f"bit {i} " + "x" * 200 for i in range(16))
    wide = PmuConfiguration("W", 1, (), (), tuple(Digital(names) for _ in range(15)))
    c = Configuration((wide, wide), 60)
    served, receiver = session.Stream(9, c, data.layout(c)), Receiver()  # too long for configurations 1 and 2
    first, last = session.answers(served, "send_configuration_3", 1, 0)
    assert receiver.take([first]) == []
    assert receiver.take([last]) == [served.configuration]
    assert receiver.take([last]) == []
    assert receiver.take([first, first, last]) == [served.configuration]  # the first one begins anew
    assert receiver.refused == {"CONT_IDX": 1}
    third = frame.encode(frame.Frame("configuration_3", 9, 1, 0, b"\0\3" + b"x" * 100))
    assert receiver.take([first, *[third] * 100]) == []
    assert (receiver.refused["CONT_IDX"], receiver.parts) == (101, [])


def test_mutated_streams_end_nothing_and_are_counted() -> None:
    """Bytes changed, cut and doubled; half with a check word that fits, so that what is behind it is met, too."""
    served, rng = session.stream(9, WIDE), np.random.default_rng(7)
    good = [
        *session.answers(served, "send_configuration_2", 1, 0),
        *session.answers(served, "send_configuration_3", 1, 0),
    ]
    good += [*session.answers(served, "send_header", 1, 0), frame.command(9, "turn_on", 3)]
    good += [session.data_frame(served, instant(WIDE, k)) for k in range(4)]
    receiver, accepted, sent_frames = Receiver(), 0, 0
    for i in range(MUTATED):
        raw = bytearray(good[i % len(good)])
        for _ in range(int(rng.integers(1, 4))):
            raw[int(rng.integers(len(raw)))] = int(rng.integers(256))
        if i % 3 == 1:
            del raw[int(rng.integers(4, len(raw))) :]
        if i % 3 == 2:
            raw += raw[: int(rng.integers(len(raw)))]
        if i % 2 and len(raw) >= frame.MINIMUM:
            raw[0], raw[2:4] = frame.SYNC, len(raw).to_bytes(2, "big")
            raw[-2:] = crc_hqx(bytes(raw[:-2]), 0xFFFF).to_bytes(2, "big")
        sent_frames += 1
        accepted += len(receiver.take([bytes(raw)]))
    refused = sum(receiver.refused.values())
    assert all(re.fullmatch(r"[A-Z_0-9, to]+", field) for field in receiver.refused), receiver.refused
    assert refused > MUTATED / 4
    assert accepted > MUTATED / 200
    assert refused + accepted <= sent_frames


def test_stream_that_is_too_wide_is_refused_before_it_begins() -> None:
    pmu = PmuConfiguration("X", 1, tuple(Phasor(f"V{i}") for i in range(9000)), float_phasors=True)
    with pytest.raises(FrameError, match="FRAMESIZE: 72022 bytes of data; allowed: 16 to 65535"):
        session.stream(1, Configuration((pmu,), 60))
    with pytest.raises(FrameError, match="CHNAM: 'a name of more than 16' has 22 bytes; allowed: 16"):
        session.stream(1, Configuration((PmuConfiguration("X", 1, (Phasor("a name of more than 16"),)),), 60))


def test_stream_without_pmus_is_refused() -> None:
    receiver = Receiver()
    none = configuration.encode(Configuration((), 60), "configuration_2")[0]
    assert receiver.take([frame.encode(frame.Frame("configuration_2", 9, 1, 0, none))]) == []
    assert (receiver.refused, receiver.why) == ({"NUM_PMU": 1}, "NUM_PMU: 0 given; allowed: 1 and more (6.4)")
