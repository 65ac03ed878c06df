"""Runs beside LLC-tuned over ensembles, here those of training: medians are of the runs that the sweep makes."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest

from facts_damping.analysis.indices import INDICES
from facts_damping.errors import InputError
from facts_damping.files import dump
from facts_damping.studies import judged as study
from facts_damping.studies import sweep
from facts_damping.studies.batch import Task, one_run

if TYPE_CHECKING:
    from pathlib import Path

DRAWS = 3


def quiet(_done: int, _of: int) -> None:
    """No progress."""


def run_file(folder: Path, name: str, parameters: dict[str, float], link: str = "pdci_100ms") -> str:
    controller = {"name": "LLC", "parameters": parameters}
    content = {"system": "smib", "scenario": "training", "controllers": [controller], "link": link}
    path = folder / f"{name}.yaml"
    path.write_text(dump(content))
    return str(path)


def test_medians_are_those_of_the_sweep_with_the_runs_link(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(study, "scenarios", lambda _system: ["training"])
    weak, lost = run_file(tmp_path, "weak", {"gain": 5.0}), run_file(tmp_path, "lost", {"gain": -60.0})
    found = study.judged([weak, lost], DRAWS, 1, quiet)
    assert [one.run for one in found] == ["LLC-tuned", weak, lost]
    reference, own, gone = found
    assert reference.ratios == dict.fromkeys(INDICES, 1.0)
    assert reference.better == 0.0
    made = sweep.plan("ensemble_smib_training", [])
    changes = {"controllers": [{"name": "LLC", "parameters": {"gain": 5.0}}], "link": "pdci_100ms"}
    rows = [
        one_run(made.base._replace(set={**made.base.set, **changes}), Task("", point.changes, {}))[1]
        for point in made.points[:DRAWS]
    ]
    for name in INDICES:
        assert own.medians[name] == np.median([row[name] for row in rows])
        assert own.ratios[name] == own.medians[name] / reference.medians[name]
    assert gone.lost == gone.undamped == DRAWS
    assert set(gone.medians.values()) == {np.inf}
    assert len(study.text(found)) == 2 + len(found)


def test_runs_of_two_links_are_refused(tmp_path: Path) -> None:
    names = [run_file(tmp_path, link, {}, link) for link in ("ideal", "pdci_100ms")]
    with pytest.raises(InputError, match="allowed: runs of one system with one link"):
        study.judged(names, DRAWS, 1, quiet)
