"""The STATCOM: energy, its regulators against their linear equations, limits, blocking."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import simpson
from scipy.linalg import expm

from facts_damping.devices import statcom
from facts_damping.devices.statcom import Statcom
from tests.plant.channels import ACTIVE, ANGLE, REACTIVE, VOLTAGE
from tests.plant.running import follow, frame_times, moved, plant, slopes, with_device
from tests.plant.small import SPUR, between_infinite_buses
from tests.plant.test_properties import everywhere

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from facts_damping.parameters.plant.system import System
    from facts_damping.plant.build import Built
    from tests.plant.running import Trace

BOTH = ["sssc", "statcom"]
OMEGA_0 = 2 * np.pi * 60
LOAD_STEP = {"time": 0.0, "kind": "load_step", "load": "load_2", "change": -0.1}


def row(bus: str = "S", **fields: Any) -> dict[str, Any]:
    return {
        "name": "statcom",
        "kind": "statcom",
        "bus": bus,
        "setpoint_max": 0.1,
        "rate_max": 10.0,
        "I_max": 1.0,
        **fields,
    }


def small(bus: str = "S", **fields: Any) -> Built:
    """A STATCOM at the end of a lossless line from an infinite bus (S), or at that bus itself (A)."""
    return plant(between_infinite_buses([row(bus, **fields)]), installed=["statcom"])


def states(built: Built, trace: Trace) -> dict[str, NDArray[np.float64]]:
    """The STATCOM's states by name, (times,)."""
    return {name: trace.x[:, built.state_names.index(f"statcom.{name}")] for name in statcom.STATES}


def two_area(**fields: Any) -> System:
    """The two areas with other figures of the STATCOM, and a PMU at each end of each branch."""
    return everywhere(with_device("statcom", **fields))


def test_energy_drawn_by_the_statcom_is_lost_or_stored() -> None:
    """Integral of the power drawn = integral of R i^2 + change of L i^2 / (2 omega_0) + change of tau vdc^2 / 2.

    From its equations times i_d, i_q and vdc. The power is that of the PMUs at the other branches of its bus.
    """
    system = two_area()
    built = plant(system, LOAD_STEP, installed=BOTH)
    x = moved(built, {"statcom.vdc": 0.93})
    trace = follow(built, frame_times(0.4, 6000), [(0.0, 0.05), (0.01, 0.04, 1), (0.2, -0.05, 1)], x=x)
    names = [s.name for s in system.pmus]
    at = [names.index(name) for name in ("line_1.to", "line_2.to", "sssc.from")]
    out = trace.frames[:, at, ACTIVE].sum(axis=1)
    d, s = next(d for d in system.devices if isinstance(d, Statcom)), states(built, trace)
    square = s["id"] ** 2 + s["iq"] ** 2
    magnetic, electric = 0.5 * d.L / OMEGA_0 * square, 0.5 * d.tau * s["vdc"] ** 2
    assert min(np.ptp(magnetic), np.ptp(electric)) > 1e-4
    assert simpson(d.R * square, x=trace.t) > 3e-4
    for end in (60, 1201, 2401):  # within the recovery of vdc, before and after the second setpoint
        drawn = simpson(-out[:end] - d.R * square[:end], x=trace.t[:end])
        stored = (magnetic + electric)[end - 1] - (magnetic + electric)[0]
        assert drawn == pytest.approx(stored, abs=2e-8)
        assert abs(stored) > 1e-5


def test_power_at_its_bus_balances() -> None:
    """What it gives goes into the branches; and it is conj(i) V with the d axis along V."""
    system = two_area()
    built = plant(system, LOAD_STEP, installed=BOTH)
    trace = follow(built, frame_times(1), [(0.1, 0.05), (0.2, -0.04, 1)], x=moved(built, {"statcom.vdc": 0.95}))
    names = [s.name for s in system.pmus]
    at = [names.index(name) for name in ("line_1.to", "line_2.to", "sssc.from")]
    out = (trace.frames[:, at, ACTIVE] + 1j * trace.frames[:, at, REACTIVE]).sum(axis=1)
    device, s = trace.devices[:, 1], states(built, trace)
    assert np.abs(out).max() > 0.2
    np.testing.assert_allclose(out, device["active_power"] + 1j * device["reactive_power"], rtol=0, atol=1e-10)
    np.testing.assert_allclose(out, trace.frames[:, at[0], VOLTAGE] * (s["id"] - 1j * s["iq"]), rtol=0, atol=1e-10)
    np.testing.assert_allclose(device["current"], np.hypot(s["id"], s["iq"]), rtol=0, atol=1e-12)


