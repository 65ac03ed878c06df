"""Runs in process: repeatable, causal, exact in time."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from facts_damping import loop
from facts_damping.configuration import load_case
from facts_damping.control.bank import act
from facts_damping.link.transfer import downlink, uplink
from facts_damping.plant.integration import advance
from facts_damping.plant.measurement import measure

ARRAYS = ("time_ns", "frames", "delivered", "issued", "applied", "machines", "devices", "in_synchronism")


def test_same_run_same_bits() -> None:
    case = load_case(None, ["scenario=large", "link=delay_100ms", "duration=5"])
    first, second = loop.run(case), loop.run(case)
    for name in ARRAYS:
        assert getattr(first, name).tobytes() == getattr(second, name).tobytes()


def test_tick_by_tick_calls_equal_the_compiled_loop() -> None:
    """The nodes call the five functions one by one from Python; the loop calls them compiled."""
    case = load_case(None, ["scenario=large", "link.up.0.delay=0.0312", "duration=3"])
    whole = loop.run(case)
    parts = loop.build_loop(case)
    kept = loop.room(case, parts)
    rate = case.run.frame_rate
    for k in range(case.ticks):
        start, end = loop.tick_ns(k, rate), loop.tick_ns(k + 1, rate)
        measure(parts.plant, parts.plant_state, start, kept.frames[k], kept.machines[k], kept.devices[k], parts.work)
        delivered = uplink(parts.up, k, start, end, kept.frames[k])
        issued = act(parts.bank, parts.bank_state, 0, k, parts.up.out, delivered, parts.issued, 0)
        applied = downlink(parts.down, k, end, parts.issued, issued)
        advance(parts.plant, parts.plant_state, start, end, parts.down.out, applied, parts.work)
    assert kept.frames.tobytes() == whole.frames.tobytes()
    assert kept.machines.tobytes() == whole.machines.tobytes()
    assert kept.devices.tobytes() == whole.devices.tobytes()


@settings(deadline=None, max_examples=15)
@given(
    up=st.integers(0, 400_000_000),
    down=st.integers(0, 400_000_000),
    rate=st.sampled_from([25, 30, 50, 60, 120]),
)
def test_delays_are_exact_and_nothing_acts_before_its_cause(up: int, down: int, rate: int) -> None:
    """Every setpoint is issued exactly `up` after the measurement and effective exactly `down` after that."""
    sets = [f"link.up.0.delay={up / 1e9!r}", f"link.down.0.delay={down / 1e9!r}", f"frame_rate={rate}", "duration=2"]
    record = loop.run(load_case(None, sets))
    assert np.all(record.delivered["arrival_ns"] - record.delivered["measured_ns"] == up)
    assert np.all(record.issued["issued_ns"] - record.issued["measured_ns"] == up)
    assert np.all(record.applied["effective_ns"] - record.applied["issued_ns"] == down)
    ends = np.append(record.time_ns[1:], loop.tick_ns(len(record.time_ns), rate))
    for entries, stamp in ((record.delivered, "arrival_ns"), (record.applied, "effective_ns")):
        assert np.all(entries[stamp] >= record.time_ns[entries["tick"]])
        assert np.all(entries[stamp] < ends[entries["tick"]])
        assert np.all(np.diff(entries[stamp]) >= 0)
    expected = np.count_nonzero(record.time_ns + up < ends[-1])
    assert len(record.issued) == expected
    assert len(record.delivered) == expected * len(record.stations)


def test_a_millisecond_of_delay_matters() -> None:
    """Delays are not rounded to frames: 16 ms and 17 ms at 60 frames/s are two results, as are 3 and 4 ms."""
    results = [
        loop.run(load_case(None, [f"link.up.0.delay={ms / 1000}", "duration=5"])).machines["rotor_angle"][-1, 0]
        for ms in (3, 4, 16, 17)
    ]
    assert len(set(results)) == 4


def test_no_controllers_is_the_open_loop() -> None:
    none = loop.run(load_case(None, ["controllers=[]", "duration=3"]))
    idle = loop.run(load_case(None, ["controllers.0.parameters.gain=0", "duration=3"]))
    assert none.frames.tobytes() == idle.frames.tobytes()
    assert len(none.issued) == 0
    assert np.all(idle.issued["value"] == 0.0)


def test_setpoints_keep_the_device_s_limit() -> None:
    record = loop.run(load_case(None, ["scenario=large", "controllers.0.parameters.gain=500", "duration=5"]))
    assert np.max(np.abs(record.issued["value"])) == pytest.approx(0.1)
    assert np.max(np.abs(record.devices["reference"])) <= 0.1
    slope = np.abs(np.diff(record.devices["reference"][:, 0])) * 60
    assert np.max(slope) <= 5.0 + 1e-6  # a tick is a whole number of nanoseconds
