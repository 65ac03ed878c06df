"""The study of inverters: its page follows from its tables, these from the grid; unseen cases are unseen."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest
import yaml

from facts_damping_reproduction import result_figures
from facts_damping_reproduction.adaptation.cases import training
from facts_damping_reproduction.inverters import comparison, laws, pages, study
from facts_damping_reproduction.inverters.comparison import Compared

DOCS = Path(__file__).parents[2] / "docs"


def table(name: str) -> list[dict[str, Any]]:
    """A table with numbers, and none where a cell is empty."""
    rows = result_figures.rows(DOCS / "images" / "inverters" / f"{name}.csv")
    return [{key: yaml.safe_load(value or "null") for key, value in row.items()} for row in rows]


def test_page_follows_from_its_tables() -> None:
    built = pages.page({name: table(name) for name in pages.NAMES})
    linked = re.sub(r"\]\(([a-z]+\.(?:png|csv))\)", r"](images/inverters/\1)", built)
    assert (DOCS / "inverters_results.md").read_text(encoding="utf-8") == linked


@pytest.mark.parametrize(("kind", "place"), [("following", (1, 0)), ("droops", (1, 1)), ("virtual machine", (0, 1))])
def test_modes_of_the_table_are_those_of_the_grid(kind: str, place: tuple[int, int]) -> None:
    mode = study.interarea(study.modal(study.grid(kind, 0.5, place)).modes)
    assert mode is not None
    name = next(name for name, areas in study.plan()["modes"]["places"].items() if tuple(areas) == place)
    row = pages.at(table("modes"), stabilisers=pages.WITH, kind=kind, place=name, share=0.5)
    assert (mode.damping_ratio, mode.frequency_hz) == pytest.approx((row["interarea"], row["interarea_hz"]), rel=1e-4)


def test_regulators_of_the_guide_make_half_of_an_area_oscillate() -> None:
    guide = {f"system.inverter_shares.1.controls.1.{name}": value for name, value in (("Kp", 18.0), ("Ki", 5.0))}
    modes = study.modal({**study.grid("following", 0.5, (0, 1)), **guide}).modes
    fastest = max(modes, key=lambda mode: mode.eigenvalue.real)
    assert fastest.eigenvalue.real > 1.0
    assert fastest.frequency_hz == pytest.approx(7.0, abs=0.5)


def test_unseen_cases_share_no_draw_with_training_and_are_of_both_kinds() -> None:
    asked = study.plan()["search"]
    known = [sets["seed"] for sets in training(asked["cases"], asked["begin"], 8.0)]
    unseen = comparison.cases()
    assert [sum(case["kind"] == kind for case in unseen) for kind in ("nominal", "wrong model")] == [12, 12]
    seeds = [case["set"]["seed"] for case in unseen]
    assert len({*seeds, *known}) == len(seeds) + len(known)


def test_sign_of_a_gain_is_chosen_with_the_delay() -> None:
    """Residues: 158 and 98 deg; 50 ms and half a frame at 0.86 Hz take 18 deg, and leave POD-Q below 90."""
    assert laws.unit_gain(laws.MAIN, "POD-Q") < 0.0 < laws.unit_gain(laws.MAIN, "POD-P")


def outcomes(*indices: float) -> list[dict[str, Any]]:
    return [{"lost": False, "index": index, "effort": 0.0} for index in indices]


@pytest.mark.parametrize(
    ("vsm", "pss", "pod", "ratios", "by_index", "by_ratio"),
    [
        (1.0, 1.1, 2.0, {"VSM": 0.2, "PSS": 0.2, "POD-P": 0.1}, ["confirmed"] * 3, ["confirmed"] * 3),
        (3.0, 1.0, 2.0, {"VSM": 0.1, "PSS": 0.2, "POD-P": 0.15}, ["refuted", "refuted", "confirmed"],
         ["refuted", "refuted", "confirmed"]),
    ],
)  # fmt: skip
def test_claim_is_decided_part_by_part(
    monkeypatch: pytest.MonkeyPatch,
    vsm: float,
    pss: float,
    pod: float,
    ratios: dict[str, float],
    by_index: list[str],
    by_ratio: list[str],
) -> None:
    monkeypatch.setattr(comparison, "damping", lambda arm, _: {"damping_ratio": ratios.get(arm.name, 0.05)})
    kinds = ["nominal", "nominal", "wrong model", "wrong model"]
    rows = {(name, 0): outcomes(*[index] * 4) for name, index in (("VSM", vsm), ("PSS", pss), ("POD-P", pod))}
    searches = {("POD-P", 0): {"value": -1.0, "rows": []}, ("POD-Q", 0): {"value": -0.5, "rows": []}}
    parts = comparison.claim(Compared(searches, rows, kinds))
    assert [row["against"] for row in parts] == ["PSS", "POD-P", "POD-P"]
    assert ([row["by_index"] for row in parts], [row["by_damping_ratio"] for row in parts]) == (by_index, by_ratio)
    assert pages.verdict(parts, "by_index") == ("confirmed" if "refuted" not in by_index else "refuted")
