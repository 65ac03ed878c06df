"""Inverters in faults: the network's solution in closed form, its limits, and no run that ends by numerics."""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from facts_damping.parameters.plant.system import System
from facts_damping.plant import build as plant_build
from facts_damping.plant.dynamics import solve_network
from facts_damping.plant.inverters import inverter as kernel
from facts_damping.plant.model import copy, workspace
from facts_damping.plant.ports import _mismatch
from facts_damping.signals import CHANNELS
from facts_damping_reproduction.inverter_faults import cases, runs
from facts_damping_reproduction.inverter_faults.cases import units
from tests.plant.channels import ACTIVE, REACTIVE, VOLTAGE
from tests.plant.running import follow, frame_times, plant

if TYPE_CHECKING:
    from facts_damping.plant.build import Built

CURRENT = list(CHANNELS).index("current_magnitude")
SEED = 1  # cases beside those of the study
some = settings(deadline=None, max_examples=40)


@pytest.mark.parametrize("number", range(30))
def test_no_fault_ends_by_numerics(number: int) -> None:
    """Cases of the rule of the study, shortened; one that does not start says which limit excludes it."""
    result = runs.outcome(cases.case(number, SEED, (1.1, 10.0)), afterwards=0.1)
    assert result.how != runs.BROKEN, result.text
    assert result.how != runs.REFUSED or "allowed" in result.text


def currents(draw: st.DrawFn) -> tuple[Any, complex]:
    """A current source's row and its current before reduction."""
    row = np.zeros(1, kernel.INVERTER)[0]
    row["source"], row["angle"], row["ratio"] = kernel.CURRENT, -1, 1.0
    row["V_low"] = draw(st.sampled_from([-1.0, 0.0, 0.4]))
    row["V_reduced"] = row["V_low"] + draw(st.floats(0.05, 0.6))
    row["V_high"], row["I_least"] = draw(st.floats(1.05, 1.3)), draw(st.floats(-1.5, -1.2))
    row["K_high"] = draw(st.sampled_from([0.0, 0.7, 3.0]))
    return row, complex(draw(st.floats(-1.1, 1.1)), draw(st.floats(-1.1, 1.1)))


@some
@given(source=st.composite(currents)(), h=st.complex_numbers(max_magnitude=1.5), without=st.floats(0.0, 1.5))
def test_greatest_voltage_solves_and_no_greater_one_does(
    source: tuple[Any, complex], h: complex, without: float
) -> None:
    """| V - h f | = V0 at it; from there up, or from 0 up where there is none, it is above V0 on a fine grid."""
    row, current = source
    greatest = kernel.greatest_voltage(row, current, h, without)

    def distance(size: Any) -> Any:
        active = current.real * np.clip((size - row["V_low"]) / (row["V_reduced"] - row["V_low"]), 0.0, 1.0)
        beyond = np.maximum(-current.imag - row["K_high"] * (size - row["V_high"]), row["I_least"])
        return abs(size - h * (active - 1j * np.where(size > row["V_high"], beyond, -current.imag))) - without

    assert greatest >= 0.0 or greatest == -1.0
    if greatest >= 0.0:
        assert distance(greatest) == pytest.approx(0.0, abs=1e-7)
    assert distance(np.linspace(max(greatest, 0.0) + 1e-6, 5.0, 2000)).min() > -1e-7


def behind(X: float, *rows: dict[str, Any], circuits: int = 2, r: float = 0.0) -> System:
    """Inverters at T, behind a transformer from P, behind circuits of X p.u. together from an infinite bus at A."""
    names = [*dict.fromkeys(("A", "P", "T", *(row["bus"] for row in rows)))]
    circuit = {"from": "A", "to": "P", "r": r * circuits, "x": X * circuits}
    lines = [{"name": f"circuit_{i + 1}", **circuit} for i in range(circuits)]
    lines += [{"name": f"to_{bus}", "from": "P", "to": bus, "r": 0.0, "x": 0.1} for bus in names if bus not in "AP"]
    control = {**units()["electrical"]["REECB1"], "model": "REECB1", "QFLAG": 0}
    controls = [{"inverter": row["name"], **control} for row in rows if row["model"].startswith("REGC")]
    tables = {"lines": lines, "inverters": [*rows], "inverter_controls": controls}
    tables |= {"buses": [{"name": name, "nominal_voltage": 100.0} for name in names]}
    tables |= {"infinite_buses": [{"name": "grid", "bus": "A", "V": 1.0}]}
    pmus = [{"name": row["name"], "machine": row["name"]} for row in rows]
    return System.model_validate({"name": "weak", "ranges": "physical", **tables, "pmus": pmus})


