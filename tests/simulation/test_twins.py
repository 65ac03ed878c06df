"""The mirror of a run: noise of the opposite sign, and all else the same."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from facts_damping.analysis.measures import columns, speed_differences
from facts_damping.analysis.response import MIRROR, OUTAGE, PULSED, WITHOUT_EVENTS, less_noise, swings_of
from facts_damping.analysis.summary import summarise
from facts_damping.case.loading import load_case
from facts_damping.record import Record, RunChange
from facts_damping.simulation import loop
from facts_damping.simulation.changes import rerun
from facts_damping.simulation.twins import mirrored, twin, twin_of, with_pulse
from facts_damping_studies.margins.delay_margin import oscillations
from facts_damping_studies.margins.linear_closed_loop import delayed_loop, eigen, link_delays, sampled
from facts_damping_studies.margins.unsupervised import unsupervised

SETS = ["duration=6", "supervision=null", "arm_at=null"]
FAULT = "scenario=[{time: 2.0, kind: fault, line: line_3, location: 0.5}, {time: 2.1, kind: clear, line: line_3}]"


def speeds(record: Record) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
    return columns(speed_differences(record))


@pytest.mark.parametrize(("sets", "part"), [([], 0.05), (["load_noise.std=0.001", "measurement.noise={}"], 0.005)])
def test_before_the_event_run_and_mirror_cancel_to_second_order(sets: list[str], part: float) -> None:
    case = load_case("two_area_deployment", [*SETS, *sets])
    record = loop.run(case)
    other = twin(case, record, kind=MIRROR)
    assert other is not None
    before = record.time_s < 2.0
    deviations, mirror = speeds(record)[before], speeds(other.record)[before]
    assert np.abs(deviations + mirror).max() < part * np.abs(deviations).max()


def test_twin_of_a_run_with_a_line_outage_begins_without_the_line() -> None:
    """After the event both are of one plant in one noise: what was done before it swings freely, and nothing else."""
    case = load_case("two_area_deployment", ["duration=20", *SETS[1:]])
    record = loop.run(case)
    other = twin_of(record)
    assert other is not None
    assert other.kind == OUTAGE
    swings = swings_of(record, other)
    assert swings.response is not None
    late = record.time_s > 17.0
    assert np.abs(swings.response[late]).max() < 0.2 * np.abs(swings.own[late]).max()
    assert swings.indices is None  # the twin's own trip is in it


STEP = "scenario=[{time: 2.0, kind: load_step, load: load_1, change: %s}]"
WRONG_SIGN = ["controllers.0.name=LLC", "controllers.0.parameters.gain=-20"]


@pytest.mark.parametrize("size", [0.005, 0.1])
def test_response_with_a_mirror_is_free_of_noise_whatever_the_size_of_the_event(size: float) -> None:
    """What remains of noise is in proportion to the event: beside the response without noise, some percent."""
    sets = ["duration=12", *SETS[1:], "controllers=[]", STEP % size]
    case = load_case("two_area_deployment", sets)
    record = loop.run(case)
    clear, left = less_noise(swings_of(record, twin(case, record)))
    quiet = speeds(loop.run(load_case("two_area_deployment", [*sets, "load_noise=null", "measurement.noise={}"])))
    error = np.abs(clear.judged - quiet).max() / np.abs(quiet).max()
    assert error < 0.05
    assert np.abs(left).max() > 0.02 * 0.005 / size * np.abs(quiet).max()


@pytest.mark.parametrize("seed", [4, 7, 11])
@pytest.mark.parametrize("sets", [["controllers=[]"], ["controllers=[{name: ANFBsC, scheme: direct}]"], WRONG_SIGN])
def test_small_event_in_noise_is_not_judged_by_the_noise(sets: list[str], seed: int) -> None:
    case = load_case("two_area_deployment", ["duration=30", *SETS[1:], *sets, STEP % 0.005, f"seed={seed}"])
    record = loop.run(case)
    verdict = summarise(record, method=None, twin=twin_of(record)).verdict
    assert verdict in (("growing", "lost synchronism") if sets == WRONG_SIGN else ("damped", "undecided"))


def test_without_noise_there_is_none() -> None:
    case = load_case("two_area_deployment", [*SETS, "load_noise=null", "measurement=ideal"])
    assert twin_of(loop.run(case)) is None


def test_without_events_the_twin_has_a_pulse_whose_response_is_that_without_noise() -> None:
    case = load_case("two_area_deployment", [*SETS, "scenario=[]"])
    record = loop.run(case)
    other = twin_of(record)
    assert other is not None
    assert other.kind == PULSED
    pulse = swings_of(record, other).pulse
    quiet = loop.run(with_pulse(load_case("two_area_deployment", [*SETS, "load_noise=null", "measurement.noise={}"])))
    assert pulse is not None
    assert np.abs(pulse - speeds(quiet)).max() < 0.05 * np.abs(speeds(quiet)).max()


def test_noise_of_pmus_alone_is_noise() -> None:
    case = load_case("two_area_deployment", [*SETS, "load_noise=null"])
    record = loop.run(case)
    other = twin(case, record, kind=MIRROR)
    assert other is not None
    assert not np.array_equal(record.frames, other.record.frames)


def test_twin_of_a_recording_has_its_changes() -> None:
    case = load_case("two_area_deployment", [*SETS, "scenario=[]"])
    event = "{kind: load_step, load: load_1, change: 0.05}"
    change = RunChange(100, "/plant_sim", "plant", 0, "event", "", event)
    record = rerun(case, [change])
    other = twin_of(record)
    assert other is not None
    assert other.kind == MIRROR
    mirror = other.record
    asked = load_case("two_area_deployment", [*SETS, f"scenario=[{{time: 1.666666666, {event[1:]}]"])
    expected = loop.finish(asked, mirrored(loop.build_loop(asked)))
    assert np.array_equal(speeds(mirror), speeds(expected))


@pytest.mark.parametrize("notes", [["cut"], []])
def test_damaged_recording_and_a_node_of_one_s_own_have_none(notes: list[str]) -> None:
    record = loop.run(load_case("two_area_deployment", SETS))
    configuration = {
        **record.configuration,
        "controllers": [{**record.configuration["controllers"][0], "external": True}],
    }
    assert twin_of(replace(record, notes=notes) if notes else replace(record, configuration=configuration)) is None


def test_response_to_a_pulse_that_noise_hides_is_that_without_noise() -> None:
    pulse = "{kind: mechanical_power_step, machine: G1, change"
    scenario = f"scenario=[{pulse}: -0.02, time: 2.0}}, {pulse}: 0.0, time: 2.5}}]"
    record = loop.run(load_case("two_area_deployment", [*SETS, scenario]))
    other = twin_of(record)
    assert other is not None
    assert other.kind == WITHOUT_EVENTS  # the grid is as before
    shared = swings_of(record, other).response
    quiet = loop.run(load_case("two_area_deployment", [*SETS, scenario, "load_noise=null", "measurement.noise={}"]))
    assert shared is not None
    assert np.abs(shared[record.time_s < 2.0]).max() == 0.0
    assert np.abs(shared - speeds(quiet)).max() < 0.05 * np.abs(speeds(quiet)).max()


@pytest.mark.parametrize("delay", [0.001, 0.15, 0.3])
@pytest.mark.parametrize("seed", [21, 22])
def test_response_is_damped_as_the_linear_loop(delay: float, seed: int) -> None:
    """`benchmarks/verdicts.py` has more delays, seeds and loops."""
    link = f"link={{up: [{{stage: network, model: constant, delay: {delay}}}], down: []}}"
    case = load_case(
        "two_area_deployment",
        ["duration=40", *SETS[1:], FAULT, link, f"seed={seed}", "controllers.0.name=LLC"],
    )
    closed_loop = delayed_loop(unsupervised(case))
    modes = oscillations(closed_loop, eigen(closed_loop, sampled(closed_loop, min(link_delays(case)))), case)
    linear = min(mode.damping_ratio for mode in modes if mode.swings)
    record = loop.run(case)
    summary = summarise(record, twin=twin_of(record))
    assert summary.verdict == "damped"
    assert summary.modes[0].damping_ratio == pytest.approx(linear, abs=0.005)
