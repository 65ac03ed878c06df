from __future__ import annotations

import numpy as np
import pytest

from facts_damping.devices.base import Transmission
from facts_damping.errors import InputError
from facts_damping.parameters.files import shipped as names
from facts_damping.plant.grid.power_flow import TOLERANCE, solve
from tests.plant.running import changed, shipped

PRINTED = np.array([0.7778 + 0.1021j, 0.7777 + 0.1307j, 0.7989 + 0.0914j, 0.7778 + 0.0919j])  # on 900 MVA


@pytest.mark.parametrize("name", names("systems"))
def test_mismatch_of_every_shipped_system(name: str) -> None:
    assert solve(shipped(name)).residual < 1e-9


def test_kundur_12_6_is_as_published() -> None:
    """Published (Kundur) are four digits of the voltages and whole Mvar: half of the last one."""
    flow = solve(shipped("kundur_12_6"))
    voltage = dict(zip(flow.names, np.abs(flow.voltage), strict=True))
    published = {"B5": 1.0065, "B6": 0.9781, "B7": 0.9610, "B8": 0.9486, "B9": 0.9714, "B10": 0.9835, "B11": 1.0083}
    assert {name: voltage[name] for name in published} == pytest.approx(published, abs=5.1e-5)
    generated = [flow.generation[name] for name in ("G1", "G2", "G3", "G4")]
    np.testing.assert_allclose([s.imag * 100 for s in generated], [185, 235, 176, 202], rtol=0, atol=0.5)
    np.testing.assert_allclose([s.real * 100 for s in generated], [700, 700, 719, 700], rtol=0, atol=0.5)


def test_two_area_is_as_in_the_thesis() -> None:
    """The resistance of the SSSC moves the fourth digit."""
    flow = solve(shipped("two_area"))
    powers = np.array([flow.generation[name] for name in ("G1", "G2", "G3", "G4")]) / 9
    assert np.abs(powers - PRINTED).max() < 1.5e-4
    voltage = dict(zip(flow.names, np.abs(flow.voltage), strict=True))
    assert (voltage["B7"], voltage["B9"]) == pytest.approx((0.9916, 1.0028), abs=2e-4)


@pytest.mark.parametrize("name", names("systems"))
def test_rows_of_buses_add_up(name: str) -> None:
    """Generation less loads at each bus: at a bus without either nothing, at a machine's the dispatch."""
    system = shipped(name)
    flow = solve(system)
    rows = {row["name"]: row for row in flow.buses(system.base_power)}
    busy = {m.bus for m in system.machines} | {i.bus for i in system.inverters} | {load.bus for load in system.loads}
    busy |= {infinite.bus for infinite in system.infinite_buses}
    busy |= {bus for d in system.devices if isinstance(d, Transmission) for bus in d.buses}
    assert all(abs(row["p_mw"]) + abs(row["q_mvar"]) == 0 for bus, row in rows.items() if bus not in busy)
    for m in system.machines:
        assert rows[m.bus]["v_pu"] == pytest.approx(m.V, abs=1e-12)
        if m.P is not None:
            assert flow.generation[m.name].real * system.base_power == pytest.approx(m.P, abs=1e-7)
    losses = sum(row["p_mw"] for row in rows.values())
    assert 0 < losses < 0.05 * sum(power.real for power in flow.generation.values() if power.real > 0) * 100


@pytest.mark.parametrize("turn", [30.0, 150.0, 180.0, -150.0])
def test_vector_groups_of_transformers_turn_their_machines_alone(turn: float) -> None:
    """A machine behind a transformer of group 1, 5 or 6 has the same voltage and power, at another angle."""
    system = shipped("kundur_12_6")
    rows = [t.model_dump(by_alias=True) | {"phase_shift": turn} for t in system.transformers]
    plain, turned = solve(system), solve(changed(system, transformers=rows))
    at = [plain.names.index(m.bus) for m in system.machines]
    shift = np.where(np.isin(np.arange(len(plain.names)), at), 0.0, -np.deg2rad(turn))  # the slack's angle is held
    np.testing.assert_allclose(turned.voltage, plain.voltage * np.exp(1j * shift), rtol=0, atol=1e-8)


def test_load_beyond_what_the_grid_carries_is_refused() -> None:
    system = shipped("kundur_12_6")
    loads = [{**load.model_dump(), "P": load.P * 3} for load in system.loads]
    with pytest.raises(InputError, match=rf"kundur_12_6: power flow does not converge: .*; allowed: {TOLERANCE:g}"):
        solve(changed(system, loads=loads))


def test_bus_that_nothing_joins_is_refused() -> None:
    system = shipped("kundur_12_6")
    buses = [*(bus.model_dump() for bus in system.buses), {"name": "alone", "nominal_voltage": 230.0}]
    with pytest.raises(InputError, match="power flow does not converge"):
        solve(changed(system, buses=buses))