@settings(deadline=None, max_examples=60)
@given(i_d=st.floats(-2, 2), i_q=st.floats(-2, 2), V=st.floats(0.8, 1.2))
def test_bus_voltage_meets_the_port_s_closed_form(i_d: float, i_q: float, V: float) -> None:
    """|V| = sqrt(|Voc|^2 - Im(b)^2) + Re(b) with b = Zth (i_d + j i_q), arg V = arg Voc - arg(|V| - b)."""
    built = plant(between_infinite_buses([row()], V=V), installed=["statcom"])
    frame = follow(built, [0.0], x=moved(built, {"statcom.id": i_d, "statcom.iq": i_q})).frames[0, 2]
    b = 1j * SPUR * complex(i_d, i_q)
    magnitude = np.sqrt(V**2 - b.imag**2) + b.real
    angle = np.deg2rad(30) - np.angle(magnitude - b)
    assert (frame[VOLTAGE], frame[ANGLE]) == pytest.approx((magnitude, angle), abs=1e-11)


def test_statcom_starts_without_current_and_leaves_the_power_flow_unchanged() -> None:
    built = plant("two_area", installed=BOTH)
    assert np.abs(slopes(built)).max() < 1e-9
    trace = follow(built, frame_times(1))
    assert trace.devices["current"][:, 1].max() < 1e-9
    np.testing.assert_array_equal(built.flow.voltage, plant("two_area").flow.voltage)


@pytest.mark.parametrize("offset", [0.01, -0.015])
def test_bus_voltage_follows_the_offset_of_its_reference(offset: float) -> None:
    """Within half a second, before the machines have moved; a positive offset takes reactive power given."""
    system = two_area()
    trace = follow(plant(system, installed=BOTH), frame_times(1), [(0.1, offset, 1)])
    voltage = trace.frames[:, [s.name for s in system.pmus].index("sssc.from"), VOLTAGE]
    assert voltage[36] - voltage[0] == pytest.approx(offset, rel=0.02)
    assert trace.devices["reactive_power"][36, 1] * np.sign(offset) > 0.2
    device = trace.devices[36, 1]
    assert device["active_power"] == pytest.approx(-0.0073 * device["current"] ** 2, rel=0.05)  # its losses alone


@pytest.mark.parametrize("droop", [0.0, 0.02, 0.1])
@pytest.mark.parametrize("offset", [0.03, -0.03])
def test_droop_shares_the_offset_between_network_and_regulator(offset: float, droop: float) -> None:
    """At rest u = (V - Vref) + droop i_Q with i_Q = (V - E) / X, given to the network: V - Vref = u X / (X + droop)."""
    built = small(droop=droop, R=0.0)
    trace = follow(built, frame_times(1, 10), [(0.0, offset)])
    rise = trace.frames[-1, 2, VOLTAGE] - 1.0
    assert rise == pytest.approx(offset * SPUR / (SPUR + droop), abs=1e-9)
    assert trace.devices["current"][-1, 0] == pytest.approx(abs(offset) / (SPUR + droop), abs=1e-7)


@pytest.mark.parametrize("sign", [1, -1])
def test_reactive_current_is_limited_and_leaves_the_limit_at_once(sign: int) -> None:
    """A stiff network keeps the voltage from following: 0.9 p.u. of current for seconds, no wind-up after it."""
    built = small(I_max=0.9)
    trace = follow(built, frame_times(3), [(0.1, sign * 0.1), (2.0, 0.0)])
    s = states(built, trace)
    limited = (trace.t > 0.2) & (trace.t < 2.0)
    np.testing.assert_allclose(-sign * s["iq"][limited], 0.9, rtol=0, atol=1e-3)
    assert trace.devices["current"].max() < 0.9 * 1.05
    assert np.ptp(s["x_ac"][limited]) == 0
    after = trace.t > 2.0 + 0.01 + 0.06  # the ramp back, and three times the regulator's 20 ms
    assert np.abs(s["iq"][after]).max() < 0.05


