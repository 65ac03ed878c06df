"""What holds for devices of every kind, by the table of kinds; and several of one kind beside each other."""

from __future__ import annotations

from functools import cache
from itertools import permutations
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from facts_damping.devices.table import KINDS as TABLE
from facts_damping.parameters.plant.placement import place
from facts_damping.plant.converters import dispatch
from tests.plant.inverters import following
from tests.plant.running import changed, follow, frame_times, plant, shipped, slopes

if TYPE_CHECKING:
    from facts_damping.parameters.plant.system import System
    from facts_damping.plant.build import Built

# One of each kind: a new kind must be entered here.
LIMITS = {"setpoint_max": 0.04, "rate_max": 2.0}
ROWS: dict[str, dict[str, Any]] = {
    "sssc": {"line": "line_1", **LIMITS},
    "statcom": {"bus": "B9", "I_max": 1.0, "Ki": 100.0, **LIMITS},
    "svc": {"bus": "B9", "B_max": 2.0, "B_min": -1.0, "K": 25.0, **LIMITS},
    "hvdc": {"from": "B7", "to": "B9", "P": 50.0, "P_max": 90.0, "pf_from": 0.9, "pf_to": 0.6, "K": 2.0, **LIMITS},
    "load_modulation": {"bus": "B9", "pf": 0.6, **LIMITS},
    "tcsc": {"line": "line_2", "X": 0.004, "X_min": 0.0, "X_max": 0.1, **LIMITS},
    "exciter_input": {"machine": "G1", **LIMITS},
    "inverter_input": {"inverter": "I1", "input": "Vplant", **LIMITS},
    "csvgn1": {"bus": "B9", "MBASE": 300.0, "CBASE": 200.0, "Q": 40.0, "K": 8.0, "T3": 0.15, "T5": 0.02, **LIMITS},
    "bess": {"bus": "B9", "S_rated": 60.0, "E_rated": 30.0, "K": 40.0, **LIMITS},
}
SECOND: dict[str, dict[str, Any]] = {
    "sssc": {"line": "line_4", "end": "to", "tau": 0.01, "xs": 0.002, **LIMITS},
    "statcom": {"bus": "B7", "I_max": 2.0, "Ki": 60.0, "droop": 0.02, "g": 0.03, **LIMITS},
    "svc": {"bus": "B7", "B_max": 1.0, "B_min": -0.5, "K": 10.0, "T": 0.1, **LIMITS},
    "hvdc": {"from": "B6", "to": "B10", "P": 30.0, "P_max": 60.0, "R": 0.05, "loss": 0.01, "pf_to": 0.6, **LIMITS},
    "load_modulation": {"bus": "B7", "pf": 0.5, "V_min": 0.8, **LIMITS},
    "tcsc": {"line": "line_3", "X": 0.002, "X_min": -0.05, "X_max": 0.1, "T": 0.02, **LIMITS},
    "exciter_input": {"machine": "G3", **LIMITS},
    "inverter_input": {"inverter": "I2", "input": "Qplant", **LIMITS},
    "csvgn1": {"bus": "B7", "MBASE": 200.0, "CBASE": 80.0, "K": 9.0, "T1": 0.1, "T3": 0.2, "T5": 0.01, **LIMITS},
    "bess": {"bus": "B7", "S_rated": 40.0, "E_rated": 0.1, "K": 30.0, "eta_in": 0.8, **LIMITS},
}
KINDS = list(TABLE)
IN_GRID = [kind for kind in KINDS if not kind.endswith("_input")]  # with a port
STEP = {"time": 0.2, "kind": "load_step", "load": "load_2", "change": -0.05}


@cache
def system(name: str = "two_area") -> System:
    """A shipped system with two devices of each kind, `sssc_1` and `sssc_2` and so on, and no other."""
    rows = [{"name": f"{kind}_1", "kind": kind, **ROWS[kind]} for kind in KINDS]
    rows += [{"name": f"{kind}_2", "kind": kind, **SECOND[kind]} for kind in KINDS]
    shipped_rows = [d.model_dump(by_alias=True) for d in shipped(name).devices if d.kind == "sssc"]
    two = [following("I1", "B6", 60.0, Q=10.0), following("I2", "B10", 40.0, Q=5.0, rating=80.0)]
    inverters, controls = [row for row, _ in two], [control for _, pair in two for control in pair]
    tables = {"inverters": inverters, "inverter_controls": controls, "devices": [*shipped_rows, *rows]}
    return place(changed(shipped(name), **tables))


def states_of(built: Built, name: str) -> list[int]:
    """Where a device's states are."""
    return [i for i, state in enumerate(built.state_names) if state.startswith(f"{name}.")]


