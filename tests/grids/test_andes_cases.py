"""PSS/E cases of others, as they come inside ANDES's wheel: imported by the command, their modes beside ANDES's."""

from __future__ import annotations

import json
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import pytest

from facts_damping.case.loading import load_system
from facts_damping.cli.main import main
from facts_damping.parameters.events import Scenario
from facts_damping.plant.build import build
from facts_damping.small_signal.eigenmodes import modes
from facts_damping.small_signal.linearisation import linearise
from tests.andes_cases import CASES, with_torques
from tests.plant.running import follow

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from facts_damping.parameters.plant.system import System
    from facts_damping.plant.build import Built

REFERENCE: dict[str, Any] = json.loads((Path(__file__).parents[1] / "data" / "andes_cases.json").read_text())
SAME = 1e-4  # 1/s
# Where a case is understood otherwise, how far modes may lie apart, 1/s: ANDES gives two machines at one bus no
# reactive power, here they share it by their ratings (docs/system_files.md).
APART = {"npcc_full": 7e-3}
PAIRS = sorted(
    (str(raw.relative_to(CASES)), str(dyr.relative_to(CASES)))
    for dyr in CASES.glob("*/*.dyr")
    for raw in [dyr.with_suffix(".raw"), dyr.parent / f"{dyr.parent.name}.raw"][
        : 1 + (not dyr.with_suffix(".raw").exists())
    ]
    if raw.exists()
)


class Rest(NamedTuple):
    """A case at its start."""

    system: System
    built: Built
    matrix: NDArray[np.float64]  # of states


@cache
def imported(raw: str, dyr: str) -> Rest:
    with TemporaryDirectory() as folder:
        path = f"{folder}/case.yaml"
        assert main(["import", str(CASES / raw), str(CASES / dyr), "--out", path]) == 0
        system = with_torques(load_system(path))
    built = build(system, [], [])
    return Rest(system, built, linearise(built)[0])


def test_there_are_cases() -> None:
    """Fetched by `make test-setup`; without them nothing of this file would be tested."""
    assert len(PAIRS) == 8


@pytest.mark.parametrize(("raw", "dyr"), PAIRS)
def test_andes_case_is_imported_with_a_power_flow_and_swing_modes(raw: str, dyr: str) -> None:
    system, built, matrix = imported(raw, dyr)
    assert built.flow.residual < 1e-8
    assert np.isfinite(matrix).all()
    assert any(mode.label not in ("common", "control") for mode in modes(matrix, built.state_names, system))


@pytest.mark.parametrize("name", REFERENCE)
def test_modes_are_those_of_andes(name: str) -> None:
    reference = REFERENCE[name]
    ours = np.asarray(np.linalg.eigvals(imported(reference["raw"], reference["dyr"]).matrix))
    apart = [float(np.abs(ours - complex(*pair)).min()) for pair in reference["modes"]]
    assert max(apart) < APART.get(name, SAME)
    assert np.median(apart) < SAME


def test_power_flow_and_a_fault_of_140_buses_are_those_of_andes() -> None:
    """ANDES's fractions of reactive power at buses 23 and 54 are others: nothing but the machines there knows."""
    theirs = json.loads((Path(__file__).parents[1] / "data" / "npcc_andes.json").read_text())
    system, start, _ = imported(REFERENCE["npcc_full"]["raw"], REFERENCE["npcc_full"]["dyr"])
    flow = start.flow
    voltage = {name: complex(v) for name, v in zip(flow.names, flow.voltage, strict=True)}
    assert len(theirs["voltages"]) == 140
    for bus, (magnitude, angle) in theirs["voltages"].items():
        assert abs(voltage[f"B{bus}"] - magnitude * np.exp(1j * angle)) < 1e-6, bus
    fault = {"time": theirs["on"], "kind": "fault", "bus": f"B{theirs['bus']}", "x": theirs["x"]}
    events = [fault, {"time": theirs["off"], "kind": "clear", "bus": fault["bus"]}]
    listed = Scenario.model_validate({"name": "fault", "duration": 5, "events": events}).events
    trace = follow(build(system, [], listed), theirs["t"])
    swings = [w - w.mean(axis=1, keepdims=True) for w in (trace.speeds, np.array(theirs["speeds"]) - 1.0)]
    apart = np.abs(swings[0] - swings[1]) / np.abs(swings[1]).max()
    assert apart.max() < 0.01
    assert np.median(apart.max(axis=0)) < 1e-3
