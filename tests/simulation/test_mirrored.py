"""The mirror of a run: noise of the opposite sign, and all else the same."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from facts_damping.analysis.measures import columns, speed_differences
from facts_damping.analysis.summary import summarise
from facts_damping.case.loading import load_case
from facts_damping.case.supervision import unsupervised
from facts_damping.signals import Record, RunChange
from facts_damping.simulation import loop
from facts_damping.simulation.changes import rerun
from facts_damping.simulation.mirrored import has_mirror, mirror_of, mirrored
from facts_damping.studies.margins.linear_closed_loop import delayed_loop, eigen, link_delays, sampled
from facts_damping.studies.margins.linear_margin import oscillations

SETS = ["duration=6", "supervision=null", "arm_at=null"]
FAULT = "scenario=[{time: 2.0, kind: fault, line: line_3, location: 0.5}, {time: 2.1, kind: clear, line: line_3}]"


def speeds(record: Record) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
    return columns(speed_differences(record))


def test_before_the_event_run_and_mirror_cancel_to_second_order() -> None:
    record = loop.run(load_case("two_area_deployment", SETS))
    mirror = mirror_of(record)
    assert mirror is not None
    before = record.time_s < 2.0
    own, other = speeds(record)[before], speeds(mirror)[before]
    assert np.abs(own + other).max() < 0.05 * np.abs(own).max()
    smaller = load_case("two_area_deployment", [*SETS, "load_noise.std=0.001", "measurement.noise={}"])
    record = loop.run(smaller)
    mirror = mirror_of(record)
    assert mirror is not None
    own, other = speeds(record)[before], speeds(mirror)[before]
    assert np.abs(own + other).max() < 0.005 * np.abs(own).max()


@pytest.mark.parametrize("sets", [["load_noise=null", "measurement=ideal"], ["scenario=[]"]])
def test_without_noise_or_without_events_there_is_none(sets: list[str]) -> None:
    case = load_case("two_area_deployment", [*SETS, *sets])
    assert not has_mirror(case)
    assert mirror_of(loop.run(case)) is None


def test_noise_of_pmus_alone_is_noise() -> None:
    case = load_case("two_area_deployment", [*SETS, "load_noise=null"])
    assert has_mirror(case)
    record = loop.run(case)
    mirror = mirror_of(record)
    assert mirror is not None
    assert not np.array_equal(record.frames, mirror.frames)


def test_the_mirror_of_a_recording_has_its_changes() -> None:
    case = load_case("two_area_deployment", [*SETS, "scenario=[]"])
    event = "{kind: load_step, load: load_1, change: 0.05}"
    change = RunChange(100, "/plant_sim", "plant", 0, "event", "", event)
    record = rerun(case, [change])
    mirror = mirror_of(record)
    assert mirror is not None
    asked = load_case("two_area_deployment", [*SETS, f"scenario=[{{time: 1.666666666, {event[1:]}]"])
    expected = loop.finish(asked, mirrored(loop.build_loop(asked)))
    assert np.array_equal(speeds(mirror), speeds(expected))


@pytest.mark.parametrize("notes", [["cut"], []])
def test_a_damaged_recording_and_a_node_of_one_s_own_have_none(notes: list[str]) -> None:
    record = loop.run(load_case("two_area_deployment", SETS))
    own = {**record.configuration, "controllers": [{**record.configuration["controllers"][0], "external": True}]}
    assert mirror_of(replace(record, notes=notes) if notes else replace(record, configuration=own)) is None


@pytest.mark.parametrize("delay", [0.001, 0.15, 0.3])
@pytest.mark.parametrize("seed", [21, 22])
def test_the_response_is_damped_as_the_linear_loop(delay: float, seed: int) -> None:
    """`benchmarks/verdicts.py` has more delays, seeds and loops."""
    link = f"link={{up: [{{stage: network, model: constant, delay: {delay}}}], down: []}}"
    case = load_case(
        "two_area_deployment",
        ["duration=40", *SETS[1:], FAULT, link, f"seed={seed}", "controllers.0.name=LLC"],
    )
    made = delayed_loop(unsupervised(case))
    modes = oscillations(made, eigen(made, sampled(made, min(link_delays(case)))), case)
    linear = min(mode.damping_ratio for mode in modes if mode.swings)
    record = loop.run(case)
    found = summarise(record, mirror=mirror_of(record))
    assert found["verdict"] == "damped"
    assert found["modes"][0]["damping_ratio"] == pytest.approx(linear, abs=0.005)
