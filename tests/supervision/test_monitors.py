"""Each monitor of the table: a run with something that is its to see, and one with what it lets pass."""

from __future__ import annotations

import json
from functools import cache
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import pytest

from facts_damping.case.loading import load_case
from facts_damping.monitor_table import MONITORS, STATES, cause_name
from facts_damping.simulation import loop

if TYPE_CHECKING:
    from facts_damping.record import Record

AT = 3.0  # s, when things go wrong: 2 s after an event, while the grid swings


def link(way: str, *stages: dict[str, Any]) -> str:
    return f"link={json.dumps({way: [{'start': AT, **stage} for stage in stages]})}"


def fault(kind: str, controller: int = 0, **more: Any) -> str:
    return f"controllers.{controller}.faults={json.dumps([{'kind': kind, 'start': AT, **more}])}"


def bad(kind: str, **more: Any) -> str:
    return f"measurement.bad_data={json.dumps([{'kind': kind, 'start': AT, **more}])}"


LOST = {"model": "bernoulli", "loss": 1.0}
LARGE = "scenario=large"
NETWORK = ["controllers.0.name=ANFTSC", "controllers.0.scheme=direct", "controllers.0.profile=thesis"]
RUNAWAY = ["controllers.0.name=ANFFsC", *NETWORK[1:], "controllers.0.parameters.eta=1", LARGE]
CHATTERING = [f"supervision.monitors.{name}=off" for name in ("reversals", "harm")]
BOTH_ENDS = [
    *({"name": g, "machine": g} for g in ("G1", "G2", "G3", "G4")),
    {"name": "WEST", "bus": "B7", "branches": ["line_1"]},
    {"name": "EAST", "bus": "B8W", "branches": ["line_1"]},
    {"name": "TIE", "bus": "B8W", "branches": ["sssc"]},
]
SLOWLY = [LARGE, "supervision.monitors.growing.limit=0.03"]  # a swing as large as this is as fast as limits let it be
ENDS = f"system.pmus={json.dumps(BOTH_ENDS)}"
FALLBACK = [
    {"name": "LLC"},
    {"name": "LLC", "signals": ["power_rate"], "parameters": {"gain": 0.05}, "fallback_of": 0, "link": "ideal"},
]
RESERVE = f"controllers={json.dumps(FALLBACK)}"


def later(*delays: float) -> str:
    """Delays that are added one after the other, half a second apart."""
    return link("up", *({"delay": delay, "start": AT + k / 2.0} for k, delay in enumerate(delays)))


def in_turns(delay: float) -> str:
    """A delay that comes and goes."""
    return link("up", *({"delay": delay, "start": AT + k, "duration": 0.5} for k in range(6)))


def stays_at_a_limit(seconds: float, side: int = 1) -> str:
    """A controller whose gain takes it to a limit, where it stays for a while; `side`: -1: to the other one."""
    wild = {"kind": "gain", "start": AT, "size": side * 1000}
    return f"controllers.0.faults={json.dumps([wild, {'kind': 'stuck', 'start': AT + 0.2, 'duration': seconds}])}"


LONG = ["profile=deployment", "duration=90"]


def forced(**more: Any) -> str:
    """A load that oscillates beside the mode."""
    source = {"time": AT, "kind": "forced_oscillation", "load": "load_2", "frequency": 0.6, "amplitude": 0.03, **more}
    return f"scenario={json.dumps([source])}"


class Trial(NamedTuple):
    """Runs of `two_area` with a lead-lag controller, armed from the start."""

    wrong: list[str]  # in which the monitor acts
    sound: list[str]  # in which it does not
    beside: frozenset[str] = frozenset()  # what may act before it or with it


def biased(channel: str, bias: float) -> list[str]:
    return [link("up", {"model": "bias", "bias": bias, "measurement": channel, "channels": ["G1"]})]


