from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from facts_damping.devices import sssc
from facts_damping.devices.kind import Site
from facts_damping.devices.sssc import Sssc
from facts_damping.errors import InputError
from facts_damping.plant.converters import dispatch
from facts_damping.plant.converters.site import DEVICE, PORT
from facts_damping.plant.dynamics import solve_network
from facts_damping.plant.grid.network import series_devices
from facts_damping.plant.model import PlantState, workspace
from facts_damping.plant.watchdog import initial_watch, line
from tests.independent import reference_devices
from tests.independent.reference_devices import Series
from tests.plant.running import changed, follow, frame_times, moved, plant, shipped, slopes, with_device

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from facts_damping.plant.build import Built

FAULT = {"time": 0.1, "kind": "fault", "bus": "B8", "duration": 0.1}


def parameters(**fields: Any) -> Sssc:
    return Sssc.model_validate({"name": "sssc", "kind": "sssc", "from": "A", "to": "B", **fields})


def device(**fields: Any) -> Any:
    """A row of the table that the kernels read."""
    return np.array(sssc.start(parameters(**fields), Site(0, 0.0, 1.0)).row, sssc.ROW.table)[()]


THESIS = {"Kp": 0.00375, "Ki": 0.1875, "Kd": 0.4, "Kdi": 8.0, "tau": 0.006, "rs": 0.000053, "xs": 0.0016}
LIMITS = {"setpoint_max": 0.1, "rate_max": 5.0, "vp_max": 0.1, "vc_max": 0.11, "I_rated": 10.0, "I_min": 0.02}
RATED = Series(parameters(**THESIS, **LIMITS), 1.0)


def test_device_of_two_area_has_the_data_of_the_thesis() -> None:
    (shipped_device,) = series_devices(shipped("two_area"))
    place = {"from_bus", "to_bus"}
    assert shipped_device.model_dump(exclude=place) == RATED.p.model_dump(exclude=place)


class Port(NamedTuple):
    """A converter at a port: current, what it gives there (p.u.), whether it is blocked, its row and its states."""

    current: complex
    voltage: complex
    blocked: bool
    row: Any
    x: NDArray[np.float64]

    @property
    def magnitude(self) -> float:
        return abs(self.current)

    def converter(self, u: float) -> sssc.Converter:
        return sssc.converter(self.row, self.x, u, self.magnitude)

    def slopes(self, u: float) -> NDArray[np.float64]:
        dx = np.zeros(3)
        whole = np.array([(self.row,)], [("sssc", sssc.ROW.table)])[0]
        sssc.derivatives(whole, self.x, -u, self.magnitude, dx)
        return dx


@cache
def bare() -> Built:
    return plant("smib", installed=["sssc"])


def at_a_port(converter: Any, x: Sequence[float], u: float, voltage: complex, impedance: complex) -> Port:
    """A converter alone at a source `voltage` behind `impedance`, p.u."""
    empty = bare()
    admittance = 1 / (impedance + complex(converter["rs"], converter["xs"]))
    rows = np.zeros(1, dispatch.DEVICE)
    rows[0]["kind"], rows[0]["states"], rows[0]["sssc"] = dispatch.CODES["sssc"], 3, converter
    model = empty.plant._replace(
        machines=empty.plant.machines[:0],
        placed=rows,
        devices=rows,
        infinite=np.array([voltage], complex),
        network=np.array([[[admittance, -admittance]]], complex),
        ports=np.array([(DEVICE, 0, converter["I_min"], np.inf)], PORT),
    )
    lines = line([0.0])
    sources = np.zeros(1, complex), np.zeros((3, 1), complex)
    state = PlantState(np.array(x), np.array([-u]), np.zeros(1), initial_watch(1), *sources, *lines)
    work = workspace(model, state)
    solve_network(model, state.x, state.reference, state.source, 0, work)
    return Port(complex(work.response[0]), complex(state.source[0]), bool(work.blocked[0]), converter, state.x)


