"""The equivalent of 28 April 2025: modes and exchange as the tutorial has them, what is forced, the link cut."""

from __future__ import annotations

import re
import shlex
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest

import facts_damping as fd
from facts_damping.case.loading import load_system
from facts_damping.small_signal.modal_tables import analyse

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from facts_damping.api.results import Result

TEXT = (Path(__file__).parents[1] / "docs" / "tutorial_iberia.md").read_text(encoding="utf-8")
ROWS = re.findall(r"^\| .* \| ([\d.]+) Hz \| ([\d.]+) % \|$", TEXT, re.MULTILINE)
COMMANDS = re.findall(r"^    facts-damping modes (iberia.*)$", TEXT.replace("\\\n", " "), re.MULTILINE)
FORCED_HZ, NOMINAL_MHZ = 0.63, 50e3


@pytest.mark.parametrize(("row", "command"), list(zip(ROWS, COMMANDS, strict=True)))
def test_modes_after_each_measure_are_those_of_the_table(row: tuple[str, str], command: str) -> None:
    """East-Centre-West: Iberia and the east against the centre; no mode is near 0.63 Hz."""
    name, *sets = (word for word in shlex.split(command) if word != "--set")
    swings = [mode for mode in analyse(load_system(name, sets), ["hvdc"]).swings if mode.damping_ratio < 0.3]
    mode = min(swings, key=lambda swing: abs(swing.frequency_hz - float(row[0])))
    assert (f"{mode.frequency_hz:.3f}", f"{100 * mode.damping_ratio:.1f}") == row
    assert not [m for m in swings if 0.25 < m.frequency_hz < 0.8]


def test_export_and_shape_are_those_that_are_told() -> None:
    modal = analyse(load_system("iberia"), ["hvdc"])
    flow = modal.built.flow
    iberia = [bus.name for bus in modal.system.buses if bus.position and bus.position[1] < 2.0]
    export = sum(flow.injection[list(flow.names).index(bus)].real for bus in iberia)
    assert export == pytest.approx(1.0 - 0.6, abs=0.01)  # without the link, whose power leaves CATALONIA as a load
    (mode,) = (m for m in modal.swings if m.damping_ratio < 0.03)
    assert mode.label == "interarea"
    ahead = {name: (speed / mode.shape["WEST"]).real > 0.0 for name, speed in mode.shape.items()}
    assert {name for name, same in ahead.items() if not same} == {"FRANCE", "GERMANY"}


def forced_mhz(run: Result, machine: str) -> float:
    """Swing of a machine's speed at 0.63 Hz from 20 s on, from least to most, mHz."""
    from_then = run.time_s >= 20.0
    t = run.time_s[from_then]
    speed: NDArray[np.float64] = NOMINAL_MHZ * run.arrays[f"machine.{machine}.speed_deviation_pu"][from_then]
    turn = 2.0 * np.pi * FORCED_HZ * t
    columns = np.stack([np.cos(turn), np.sin(turn), np.ones_like(t), t, t * t], axis=1)
    return 2.0 * float(np.hypot(*np.linalg.lstsq(columns, speed, rcond=None)[0][:2]))


def test_forced_oscillation_is_local_and_damping_control_changes_nothing() -> None:
    damped = fd.simulate("iberia_forced", duration=36)
    free = fd.simulate("iberia_forced", duration=36, controllers=[])
    for run in (damped, free):
        assert forced_mhz(run, "WEST") > 30.0
        assert forced_mhz(run, "FRANCE") < 2.0
    assert forced_mhz(damped, "MADRID") == pytest.approx(forced_mhz(free, "MADRID"), rel=0.05)


def test_supervisor_falls_back_when_the_link_is_cut() -> None:
    cut = {"link.up.4.model": "bernoulli", "link.up.4.loss": 1.0, "link.up.4.start": 5.0}
    (supervised,) = fd.simulate("iberia_swing", duration=8, **cut).summary["supervision"]
    assert [change["state"] for change in supervised["changes"]] == ["armed", "fallback"]
    assert supervised["changes"][1]["time_s"] == pytest.approx(5.16, abs=0.03)