def inverter(model: str, P: float = 80.0, **changes: Any) -> dict[str, Any]:
    row = {"name": "I1", "bus": "T", "rating": 100.0, "P": P, "model": model, **units()["inverters"][model]}
    return row | changes


@pytest.mark.parametrize("X", [0.35, 0.4, 0.43, 0.46, 0.5, 0.6])
def test_line_trip_leaves_the_voltage_of_theory_or_no_current(X: float) -> None:
    """A current I at the angle of V behind X' has V = sqrt(E^2 - (X' I)^2) while X' I < E; beyond it none flows."""
    start = behind(X, inverter("REGCA1", 100.0, V=1.0, Lvpnt1=0.0, Lvpnt0=-1.0))
    built = plant(start, {"time": 0.1, "kind": "line_out", "line": "circuit_2"})
    trace = follow(built, [0.0, 0.1])
    P, Q = trace.frames[0, 0, ACTIVE], trace.frames[0, 0, REACTIVE]
    after = 2.0 * X + 0.1
    voltage, power = trace.frames[1, 0, VOLTAGE], trace.frames[1, 0, ACTIVE]
    assert pytest.approx(1.0, abs=1e-9) == P  # the active current, at 1 p.u. of voltage
    if after * P < 1.0:
        assert voltage == pytest.approx(after * Q + np.sqrt(1.0 - (after * P) ** 2), abs=1e-9)
        assert power == pytest.approx(voltage * P, abs=1e-9)
    else:
        assert (voltage, power) == (pytest.approx(1.0, abs=1e-9), 0.0)
    assert trace.sound.all()


@pytest.mark.parametrize("model", ["REGCA1", "REGCB1"])
def test_only_the_inverter_that_is_cut_off_gives_no_current(model: str) -> None:
    """Behind a bolted fault there is no voltage whose angle it could follow; another, at a line of its own, goes on."""
    rows = behind(0.2, inverter(model), inverter(model, name="I2", bus="U", V=1.0)).model_dump(by_alias=True)
    for line in rows["lines"]:
        line |= {"r": 0.01, "from": "A" if line["name"] == "to_U" else line["from"]}
    built = plant(System.model_validate(rows), {"time": 0.1, "kind": "fault", "bus": "P", "duration": 0.1})
    trace = follow(built, frame_times(0.5, 240))
    faulted = (trace.t >= 0.1) & (trace.t < 0.2)
    assert np.abs(trace.frames[faulted, 0][:, [VOLTAGE, ACTIVE, REACTIVE]]).max() < 1e-12
    np.testing.assert_allclose(trace.frames[:, 1, ACTIVE], 0.8, rtol=0, atol=1e-9)
    assert trace.frames[-1, 0, ACTIVE] == pytest.approx(0.8, abs=0.05)


@pytest.mark.parametrize("model", ["REGCA1", "REGCB1", "REGCC1", "REGFMA1"])
@pytest.mark.parametrize("x", [0.0, 0.05])
def test_inverters_at_one_bus_are_one_of_their_rating(model: str, x: float) -> None:
    """Before, in and after a fault at the bus before theirs."""
    voltages = []
    for count in (1, 3):
        share = {"P": 240.0 / count, "rating": 300.0 / count}
        rows = [inverter(model, **share, name=f"I{i}", V=1.0, Q=0.0) for i in range(count)]
        fault = {"time": 0.05, "kind": "fault", "bus": "P", "x": x, "duration": 0.1}
        trace = follow(plant(behind(0.15, *rows, r=0.02), fault), frame_times(0.4, 240))
        assert trace.sound.all()
        voltages.append(trace.frames[:, 0, VOLTAGE])
    np.testing.assert_allclose(voltages[0], voltages[1], rtol=0, atol=1e-8)