@settings(deadline=None, max_examples=200)
@given(
    voltage=st.complex_numbers(max_magnitude=1),
    impedance=st.builds(complex, st.floats(0, 0.02), st.floats(0.03, 0.2)),
    u=st.floats(-0.1, 0.1),
    x=st.tuples(st.floats(-0.05, 0.05), st.floats(-0.05, 0.05), st.floats(0.7, 1.3)),
)
def test_converter_solves_its_port(
    voltage: complex, impedance: complex, u: float, x: tuple[float, float, float]
) -> None:
    """Kirchhoff's law at the port, within the limits; or blocked, a short circuit behind its transformer."""
    port = at_a_port(device(), x, u, voltage, impedance)
    drop = (impedance + complex(port.row["rs"], port.row["xs"])) * port.current + port.voltage
    assert abs(voltage - drop) < 1e-12
    assert abs(port.voltage) <= 0.11 * x[2] * (1 + 1e-10)
    if abs(voltage) > 0.4:
        assert not port.blocked
    if port.blocked:
        assert port.voltage == 0
    else:  # the independent model, at this current
        c = port.converter(u)
        assert abs(port.voltage - complex(c.v_p, c.v_q) * port.current / port.magnitude) < 1e-8
        assert abs(c.v_p) <= 0.1 * x[2] * (1 + 1e-12)
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(reference_devices, "BAND", 1e-12)  # an integrator stands at once
            v_p, v_q, rates = RATED.drops(list(x), -u, port.magnitude)
        assert (c.v_p, c.v_q) == pytest.approx((v_p, v_q), rel=1e-9, abs=1e-12)
        np.testing.assert_allclose(port.slopes(u), rates, rtol=1e-9, atol=1e-12)


@settings(deadline=None, max_examples=200)
@given(
    u=st.floats(-0.1, 0.1),
    x=st.tuples(st.floats(-0.15, 0.15), st.floats(-0.15, 0.15), st.floats(0.7, 1.3)),
    magnitude=st.floats(1, 20),
)
def test_slopes_of_the_converter_are_those_of_its_voltages(
    u: float, x: tuple[float, float, float], magnitude: float
) -> None:
    """Against central differences, where no limit lies between."""
    converter = device()
    low, at, high = (sssc.converter(converter, np.array(x), u, magnitude + step) for step in (-1e-5, 0.0, 1e-5))
    if low[4:] == high[4:] and (magnitude + 1e-5 < 10.0 or magnitude - 1e-5 > 10.0):
        assert at.v_p_slope == pytest.approx((high.v_p - low.v_p) / 2e-5, rel=1e-5, abs=1e-9)
        assert at.v_q_slope == pytest.approx((high.v_q - low.v_q) / 2e-5, rel=1e-5, abs=1e-9)


def test_blocked_converter_stands_still() -> None:
    """Too little current: no voltage; in the plant no state of it moves."""
    port = at_a_port(device(), (0.01, 0.02, 0.9), 0.05, 0.001 + 0j, 0.1j)
    assert port.blocked
    assert port.voltage == 0
    out = {"time": 0.0, "kind": "line_out"}
    built = plant("two_area", {**out, "line": "line_3"}, {**out, "line": "line_4"})
    states = [built.state_names.index(f"sssc.{state}") for state in sssc.STATES]
    dx = slopes(built, moved(built, {"sssc.x_ac": 0.01, "sssc.x_dc": 0.02, "sssc.vdc": 0.9}))
    assert (dx[states] == 0).all()
    assert np.abs(dx).max() > 0


@pytest.mark.parametrize(
    ("x", "u", "limited"),
    [
        ((0.0, 0.0, 1.0), 0.05, (False, False)),
        ((0.09, 0.0, 1.0), 0.1, (True, False)),
        ((0.0, 0.2, 1.0), 0.0, (False, True)),
    ],
)
def test_integrator_is_frozen_while_its_output_is_limited(
    x: tuple[float, float, float], u: float, limited: tuple[bool, bool]
) -> None:
    port = at_a_port(device(), [*x[:2], 0.95], u, 0.4 + 0j, 0.1j)
    c = port.converter(u)
    assert (c.ac_limited, c.dc_limited) == limited
    assert (port.slopes(u)[:2] == 0).tolist() == list(limited)


