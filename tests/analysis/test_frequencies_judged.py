"""Speed differences where there is no rotor: the frequency that a PMU reports at an inverter, or at a bus."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest

from facts_damping.analysis.measures import measure_weights, speed_differences
from facts_damping.analysis.summary import summarise
from facts_damping.case.loading import make_case
from facts_damping.errors import InputError
from facts_damping.signals import CHANNELS
from facts_damping.simulation import loop
from facts_damping.simulation.twins import with_pulse
from tests.plant.running import shipped
from tests.small_signal.test_inverter_modes import two_batteries
from tests.two_plants import path

FREQUENCY = list(CHANNELS).index("frequency")
STEP = {"time": 0.5, "kind": "load_step", "load": "load", "change": 0.05}


def case(system: Any, **fields: Any) -> Any:
    content = {"devices": [], "controllers": [], "scenario": [STEP], "duration": 3.0, **fields}
    return make_case({"system": json.loads(system.model_dump_json(by_alias=True)), **content}, "test")


def test_frequencies_are_judged_where_there_is_no_machine() -> None:
    record = loop.run(case(two_batteries(), duration=12.0))
    hertz = record.frames[:, :, FREQUENCY]
    (name,) = differences = speed_differences(record)
    assert name == "WEST-EAST"
    np.testing.assert_allclose(differences[name], (hertz[:, 0] - hertz[:, 1]) / 60.0, rtol=0, atol=1e-15)
    assert np.ptp(differences[name]) > 1e-5
    result: Any = summarise(record)
    assert result.stable
    assert result.verdict == "damped"


def test_frames_that_are_lost_lie_between_those_that_are_not() -> None:
    lost = {"kind": "invalid", "pmus": ["WEST"], "start": 1.0, "duration": 0.1}
    record = loop.run(case(two_batteries(), measurement={"bad_data": [lost]}))
    whole = loop.run(case(two_batteries()))
    gone = np.isnan(record.frames[:, 0, FREQUENCY])
    assert 5 <= gone.sum() <= 7
    (some,), (every,) = speed_differences(record).values(), speed_differences(whole).values()
    np.testing.assert_array_equal(some[~gone], every[~gone])
    assert np.abs(some - every).max() < 0.05 * np.ptp(every)


def test_rotors_come_first() -> None:
    """Inverters count where there are fewer than two machines with PMUs."""
    content = shipped(path("battery")).model_dump(by_alias=True) | {"measures": {}}
    assert list(measure_weights({"system": content})) == ["G1-G2"]
    fewer = content | {"pmus": [pmu for pmu in content["pmus"] if pmu["name"] != "G2"]}
    assert list(measure_weights({"system": fewer})) == ["G1-BATTERY"]


def test_signal_of_frequencies_is_a_measure() -> None:
    """Of a machine the true speed counts."""
    content = shipped(path("solar")).model_dump(by_alias=True)
    content["signals"] = {"f": {"channel": "frequency", "weights": {"G1": 1.0, "SOLAR": -1.0}}}
    content["measures"] = {"local": ["f"]}
    run = {"devices": [], "controllers": [], "scenario": [STEP], "duration": 2.0}
    record = loop.run(make_case({"system": content, **run}, "test"))
    expected = record.machines["speed_deviation"][:, 0] - (record.frames[:, 2, FREQUENCY] / 60.0 - 1.0)
    np.testing.assert_allclose(speed_differences(record)["f"], expected, rtol=0, atol=1e-15)


def test_laws_and_pulses_that_need_a_rotor_are_refused() -> None:
    battery = shipped(path("battery")).model_dump(by_alias=True)
    battery["signals"] = {"f": {"channel": "frequency", "weights": {"G1": 1.0, "BATTERY": -1.0}}}
    lqg = {"name": "LQG", "devices": ["pod_p"], "signals": ["f"]}
    run = {"system": battery | {"measures": {"local": ["f"]}}, "devices": ["pod_p"], "controllers": [lqg]}
    with pytest.raises(InputError, match="measures: BATTERY given, without a rotor; allowed: for LQG G1, G2"):
        loop.run(make_case({**run, "scenario": [], "duration": 1.0}, "test"))
    bare = case(two_batteries(), scenario=[])
    bare.system.loads.clear()
    with pytest.raises(InputError, match="no load and no machine given, in which a pulse could be"):
        with_pulse(bare)
