"""The public face: the record of a command, the same errors, nothing loaded before it is asked for."""

from __future__ import annotations

import subprocess
import sys

import pytest

import facts_damping as fd
from facts_damping import api
from facts_damping.case.loading import load_case
from facts_damping.simulation import loop


def test_simulate_is_the_run_of_the_commands_bit_for_bit() -> None:
    ours = fd.simulate("two_area_large", link="delay_100ms", duration=2, **{"controllers.0.parameters.gain": 12})
    sets = ["link=delay_100ms", "duration=2", "controllers.0.parameters.gain=12"]
    theirs = loop.run(load_case("two_area_large", sets))
    assert ours.frames.tobytes() == theirs.frames.tobytes()
    assert fd.summarise(ours)["indices"] == fd.summarise(theirs)["indices"]


def test_errors_are_those_of_the_commands() -> None:
    with pytest.raises(fd.InputError, match="'nowhere' given; allowed: "):
        fd.simulate(link="nowhere")


def test_modes_of_a_system() -> None:
    found = fd.modes("two_area", ["sssc"])
    assert f"{found.swings[0].frequency_hz:.4f}" == "0.6297"
    assert fd.modes("two_area", []).devices == []


def test_all_that_is_public_is_there() -> None:
    assert list(fd.PUBLIC) == api.__all__
    assert all(callable(getattr(fd, name)) for name in fd.PUBLIC)


def test_nothing_is_loaded_before_it_is_asked_for() -> None:
    script = "import sys, facts_damping; print(len([m for m in sys.modules if m.startswith(('numpy', 'numba'))]))"
    told = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert told.stdout == "0\n"
    with pytest.raises(AttributeError, match="it has FactsDampingError, InputError"):
        _ = fd.nothing
