"""Divisions: what a controller knows, by its kind and by where its signals are from."""

from __future__ import annotations

from typing import Any

import pytest

from facts_damping.case.loading import load_case
from facts_damping_studies.score.division import division_of


@pytest.mark.parametrize(
    ("system", "device", "signal", "row", "division"),
    [
        ("two_area", "sssc", "frequency", {"name": "LLC"}, "open"),
        ("two_area", "sssc", "power_rate", {"name": "LLC"}, "open, local"),  # of the tie, at the device's bus
        ("two_area", "statcom", "voltage", {"name": "LLC"}, "open, local"),
        ("two_area", "sssc", "frequency", {"name": "LQG"}, "model"),
        ("two_area", "sssc", "frequency", {"name": "LLC-tuned"}, "model"),
        ("two_area", "sssc", "frequency", {"name": "ANFBsC", "scheme": "direct"}, "model"),
        ("minniwecc", "pdci", "hertz", {"name": "LLC"}, "open"),  # from both ends of the link
        ("two_area_ibr", "pod_p", "f34", {"name": "LLC"}, "open"),
    ],
)
def test_division_is_by_design_and_place(
    system: str, device: str, signal: str, row: dict[str, Any], division: str
) -> None:
    sets = ["scenario=[]", f"devices=[{device}]", f"system={system}", "profile=deployment"]
    law = ", ".join(f"{name}: {value}" for name, value in {**row, "devices": [device], "signals": [signal]}.items())
    case = load_case(None, [*sets, f"controllers=[{{{law.replace(chr(39), '')}}}]"])
    assert division_of(case, reads_plant=False) == division
    assert division_of(case, reads_plant=True) == division.replace("open", "model")