TRIALS = {
    "missing": Trial([link("up", LOST)], [link("up", {**LOST, "duration": 0.1})]),
    "stale": Trial([later(0.1, 0.1, 0.1, 0.1)], [later(0.1, 0.1, 0.1)], frozenset({"jitter"})),
    "jitter": Trial([in_turns(0.13)], [in_turns(0.06)]),
    "misaligned": Trial(
        [link("up", {"delay": 0.12, "channels": ["G1"]})], [link("up", {"delay": 0.08, "channels": ["G1"]})]
    ),
    "stuck": Trial([LARGE, bad("stuck", pmus=["G1"])], [LARGE, bad("stuck", pmus=["G1"], duration=0.15)]),
    "range": Trial(biased("speed_deviation", 0.5), biased("speed_deviation", 0.05)),
    "angle": Trial(biased("frequency", 0.5), biased("frequency", 0.2)),
    "speed": Trial(biased("speed_deviation", 0.02), biased("speed_deviation", 0.005)),
    "powers": Trial([ENDS, bad("wrong_sign", pmus=["EAST"])], [ENDS, LARGE]),
    "status": Trial([bad("invalid", pmus=["G1"])], [bad("invalid", pmus=["G1"], duration=0.04)]),
    "clock": Trial(
        [link("up", {"model": "spoof", "offset": 0.01})], [link("up", {"model": "spoof", "offset": 0.0005})]
    ),
    "local": Trial(
        [RESERVE, link("up", LOST), fault("hung", 1, start=4.0)],
        [RESERVE, link("up", LOST), fault("hung", 1, start=4.0, duration=0.1)],
        frozenset({"missing", "stale"}),
    ),
    "silent": Trial([fault("hung")], [fault("hung", duration=0.1)]),
    "non_finite": Trial([fault("nan")], [LARGE, fault("gain", size=1000)]),
    "saturated": Trial([LARGE, stays_at_a_limit(6.0)], [LARGE, stays_at_a_limit(1.0)]),
    "reversals": Trial([fault("bang_bang")], [fault("bang_bang", duration=0.1)]),
    "weights": Trial([*NETWORK, fault("weights", size=50)], [*NETWORK, fault("weights", size=1)]),
    "lyapunov": Trial([*RUNAWAY, *CHATTERING, "supervision.monitors.lyapunov.lasts=0.1"], [*NETWORK, LARGE]),
    "harm": Trial([LARGE, fault("wrong_sign")], [LARGE]),
    "growing": Trial([*SLOWLY, fault("wrong_sign"), "supervision.monitors.harm=off"], SLOWLY),
    "frequency": Trial([LARGE, "supervision.monitors.frequency.limit=0.3"], [LARGE]),
    "islanding": Trial([LARGE, "supervision.monitors.islanding.limit=20"], [LARGE]),
    "device": Trial([link("down", LOST)], [link("down", {**LOST, "duration": 0.15})]),
    "forced": Trial([*LONG, forced()], [*LONG, forced(duration=20)]),
}


class Seen(NamedTuple):
    """A run, and from when on each monitor has acted: has been beyond its limit for as long as it takes."""

    record: Record
    states: list[tuple[float, str, str]]  # time, s, state and cause, where that changes
    acted: dict[str, float]  # s


@cache
def seen(*sets: str) -> Seen:
    case = load_case(None, ["supervision=standard", "arm_at=0", "duration=9", *sets])
    built = loop.build_loop(case)
    record, rows = loop.finish(case, built), built.control.supervisors.thresholds[0]
    reports, ends, acted = record.supervision, (record.ticks + 1.0) / record.frame_rate, dict[str, float]()
    for m, name in enumerate(MONITORS):
        since = np.inf
        for end, value in zip(ends, reports["values"][:, m], strict=True):
            since = min(since, end) if value > rows["limit"][m] else np.inf
            if rows["follows"][m] and end - since >= rows["lasts_ns"][m] * 1e-9 - 1e-9:
                acted.setdefault(name, float(end))
    states = [(float(ends[k]), STATES[row["state"]], cause_name(int(row["cause"]))) for k, row in enumerate(reports)]
    return Seen(record, [state for k, state in enumerate(states) if k == 0 or state[1] != states[k - 1][1]], acted)


def test_every_monitor_has_a_trial() -> None:
    assert list(TRIALS) == list(MONITORS)


@pytest.mark.parametrize("name", MONITORS)
def test_monitor_acts_first_on_its_own_fault(name: str) -> None:
    trial = TRIALS[name]
    watched = seen(*trial.wrong)
    assert name in watched.acted
    by_then = {other for other, at in watched.acted.items() if at <= watched.acted[name]}
    assert by_then <= {name} | trial.beside
    assert watched.acted[name] > (0.0 if LARGE in trial.wrong else AT)
    if MONITORS[name].follows == "warn":
        assert [state for _, state, _ in watched.states] == ["armed"]
    else:
        at, state, cause = watched.states[-1]
        assert (state, cause) == ("tripped", name)
        assert at == pytest.approx(watched.acted[name], abs=1e-6)