def test_active_current_is_limited_while_the_capacitor_is_charged() -> None:
    """A large capacitor at vdc = 0.7: the DC regulator asks for 1.2 p.u., gets 0.3, and its integrator waits."""
    built = small("A", I_max=0.3, tau=5.0)
    trace = follow(built, frame_times(12), x=moved(built, {"statcom.vdc": 0.7}))
    s = states(built, trace)
    limited = 4.0 * (1 - s["vdc"]) > 0.3 + 0.01
    assert 2 < trace.t[limited][-1] < 6
    assert (s["x_dc"][limited] == 0).all()
    np.testing.assert_allclose(s["id"][limited & (trace.t > 0.5)], -0.3, rtol=0, atol=0.02)
    assert np.ptp(s["x_dc"]) > 1e-3
    assert s["vdc"][-1] == pytest.approx(1, abs=0.01)


@pytest.mark.parametrize("vdc", [0.9, 1.1])
def test_dc_voltage_recovers_within_50_ms(vdc: float) -> None:
    built = plant("two_area", installed=BOTH)
    trace = follow(built, frame_times(0.3, 240), x=moved(built, {"statcom.vdc": vdc}))
    away = np.abs(trace.devices["dc_voltage"][:, 1] - 1)
    assert away[0] == pytest.approx(0.1)
    assert away[trace.t >= 0.05].max() < 0.01


def equations(d: Statcom, x: float) -> NDArray[np.float64]:
    """Derivatives of the STATCOM at an infinite bus behind a reactance, at rest at |V| = 1, without a limit, (8, 8).

    Of deviations of i_d, i_q, vdc, x_ac, x_dc, x_d, x_q, and of u, which stays. |V| changes by -x i_q, so that
    e = u + (x + droop) i_q, i_Q* = Kp e + x_ac, i_P* = -Kd vdc + x_dc, e_d = -i_P* - i_d, e_q = -i_Q* - i_q.
    """
    i_d, i_q, vdc, x_ac, x_dc, x_d, x_q, u = np.eye(8)
    e = u + (x + d.droop) * i_q
    e_d = d.Kd * vdc - x_dc - i_d
    e_q = -d.Kp * e - x_ac - i_q
    c_d = vdc - d.Kf * i_q + d.Kc * e_d + x_d  # beside the |V| that it feeds forward
    c_q = d.Kf * i_d + d.Kc * e_q + x_q
    return np.array(
        [
            OMEGA_0 / d.L * (c_d - d.R * i_d + d.L * i_q),
            OMEGA_0 / d.L * (c_q - d.R * i_q - d.L * i_d),
            -i_d / d.tau,
            d.Ki * e,
            -d.Kdi * vdc,
            d.Kci * e_d,
            d.Kci * e_q,
            np.zeros(8),
        ]
    )


def linear(d: Statcom, x: float, start: dict[str, float], u: float, times: NDArray[np.float64]) -> NDArray[np.float64]:
    """Solution of the linear equations from a start, under a constant input, by the matrix exponential."""
    step = expm(equations(d, x) * (times[1] - times[0]))
    solution = [np.array([*(start.get(name, 0.0) for name in statcom.STATES), u])]
    for _ in times[1:]:
        solution.append(step @ solution[-1])
    return np.array(solution)[:, :7]


SMALL = 1e-5  # p.u., a step at which no limit acts and squares do not count
OPEN = {"Kp": 0.0, "Ki": 0.0}
STEPS: dict[str, tuple[str, dict[str, float], dict[str, float], float]] = {
    "reactive current": ("A", OPEN, {"x_ac": SMALL}, 0.0),
    "active current": ("A", {**OPEN, "Kd": 0.0, "Kdi": 0.0}, {"x_dc": SMALL}, 0.0),
    "currents, fast regulator": ("A", {**OPEN, "Kc": 2.0, "Kci": 500.0}, {"x_ac": SMALL, "id": -SMALL}, 0.0),
    "AC voltage": ("S", {}, {}, SMALL),
    "AC voltage with droop": ("S", {"droop": 0.03, "Ki": 300.0}, {}, -SMALL),
    "AC voltage with droop at a stiff bus": ("A", {"droop": 0.05}, {}, SMALL),
    "DC voltage": ("A", {}, {"vdc": SMALL}, 0.0),
    "DC voltage, other gains": ("S", {"Kd": 1.5, "Kdi": 400.0, "tau": 0.02}, {"vdc": -SMALL}, 0.0),
}


