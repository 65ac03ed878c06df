"""Names of runs: of what was given by name, of files, and of what stands inline."""

from __future__ import annotations

from typing import Any

import pytest

from facts_damping.case.names import asked_label


@pytest.mark.parametrize(
    ("asked", "name"),
    [
        ({}, "two_area-large-LLC-ideal"),
        ({"system": "results/design/system.yaml", "scenario": "/a/b/fault.yml"}, "design_system-b_fault-LLC-ideal"),
        ({"system": "../system.yaml", "scenario": "/x.yaml"}, "system-x-LLC-ideal"),
        ({"system": "/a/b/v1.2.yaml"}, "b_v1.2-large-LLC-ideal"),
        ({"scenario": [{"time": 1.0, "kind": "fault", "bus": "B8"}], "link": {"up": []}}, "two_area-fault-LLC-custom"),
        ({"scenario": [], "controllers": [], "measurement": "m_class"}, "two_area-steady-none-ideal-m_class"),
    ],
)
def test_runs_name_is_short_and_of_what_was_given(asked: dict[str, Any], name: str) -> None:
    assert asked_label({"system": "two_area", "scenario": "large", **asked}) == name
