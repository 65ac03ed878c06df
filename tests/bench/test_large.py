"""The large case of the comparison: the files inside ANDES's wheel, our runs of them."""

from __future__ import annotations

import re
from collections import Counter

import pytest

from facts_damping.cli.main import main
from facts_damping_bench import large, large_ours
from facts_damping_bench.figures import difference
from facts_damping_bench.grid import FAULT_END, RATE, grid, swings
from facts_damping_bench.programs import LARGE, missing
from tests.andes_cases import CASES
from tests.commands import assert_one_line


@pytest.fixture
def large_case(monkeypatch: pytest.MonkeyPatch) -> dict[str, object]:
    folder = CASES / "npcc"
    monkeypatch.setattr(large_ours, "files", lambda: (folder / "npcc.raw", folder / "npcc_full.dyr"))
    return large_ours.prepare(grid(), folder)


def test_large_case_has_the_counts_that_its_text_states(large_case: dict[str, list[dict[str, object]]]) -> None:
    models = Counter(machine["model"] for machine in large_case["machines"])
    counts = [
        len(large_case["buses"]),
        models.total(),
        models["classical"],
        len(large_case["exciters"]),
        len(large_case["governors"]),
    ]
    assert re.findall(r"\d+", large.SHOWN.text) == [str(count) for count in counts]


def test_steps_meet_instants() -> None:
    for row in LARGE.values():
        assert all(1.0 / RATE / step == pytest.approx(round(1.0 / RATE / step)) for step in row.steps)


def test_our_errors_are_small_though_limits_act(large_case: dict[str, object]) -> None:
    """Regulators meet their limits after the fault: errors do not fall with the fourth power there."""
    case = grid()
    courses = {step: swings(large_ours.run(large_case, case, step)) for step in (0.01, 0.005, 0.000625)}
    assert courses[0.01].shape == (48, round((20.0 - FAULT_END) * RATE))
    errors = [difference(courses[step], courses[0.000625]) for step in (0.01, 0.005)]
    assert errors[0] < 4e-3
    assert errors[1] < 2e-3


@pytest.mark.skipif(not missing(("andes",)), reason="ANDES is here: it would run for ten minutes")
def test_without_andes_it_says_so(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bench", "--large"]) == 2
    assert (
        capsys.readouterr()
        .err.strip()
        .endswith("--large: its files come inside ANDES: not installed (pip install andes); allowed: with ANDES")
    )
    assert_one_line(2, ["bench", "dpsim", "--large"], "PROGRAM: 'dpsim' given; allowed: andes", capsys)