@pytest.mark.parametrize("step", STEPS)
def test_regulators_answer_a_small_step_as_their_equations_say(step: str) -> None:
    bus, gains, start, u = STEPS[step]
    fields = {**gains, "rate_max": 1000.0}  # the step's ramp takes 10 ns
    built = plant(between_infinite_buses([row(bus, **fields)], step=1e-4), installed=["statcom"])
    times = np.arange(0, 0.12, 0.002)
    names = {name: f"statcom.{name}" for name in start}
    at = {names[name]: built.state.x[built.state_names.index(names[name])] + value for name, value in start.items()}
    trace = follow(built, times, [(0.0, u)] if u else [], x=moved(built, at))
    first = built.state_names.index("statcom.id")
    departure = trace.x[:, first : first + 7] - built.state.x[first : first + 7]
    d = Statcom.model_validate(row(bus, **fields))
    expected = linear(d, SPUR if bus == "S" else 0.0, start, u, times)
    assert np.abs(expected).max() > 0.5 * SMALL
    assert (np.abs(departure - expected).max(axis=0) <= 2e-4 * np.abs(expected).max(axis=0) + 1e-9).all()


def test_fault_at_its_bus_blocks_it_and_it_comes_back() -> None:
    """No current and no state moving while the voltage is too low; afterwards it holds the voltage again."""
    fault = {"time": 0.1, "kind": "fault", "bus": "B8W", "duration": 0.1}
    system = two_area()
    built = plant(system, fault, installed=["statcom"])
    trace, without = follow(built, frame_times(3, 240), [(0.05, 0.02)]), plant(system, fault, installed=[])
    burning = (trace.t >= 0.1) & (trace.t < 0.2)
    device = trace.devices[:, 0]
    np.testing.assert_array_equal(device["blocked"], burning)
    for field in ("current", "active_power", "reactive_power"):
        assert (device[field][burning] == 0).all()
    assert (device["current"][trace.t < 0.1][-1], device["current"][trace.t > 0.21].max()) > (0.3, 0.3)
    for series in states(built, trace).values():
        assert np.ptp(series[burning]) == 0
    assert trace.sound.all()
    held, at = trace.t > 2.5, [s.name for s in system.pmus].index("sssc.from")
    voltage, loose = (t.frames[:, at, VOLTAGE] for t in (trace, follow(without, trace.t)))
    assert np.abs(voltage[held] - voltage[0] - 0.02).max() < 2e-3
    assert np.ptp(loose[held]) > 0.01
    assert device["dc_voltage"][held] == pytest.approx(1, abs=0.01)


awkward = st.sampled_from([float("nan"), float("inf"), float("-inf"), 1e300, -1e300, 0.0, -0.0, 5e-324])


@settings(deadline=None, max_examples=15)
@given(
    sequence=st.lists(
        st.tuples(st.integers(0, 999_999_999), st.one_of(st.floats(-0.3, 0.3), awkward), st.integers(0, 1)), max_size=30
    )
)
def test_two_devices_keep_their_limits_under_any_setpoints(sequence: list[tuple[int, float, int]]) -> None:
    """Each has its own setpoints: +-0.1 p.u. at 5 and at 10 p.u./s; what is no number leaves what was."""
    targets = sorted(((ns * 1e-9, value, device) for ns, value, device in sequence), key=lambda row: row[0])
    trace = follow(plant("two_area", installed=BOTH), frame_times(1.1, 120), targets)
    assert np.isfinite(trace.x).all()
    assert trace.sound.all()
    assert np.abs(trace.reference).max() <= 0.1
    assert (np.abs(np.diff(trace.reference, axis=0)).max(axis=0) <= np.array([5, 10]) / 120 + 2e-7).all()
    assert trace.devices["current"][:, 1].max() < 1.3
    sssc = trace.devices[:, 0]
    whole = np.hypot(sssc["injected_voltage"], sssc["active_voltage"])
    assert whole.max() <= 0.11 + 0.0016 * sssc["current"].max()
    for d in (0, 1):
        finite = [value for _, value, device in targets if device == d and np.isfinite(value)]
        last = min(max(finite[-1], -0.1), 0.1) if finite else 0.0
        assert trace.devices["setpoint"][-1, d] == last
        assert trace.reference[-1, d] == pytest.approx(last, abs=1e-12)