@pytest.mark.parametrize("name", MONITORS)
def test_monitor_does_not_act_on_what_it_lets_pass(name: str) -> None:
    watched = seen(*TRIALS[name].sound)
    assert name not in watched.acted
    assert len(watched.record.time_ns) == 60 * watched.record.configuration["duration"]


SOUND = [
    *(["link=fibre"], ["link=pdci_100ms"], ["link=csg"], ["measurement=p_class", "controllers.0.signals=[frequency]"]),
]


@pytest.mark.parametrize("sets", SOUND, ids=str)
@pytest.mark.parametrize("scenario", ["small", "large", "multiple"])
def test_monitors_do_not_act_in_a_sound_run(scenario: str, sets: list[str]) -> None:
    watched = seen(f"scenario={scenario}", *sets)
    assert watched.acted == {}
    assert [state for _, state, _ in watched.states] == ["armed"]


def test_either_limit_counts() -> None:
    """The time at the other one is the same, but for the frame in which it gets there."""
    upper, other = (seen(LARGE, stays_at_a_limit(6.0, side)).acted["saturated"] for side in (1, -1))
    assert other == pytest.approx(upper, abs=0.05)


def test_frames_that_arrive_together_are_compared_one_by_one() -> None:
    """A link in order lets several frames of a PMU go at once: what they say of it is what they say one by one."""
    for scenario in ("small", "large"):
        for monitor in ("angle", "speed"):
            apart, other = (
                seen(f"scenario={scenario}", how).record.supervision["values"][:, list(MONITORS).index(monitor)].max()
                for how in ("link=fibre", "link=ideal")
            )
            assert apart == pytest.approx(other, rel=0.05)


def test_station_that_was_lost_for_long_is_no_island() -> None:
    """While it is lost, and once it is back, with the grid off its frequency: its turns are counted anew."""
    others = [f"supervision.monitors.{name}=off" for name in MONITORS if name not in ("misaligned", "islanding")]
    lost = link("up", {**LOST, "channels": ["G1"], "duration": 5.0})
    watched = seen(RESERVE, *others, lost, "duration=14")
    assert [(state, cause) for _, state, cause in watched.states] == [
        ("armed", "schedule"),
        ("fallback", "misaligned"),
        ("armed", "misaligned"),
    ]
    assert watched.states[2][0] == pytest.approx(AT + 5.0 + 3.0, abs=0.2)  # recovery
    off = abs(watched.record.frames[-1, 0, 5] - 60.0)
    assert off > 0.5  # Hz: in five seconds more than a turn
    angle = watched.record.supervision["values"][:, list(MONITORS).index("islanding")]
    assert np.isnan(angle[int(4.0 * 60)])
    assert np.nanmax(angle) < 45.0


def test_fallback_takes_over_from_a_controller_whose_data_are_bad() -> None:
    """Of the monitors of data; those of the controller and the grid trip with a fallback as without one."""
    for name, trial in TRIALS.items():
        if name == "local" or MONITORS[name].follows == "warn" or any("controllers" in text for text in trial.wrong):
            continue
        at, state, cause = seen(RESERVE, *trial.wrong).states[1]
        assert (state, cause) == ("fallback" if MONITORS[name].follows == "fall_back" else "tripped", name)
        assert at == pytest.approx(seen(*trial.wrong).states[1][0], abs=1e-9)


def test_oscillation_that_grows_by_itself_is_no_reason_not_to_damp_it() -> None:
    """In shadow nothing acts: the plant, which is unstable by itself, is armed, and it grows no more."""
    watched = seen(LARGE, "arm_at=8", "duration=14")
    assert [state for _, state, _ in watched.states] == ["shadow", "armed"]
    speeds = watched.record.machines["speed_deviation"]
    swing = [np.ptp(speeds[k : k + 96, 0] - speeds[k : k + 96, 2]) for k in (200, 380, 740)]
    assert swing[1] > 1.1 * swing[0]
    assert swing[2] < swing[1]