@pytest.mark.parametrize("kind", KINDS)
def test_device_kind_writes_its_own_states_and_no_others(kind: str) -> None:
    """Its branch in each of the compiled functions is there, and gives numbers."""
    built = plant(system(), installed=[f"{kind}_1"])
    d, x = built.plant.devices[0], built.state.x
    size = 4.0 if kind in ("sssc", "tcsc") else 1.0
    dx = np.full_like(x, np.nan)
    dispatch.derivatives(int(d["kind"]), d, x, 0.01, size, dx)
    dispatch.other_derivatives(int(d["kind"]), d, x, 0.01, size, dx)
    dispatch.between_derivatives(int(d["kind"]), d, x, 1.0 + 0.0j, 0.9 + 0.1j, dx)
    assert list(np.flatnonzero(np.isfinite(dx))) == states_of(built, f"{kind}_1")
    assert len(states_of(built, f"{kind}_1")) == d["states"] == len(TABLE[kind].states)
    assert np.isfinite(dispatch.characteristic(int(d["kind"]), d, x, 0.01, size)).all()
    two = TABLE[kind].other_end is not None
    assert np.isfinite(dispatch.other_characteristic(int(d["kind"]), d, x, 0.01, size)[0]) == two == (d["other"] > 0)


def test_unknown_device_kind_gives_nan() -> None:
    """So that a forgotten branch ends the run, and does not take another's law."""
    d = plant(system(), installed=["statcom_1"]).plant.devices.copy()[0]
    d["kind"] = -1
    assert np.isnan(dispatch.characteristic(int(d["kind"]), d, np.zeros(9), 0.0, 1.0)[0])
    assert np.isnan(dispatch.other_characteristic(int(d["kind"]), d, np.zeros(9), 0.0, 1.0)[0])


@pytest.mark.parametrize("name", ["two_area", "kundur_12_6_thyristor"])
def test_devices_of_all_kinds_start_at_rest_together(name: str) -> None:
    every = [d.name for d in system(name).devices]
    assert np.abs(slopes(plant(system(name), installed=every))).max() < 1e-8


@pytest.mark.parametrize("kind", KINDS)
def test_setpoints_are_limited_ramped_and_recorded(kind: str) -> None:
    """0.04 p.u. at 2 p.u./s from 50 ms on, back from 150 ms on; what is not finite is passed over."""
    built = plant(system(), installed=[f"{kind}_1"])
    times = np.arange(0.0, 0.25, 0.003)
    trace = follow(built, times, [(0.05, 0.7), (0.1, float("nan")), (0.15, -0.01)])
    expected = np.clip(2 * (times - 0.05), 0, 0.04) - np.clip(2 * (times - 0.15), 0, 0.05)
    np.testing.assert_allclose(trace.devices["reference"][:, 0], expected, rtol=0, atol=1e-8)
    assert set(trace.devices["setpoint"][:, 0]) == {0.0, 0.04, -0.01}
    assert np.isfinite([trace.devices[name] for name in ("current", "active_power", "reactive_power")]).all()
    assert kind not in IN_GRID or np.ptp(trace.devices["reactive_power"]) > 1e-3


@pytest.mark.parametrize("kind", KINDS)
def test_two_of_a_kind_act_alike_in_any_order(kind: str) -> None:
    """Rows, states and setpoints go with the device, not with its place in the list."""
    names = [f"{kind}_1", f"{kind}_2"]
    courses = {}
    for order in permutations(names):
        built = plant(system(), STEP, installed=order)
        targets = {names[0]: 0.02, names[1]: -0.01}
        trace = follow(built, frame_times(1), [(0.1, targets[name], d) for d, name in enumerate(order)])
        assert trace.sound.all()
        courses[order] = (
            {state: trace.x[:, i] for i, state in enumerate(built.state_names)},
            {name: trace.devices[:, d] for d, name in enumerate(order)},
        )
    (first, truth), (second, other) = courses.values()
    for state, course in first.items():
        np.testing.assert_allclose(course, second[state], rtol=0, atol=1e-8)
    for name in names:
        for field in ("reference", "current", "active_power", "reactive_power"):
            np.testing.assert_allclose(truth[name][field], other[name][field], rtol=0, atol=1e-7)
    field = "reactive_power" if kind in IN_GRID else "reference"
    assert np.abs(truth[names[0]][field] - truth[names[1]][field]).max() > 0.01


@pytest.mark.parametrize("d", [0, 1])
@pytest.mark.parametrize("kind", IN_GRID)
def test_setpoint_moves_the_device_that_it_is_for(kind: str, d: int) -> None:
    """Within 60 ms, what it gives changes, and the other's reference does not."""
    trace = follow(plant(system(), installed=[f"{kind}_1", f"{kind}_2"]), frame_times(0.06, 500), [(0.0, 0.03, d)])
    moved = [np.ptp(trace.devices[name], axis=0) for name in ("active_power", "reactive_power")]
    assert any(change[d] > max(0.029, 2 * change[1 - d]) for change in moved)
    assert (trace.reference[-1, d], trace.reference[-1, 1 - d]) == (0.03, 0.0)


def test_two_of_each_kind_run_together() -> None:
    """A fault and setpoints to all; the interarea swing is there and nothing is blocked but in the fault."""
    every = [f"{kind}_{i}" for i in (1, 2) for kind in KINDS]
    fault = {"time": 0.5, "kind": "fault", "bus": "B9", "duration": 0.05}
    built = plant(system("kundur_12_6_thyristor"), fault, installed=every)
    trace = follow(built, frame_times(1.5), [(0.1, 0.01 * (-1) ** d, d) for d in range(len(every))])
    assert trace.sound.all()
    after = trace.t > 0.56
    assert not trace.devices["blocked"][after].any()
    assert np.ptp(trace.speeds[after], axis=0).min() > 3e-4