def test_above_the_rated_current_the_dc_regulator_keeps_its_power() -> None:
    """s_p = min(1, In / |I|) (Kd (1 - vdc) + x_dc): twice the rating, half the voltage."""
    port = at_a_port(device(I_rated=2.0, Kdi=0.0), [0.0, 0.0, 0.9], 0.0, 0.4 + 0j, 0.1j)
    assert port.magnitude > 2.5
    assert port.converter(0.0).v_p * port.magnitude == pytest.approx(2.0 * 0.4 * 0.1 * 0.9, rel=1e-12)


def test_dc_regulator_stays_within_its_limits_and_leaves_them() -> None:
    """VR is held at a limit, without wind-up, and goes back when the fault's swing is over."""
    system = shipped("kundur_12_6_dc")
    free = plant(system)
    index = [free.state_names.index(f"G{g}.VR") for g in (1, 2, 3, 4)]
    start = free.state.x[index]
    low, high = start.min() - 0.3, start.max() + 0.2
    assert low > 0
    unlimited = follow(plant(system, FAULT), frame_times(4, 240)).x[:, index]
    assert unlimited.max() > high + 0.2
    limits = {"maximum": float(high)}
    limited = plant(changed(system, exciters=[{**e.model_dump(), **limits} for e in system.exciters]), FAULT)
    courses = follow(limited, frame_times(4, 240)).x[:, index]
    assert high - 1e-3 < courses.max() < high + 0.05  # by one step at most
    assert courses[-1].max() < high - 0.05


def test_overshoot_of_a_regulator_limit_in_a_coarse_step_has_no_effect() -> None:
    """The field voltage of a coarse step is near that of a fine one; with it, they would be 0.04 p.u. apart."""
    system = shipped("kundur_12_6_dc")
    start = plant(system)
    high = max(start.state.x[start.state_names.index(f"G{g}.VR")] for g in (1, 2, 3, 4)) + 0.2
    exciters = [{**e.model_dump(), "maximum": float(high)} for e in system.exciters]
    field_voltages = []
    for step in (1 / 120, 1 / 960):
        run = follow(plant(changed(system, exciters=exciters, step=step), FAULT), frame_times(4))
        field_voltages.append(run.machines["field_voltage"])
    assert np.abs(field_voltages[0] - field_voltages[1]).max() < 0.015


def test_static_exciters_field_voltage_is_limited() -> None:
    """0 to 7: both are reached by a fault near the machines, neither is passed."""
    fault = {"time": 0.1, "kind": "fault", "bus": "B9", "duration": 0.1}
    field = follow(plant("two_area", fault), frame_times(1, 240)).machines["field_voltage"]
    assert (field.min(), field.max()) == (0, 7)


def test_exciter_limits_that_do_not_admit_the_start_are_refused() -> None:
    system = shipped("two_area")
    exciters = [{**e.model_dump(), "maximum": 1.5} for e in system.exciters]
    with pytest.raises(InputError, match=r"exciters: G1 needs a field voltage of \d\.\d+ p\.u\..*: 0 to 1\.5"):
        plant(changed(system, exciters=exciters))


@pytest.mark.parametrize("limits", [{"xs": 0.03}, {"vc_max": 0.005, "vp_max": 0.004}])
def test_device_limits_that_do_not_admit_the_start_are_refused(limits: dict[str, float]) -> None:
    """The converter makes up for xs |I| of its transformer: with a lower limit the start is no equilibrium."""
    with pytest.raises(InputError, match="sssc"):
        plant(with_device("sssc", **limits))


@pytest.mark.parametrize(
    "fields", [{"xs": 0.02}, {"xs": 0.2, "vc_max": 1.0}, {"rs": 0.01}, {"tau": 0.05}, {"g": 0.001}, {"g": 0.05}]
)
def test_other_devices_start_at_rest(fields: dict[str, float]) -> None:
    assert np.abs(slopes(plant(with_device("sssc", **fields)))).max() < 1e-9
