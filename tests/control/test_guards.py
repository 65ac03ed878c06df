"""Each guard of adaptation beside the same controller without it."""

from __future__ import annotations

import numpy as np
import pytest

from facts_damping.control.table import defaults, kind
from facts_damping.neurofuzzy.table import VARIANTS
from tests.control.bench import LIMITS, SCALE, SIGN, controller, frame_ns, raw, settings_of
from tests.control.test_neuro_fuzzy import Reference

LIMIT, RATE = LIMITS["first"]
GUARDS = ("dead_zone", "leakage", "projection", "clip", "anti_windup", "stale", "sign_guard", "identifier_leakage")


@pytest.mark.parametrize("name", VARIANTS)
def test_profile_thesis_has_no_guard(name: str) -> None:
    """`deployed` has all of them, but for leakage: it would forget what was learnt."""
    thesis, deployed = (settings_of(controller(name, "direct", p))[0] for p in ("thesis", "deployed"))
    assert [float(thesis[guard]) for guard in GUARDS] == [0.0] * len(GUARDS)
    assert [guard for guard in GUARDS if not deployed[guard]] == ["leakage"]
    same = set(defaults(kind(name), "thesis")) - set(GUARDS)
    assert all(thesis[parameter] == deployed[parameter] for parameter in same)


def test_clip_and_projection_reach_the_rule() -> None:
    """An outlier of 1e3 p.u.: 5 is the bound of weights."""
    free, clipped, projected = raw(), raw(clip=0.25), raw(projection="on")
    start = free.theta
    for bench in (free, clipped, projected):
        bench.frame(0, 0.002)
        bench.frame(1, 1e3)
    assert np.linalg.norm(free.theta - start) > 1e3
    assert np.linalg.norm(clipped.theta - start) == pytest.approx(0.25)
    assert np.abs(projected.theta).max() == 5


def test_dead_zone_keeps_a_small_bias_from_teaching() -> None:
    """Without penalty on effort nothing else holds the parameters."""
    guarded, drifts = raw(hbar=0.0, dead_zone=0.05), raw(hbar=0.0)
    start = guarded.theta
    for k in range(500):
        for bench in (guarded, drifts):
            bench.frame(k, 0.049 * SCALE)
    np.testing.assert_array_equal(guarded.theta, start)
    assert np.linalg.norm(drifts.theta - start) > 0.2
    guarded.frame(500, 0.051 * SCALE)
    assert not np.array_equal(guarded.theta, start)


@pytest.mark.parametrize("way", ["off", "on"])
def test_anti_windup_comes_back_at_once(way: str) -> None:
    """Five seconds at the limit, then the other way: frames until the setpoint turns, too, and the largest weight."""
    bench = raw(anti_windup=way, eta=0.002, hbar=0.0)
    assert [bench.frame(k, 0.05) for k in range(300)][-1] == LIMIT
    wound = bench.theta[8:].max()
    lost = sum(bench.frame(300 + k, -0.006) > 0 for k in range(1000))
    assert (wound < 1.1 and lost == 0) if way == "on" else (wound > 3 and lost > 50)


def test_learner_sees_what_the_device_follows() -> None:
    """The setpoint before, within the device's limit and rate; without the guard as it was wished for."""
    guarded, bench, wished_for = raw(anti_windup="on", eta=0.0, weight=4.0), raw(eta=0.0, weight=4.0), 0.0
    rng, followed, k = np.random.default_rng(4), 0.0, 0
    for _ in range(40):
        gap = int(rng.integers(1, 3))
        k += gap
        reach = RATE * (frame_ns(k) - frame_ns(k - gap)) * 1e-9 if k > gap else 0.0
        y = float(rng.normal() * 0.02)
        for each_bench in (guarded, bench):
            each_bench.frame(k, y)
        followed = np.clip(np.clip(wished_for, -LIMIT, LIMIT), followed - reach, followed + reach)
        assert guarded.state.memory.applied[0, 0] == pytest.approx(followed, abs=1e-9)
        assert bench.state.memory.applied[0, 0] == wished_for
        wished_for = float(bench.state.unlimited[0, 0])
    assert np.abs(followed) > 0


def test_stale_frames_teach_nothing() -> None:
    """They are acted on all the same."""
    guarded, drifts = raw(stale=1.0), raw()
    start = guarded.theta
    for k in range(20):
        for bench in (guarded, drifts):
            assert bench.frame(k, 0.002 + 1e-4 * k, late_ms=1001.0) != 0
            assert bench.state.memory.taught[0, 0] == (k > 0 and bench is drifts)
    np.testing.assert_array_equal(guarded.theta, start)
    assert np.abs(drifts.theta - start).max() > 1e-3
    guarded.frame(20, 0.002, late_ms=999.0)
    assert guarded.state.memory.taught[0, 0] == 1
    assert not np.array_equal(guarded.theta, start)


@pytest.mark.parametrize("factor", [0.5, -0.5])
def test_sign_guard_takes_a_jacobian_of_the_wrong_sign_for_none(factor: float) -> None:
    """What is left is the penalty. Without the guard the weights go the other way."""
    guarded, plain = raw("ANFTSC", "indirect", sign_guard="on"), raw("ANFTSC", "indirect")
    reference = Reference(0.5, 1.0, 0.5, 0.02, 0.1, 0.0)
    for k in range(50):
        y = 0.004 * np.sin(0.3 * k)
        for bench in (guarded, plain):
            bench.state.jacobian[0, 0, 0] = factor * SIGN * SCALE / LIMIT
            bench.frame(k, y)
        reference.frame(y, 1, max(factor, 0.0) * SIGN)
    np.testing.assert_allclose(guarded.theta, reference.theta, rtol=0, atol=1e-12)
    safe, free = (abs(bench.theta[-1]) for bench in (guarded, plain))
    assert safe == free > 0.5 if factor > 0 else free < safe < 0.5


def test_leakage_leads_back() -> None:
    bench = raw(leakage=0.1, hbar=0.0)
    start = bench.theta
    bench.frame(0, 0.0)
    bench.state.learner.theta[0] += 0.1
    bench.frame(1, 0.0)
    np.testing.assert_allclose(bench.theta - start, 0.09, rtol=1e-9)