@pytest.mark.parametrize("model", ["REGFMA1", "REGFMB1"])
def test_current_of_one_that_forms_a_grid_stays_at_its_limit_in_a_bolted_fault(model: str) -> None:
    fault = {"time": 0.1, "kind": "fault", "bus": "T", "duration": 0.1}
    trace = follow(plant(behind(0.2, inverter(model, V=1.0)), fault), frame_times(1.0, 240))
    faulted = (trace.t >= 0.1) & (trace.t < 0.2)
    assert trace.frames[faulted, 0, VOLTAGE].max() == 0.0
    assert trace.frames[faulted, 0, CURRENT].max() <= 1.5 + 1e-9
    assert trace.frames[np.argmax(faulted), 0, CURRENT] == pytest.approx(1.5, abs=1e-9)
    assert trace.sound.all()


@cache
def of_all_sources() -> Built:
    """A current source, EMFs in the direction of the voltage, of a PLL, and of an angle of their own."""
    models = ("REGCA1", "REGCB1", "REGCC1", "REGFMA1")
    return plant(behind(0.2, *(inverter(model, 40.0, name=model, bus=model[3:], V=1.0) for model in models)))


@some
@given(p=st.integers(0, 3), size=st.floats(0.01, 1.6), turn=st.floats(-np.pi, np.pi), blocked=st.booleans())
def test_slope_is_that_of_the_law(p: int, size: float, turn: float, blocked: bool) -> None:
    """The derivative of the source by the voltage, against central differences."""
    built = of_all_sources()
    work, source = workspace(built.plant, built.state), copy(built.state).source
    solve_network(built.plant, built.state.x, built.state.reference, source, 0, work)
    work.blocked[p] = blocked
    h, others = built.plant.network[0, p, 1 + p], work.response[p] - built.plant.network[0, p, 1 + p] * source[p]

    def source_at(q: complex) -> complex:
        source[p] = (q - others) / h  # with which it has the voltage q
        _mismatch(built.plant, built.state.x, built.state.reference, source, 0, work)
        return complex(*work.matrix[2 * p : 2 * p + 2, -1]) + complex(source[p])

    q, step = size * np.exp(1j * turn), 1e-7
    middle = source_at(q)
    slope = work.slope[p].copy()
    for k, d in enumerate((step, 1j * step)):
        up, down = source_at(q + d), source_at(q - d)
        if abs(up + down - 2.0 * middle) < 1e-9:  # no kink is near
            change = (up - down) / (2.0 * step)
            assert complex(slope[0, k], slope[1, k]) == pytest.approx(change, abs=1e-5 * max(1.0, abs(change)))


@some
@given(seed=st.integers(0, 10_000))
def test_network_with_any_states_is_solved_by_the_laws(seed: int) -> None:
    """Ports solved one by one, in closed form, are solved as the laws have it, with limited and blocked ones, too."""
    built, chance = of_all_sources(), np.random.default_rng(seed)
    x = built.state.x + chance.normal(0.0, 0.6, len(built.state.x))
    work, source = workspace(built.plant, built.state), copy(built.state).source
    solve_network(built.plant, x, built.state.reference, source, 0, work)
    assert _mismatch(built.plant, x, built.state.reference, source, 0, work) < 1e-20
    assert not work.blocked[2:].any()  # those with an angle of their own


@pytest.mark.parametrize("number", range(4))
def test_faults_are_the_same_with_factors_instead_of_a_dense_network(
    number: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    case = cases.case(number, SEED)
    dense = runs.outcome(case, afterwards=0.1)
    monkeypatch.setattr(plant_build, "LARGE", 0)
    sparse = runs.outcome(case, afterwards=0.1)
    assert (sparse.how, sparse.without) == (dense.how, dense.without)
    np.testing.assert_allclose(sparse.voltages, dense.voltages, rtol=0, atol=1e-6)
