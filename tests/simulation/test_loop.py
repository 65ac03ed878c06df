"""Runs in process: repeatable, causal, exact in time."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from facts_damping.case.loading import load_case
from facts_damping.control.bank import act
from facts_damping.link.transfer import downlink, merge, uplink
from facts_damping.neurofuzzy.table import ANTECEDENTS, CONSEQUENTS
from facts_damping.signals import NANOSECONDS
from facts_damping.simulation import loop
from facts_damping.simulation.measured_plant import advance_with_pmus, measure_with_pmus, tick_ns

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
    signals, rate = parts.signals, case.run.frame_rate
    for k in range(case.ticks):
        start, end = tick_ns(k, rate), tick_ns(k + 1, rate)
        reported = signals.frames[k], signals.measured_ns[k], signals.status[k]
        measure_with_pmus(parts.measured, k, *reported, signals.machines[k], signals.devices[k])
        delivered = uplink(parts.links, 0, k, start, end, *reported)
        issued = act(
            parts.control.bank,
            parts.control.bank_state,
            0,
            k,
            parts.links.up.out[0],
            delivered,
            parts.control.issued,
            0,
        )
        arrived = downlink(parts.links, 0, k, end, parts.control.issued, issued)
        applied = merge(parts.applied, 0, parts.links.down.out[0], arrived)
        advance_with_pmus(parts.measured, k, parts.applied, applied)
    assert signals.frames.tobytes() == whole.frames.tobytes()
    assert signals.machines.tobytes() == whole.machines.tobytes()
    assert signals.devices.tobytes() == whole.devices.tobytes()


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
    ends = np.append(record.time_ns[1:], tick_ns(len(record.time_ns), rate))
    for entries, stamp in ((record.delivered, "arrival_ns"), (record.applied, "effective_ns")):
        assert np.all(entries[stamp] >= record.time_ns[entries["tick"]])
        assert np.all(entries[stamp] < ends[entries["tick"]])
        assert np.all(np.diff(entries[stamp]) >= 0)
    expected = np.count_nonzero(record.time_ns + up < ends[-1])
    assert len(record.issued) == expected
    assert len(record.delivered) == expected * len(record.pmus)


def test_millisecond_of_delay_matters() -> None:
    """Delays are not rounded to frames: 16 ms and 17 ms at 60 frames/s are two results, as are 3 and 4 ms."""
    results = [
        loop.run(load_case(None, [f"link.up.0.delay={ms / 1000}", "duration=5"])).machines["rotor_angle"][-1, 0]
        for ms in (3, 4, 16, 17)
    ]
    assert len(set(results)) == 4


def test_run_without_controllers_is_the_open_loop() -> None:
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


def two(*sets: str) -> list[str]:
    """SSSC and STATCOM, a lead-lag each."""
    rows = ["controllers.0.name=LLC", "controllers.1.name=LLC", "controllers.1.devices=[statcom]"]
    return ["devices=[sssc, statcom]", "scenario=large", "duration=3", *rows, *sets]


@settings(deadline=None, max_examples=15)
@given(
    delays=st.tuples(*[st.sampled_from([0, 1, 16_666_666, 123_400_000]) | st.integers(0, 400_000_000)] * 4),
    rate=st.sampled_from([25, 60, 120]),
)
def test_delays_are_exact_on_every_link(delays: tuple[int, ...], rate: int) -> None:
    """Setpoints are as late as the way of their own controller is long, and come to the plant by time."""
    sets = [f"controllers.{i // 2}.link.{('up', 'down')[i % 2]}.0.delay={d / 1e9!r}" for i, d in enumerate(delays)]
    record = loop.run(load_case(None, two(f"frame_rate={rate}", *sets)))
    up, down = np.array(delays[::2]), np.array(delays[1::2])
    delivered, issued, applied = record.delivered, record.issued, record.applied
    np.testing.assert_array_equal(delivered["arrival_ns"] - delivered["measured_ns"], up[delivered["link"]])
    np.testing.assert_array_equal(issued["issued_ns"] - issued["measured_ns"], up[issued["controller"]])
    np.testing.assert_array_equal(applied["effective_ns"] - applied["issued_ns"], down[applied["controller"]])
    assert np.all(np.diff(applied["effective_ns"]) >= 0)
    assert np.all(np.diff(applied["controller"])[np.diff(applied["effective_ns"]) == 0] > 0)
    end = tick_ns(len(record.time_ns), rate)
    for c in range(2):
        expected = np.count_nonzero(record.time_ns + up[c] < end)
        assert np.count_nonzero(issued["controller"] == c) == expected
        assert np.count_nonzero(delivered["link"] == c) == expected * len(record.pmus)
        assert np.count_nonzero(applied["controller"] == c) == np.count_nonzero(record.time_ns + up[c] + down[c] < end)


@pytest.mark.parametrize("scheme", ["direct", "indirect"])
def test_links_of_the_same_delays_are_as_good_as_one(scheme: str) -> None:
    """Whose link it is changes no bit; what it delivers is there once for each link."""
    sets_of_both = two("link=delay_100ms", "controllers.0.name=HBsWC", f"controllers.0.scheme={scheme}")
    single = loop.run(load_case(None, sets_of_both))
    for c in ([0], [1], [0, 1]):
        sets = [f"controllers.{i}.link=delay_100ms" for i in c]
        several = loop.run(load_case(None, [*sets_of_both, *sets, "controllers.1.namespace=elsewhere"]))
        for name in {*ARRAYS, "estimates"} - {"delivered", "applied"}:
            assert getattr(several, name).tobytes() == getattr(single, name).tobytes(), name
        by_device = np.lexsort((several.applied["controller"], several.applied["tick"]))
        assert several.applied[by_device].tobytes() == single.applied.tobytes()  # at one time, link by link
        for link in range(2):
            of_link = several.delivered[several.delivered["link"] == link]
            of_link["link"] = 0
            assert of_link.tobytes() == single.delivered.tobytes()


def test_identifier_learns_from_what_its_controllers_own_link_delivers() -> None:
    run_sets = ["controllers.0.name=HBsWC", "controllers.0.scheme=indirect", "controllers.0.link=delay_100ms"]
    record = loop.run(load_case(None, two(*run_sets)))
    assert set(record.delivered["link"]) == {0, 1}
    late = record.delivered[record.delivered["link"] == 1]
    newest = [late["measured_ns"][late["tick"] <= tick].max(initial=-1) for tick in record.estimates["tick"]]
    assert record.estimates["measured_ns"].tolist() == newest


# Each consequent once, with the antecedents in turn: `tests/neurofuzzy` has them all together.
PAIRS = [f"{a}+{c}" for a, c in zip(itertools.cycle(ANTECEDENTS), CONSEQUENTS, strict=False)]


@pytest.mark.parametrize("profile", ["deployed", "thesis"])
@pytest.mark.parametrize("scheme", ["direct", "indirect"])
@pytest.mark.parametrize("name", PAIRS)
def test_neuro_fuzzy_pair_issues_setpoints_within_its_limits(name: str, scheme: str, profile: str) -> None:
    run_sets = [f"controllers.0.name={name}", f"controllers.0.scheme={scheme}", f"controllers.0.profile={profile}"]
    record = loop.run(load_case(None, ["scenario=large", "duration=5", *run_sets]))
    assert np.isfinite(record.issued["value"]).all()
    assert np.abs(record.issued["value"]).max() <= 0.1
    assert np.abs(record.issued["value"]).max() > 1e-3
    assert len(record.estimates) == (300 if scheme == "indirect" else 0)


def test_direct_adaptation_with_the_wrong_sign_loses_synchronism() -> None:
    """`small` stays in synchronism even without control."""
    run_sets = ["controllers.0.name=ANFTSC", "controllers.0.scheme=direct", "scenario=small"]
    case = load_case(None, run_sets)
    right, wrong = loop.build_loop(case), loop.build_loop(case)
    wrong.control.bank.sensitivity[:] *= -1.0
    for theta in (wrong.control.bank_state.learner.theta, wrong.control.bank_state.learner.start):
        theta[:, 8:] *= -1.0  # the weights, which start by the sign
    assert loop.finish(case, right).in_synchronism.all()
    assert not loop.finish(case, wrong).in_synchronism.all()


def test_without_the_delay_an_identifiers_sign_turns_near_half_a_period() -> None:
    """The interarea mode's period is 1.6 s; with the delay known y(k) is paired with the setpoint that moved it."""
    delay = 0.75
    run_sets = ["controllers.0.name=gaussian+singleton", "controllers.0.scheme=indirect", f"link.down.0.delay={delay}"]
    run_sets.append("controllers.0.parameters.identifier_leakage=0.01")
    assert load_case(None, run_sets).controllers[0].parameters["loop_delay"] == delay
    wrong = {}
    for lag in (delay, 0.0):
        estimates = loop.run(load_case(None, [*run_sets, f"controllers.0.parameters.loop_delay={lag}"])).estimates
        wrong[lag] = float(np.mean(estimates["jacobian"][estimates["measured_ns"] > NANOSECONDS] > 0.0))
    assert wrong[delay] == 0.0
    assert wrong[0.0] > 0.5
