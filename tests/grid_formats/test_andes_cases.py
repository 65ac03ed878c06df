"""PSS/E cases of others, as they come inside ANDES's wheel: imported by the command, their modes beside ANDES's."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from facts_damping.case.loading import load_system
from facts_damping.cli.main import main
from facts_damping.plant.build import build
from facts_damping.small_signal import linearisation
from tests.andes_cases import CASES

if TYPE_CHECKING:
    from facts_damping.parameters.system import System

REFERENCE: dict[str, Any] = json.loads((Path(__file__).parents[1] / "data" / "andes_cases.json").read_text())
SAME = 1e-4  # 1/s
# Where a case is understood otherwise, how far modes may lie apart, 1/s: ANDES gives two machines at one bus no
# reactive power, here they share it by their ratings (docs/import.md).
APART = {"npcc_full": 7e-3}
PAIRS = sorted(
    (str(raw.relative_to(CASES)), str(dyr.relative_to(CASES)))
    for dyr in CASES.glob("*/*.dyr")
    for raw in [dyr.with_suffix(".raw"), dyr.parent / f"{dyr.parent.name}.raw"][
        : 1 + (not dyr.with_suffix(".raw").exists())
    ]
    if raw.exists()
)


def imported(raw: str, dyr: str, folder: Path) -> System:
    assert main(["import", str(CASES / raw), str(CASES / dyr), "--out", str(folder / "case.yaml")]) == 0
    return load_system(str(folder / "case.yaml"))


def test_there_are_cases() -> None:
    """Fetched by `make test-setup`; without them nothing of this file would be tested."""
    assert len(PAIRS) == 8


@pytest.mark.parametrize(("raw", "dyr"), PAIRS)
def test_every_pair_is_imported_and_stays_at_rest(raw: str, dyr: str, tmp_path: Path) -> None:
    system = imported(raw, dyr, tmp_path)
    built = build(system, [], [])
    assert built.flow.residual < 1e-8
    matrix, _ = linearisation.linearise(built)
    assert np.isfinite(matrix).all()
    assert any(one.label not in ("common", "control") for one in linearisation.modes(matrix, built.state_names, system))


@pytest.mark.parametrize("name", REFERENCE)
def test_modes_are_those_of_andes(name: str, tmp_path: Path) -> None:
    reference = REFERENCE[name]
    system = imported(reference["raw"], reference["dyr"], tmp_path)
    ours = np.asarray(np.linalg.eigvals(linearisation.linearise(build(system, [], []))[0]))
    apart = [float(np.abs(ours - complex(*pair)).min()) for pair in reference["modes"]]
    assert max(apart) < APART.get(name, SAME)
    assert np.median(apart) < SAME
