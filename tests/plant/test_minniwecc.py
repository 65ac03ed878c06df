"""Western North America, with its intertie modulated; beside PSTess it is in tests/validation."""

from __future__ import annotations

from collections import Counter

import pytest

from facts_damping.case.loading import load_case
from facts_damping.findings import itae
from facts_damping.simulation.loop import run
from facts_damping_views.bus_places import places
from tests.plant.running import shipped


def test_minniwecc_has_the_parts_of_its_description() -> None:
    system = shipped("minniwecc")
    assert (len(system.buses), len(system.machines), len(system.pmus)) == (122, 34, 36)
    assert len({m.area for m in system.machines}) == 5
    terminals = {m.bus for m in system.machines}
    high = {t.to_bus for t in system.transformers if t.from_bus in terminals}
    assert high - set(system.pmu_buses().values()) == {"B90"}  # where G16 has a second one
    at = places(system)
    assert all(at["B119"][1] > at[bus][1] > at["B49"][1] for bus in ("B24", "B33"))  # Alberta, Celilo, Colstrip, Sylmar
    assert Counter(bus.position is None for bus in system.buses) == {False: 122}


@pytest.mark.parametrize("scenario", ["brake", "colstrip", "coi"])
def test_modulated_intertie_damps_its_scenarios(scenario: str) -> None:
    swings = []
    for control in ([], ["controllers=[]"]):
        record = run(load_case("minniwecc", [f"scenario={scenario}", *control]))
        assert record.in_synchronism.all()
        swings.append(itae(record))
    assert swings[0] < 0.7 * swings[1]
