"""Grid-following inverters as rows of blocks: beside transfer functions of their specifications, and at limits."""

from __future__ import annotations

import itertools
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from facts_damping.machine_controls.block_models import quantity_of
from facts_damping_library import MODELS
from facts_damping_library.page import diagram
from tests.plant.inverter_rows import OMEGA_0, P, Q, Rows, V, control, converter

if TYPE_CHECKING:
    from collections.abc import Callable

    Expected = Callable[[complex, Any], complex]

ELECTRICAL = ("REECA1", "REECB1", "REECD1")
T_FREQUENCY = 0.02  # s


# The transfer functions of the specifications, each written out by itself, to Ip and to the reactive current injected.


def lag(s: complex, time: float) -> complex:
    return 1.0 / (1.0 + s * time)


def regulators(s: complex, d: Any) -> tuple[complex, complex]:
    """Of the reactive power, and of the voltage."""
    return d.Kqp + d.Kqi / s, d.Kvp + d.Kvi / s


def plant(s: complex, d: Any) -> complex:
    """From the error of REPC_A to Qext."""
    return complex((d.Kp + d.Ki / s) * (1.0 + s * d.Tft) / (1.0 + s * d.Tfv))


CONVERTER = 0.02  # s, its lag
SOURCE = {"Ip": "Ip", "Iq": "Iq_ahead"}

EXPECTED: list[tuple[str, dict[str, float], dict[str, float] | None, str, str, Expected]] = [
    # model, its flags, the plant's flags, from, to
    *((m, {}, None, "Pext", "Ip", lambda s, d: lag(s, d.Tpord) / V) for m in ELECTRICAL),
    *((m, {}, None, "Vt", "Ip", lambda s, d: -P / V**2 * lag(s, d.Trv)) for m in ELECTRICAL),
    *((m, {}, None, "Qext", "Iq", lambda s, d: lag(s, d.Tiq) / V) for m in ELECTRICAL),
    *((m, {}, None, "Qaux", "Iq", lambda s, d: lag(s, d.Tiq) / V) for m in ELECTRICAL),
    ("REECA1", {}, None, "Paux", "Ip", lambda s, d: lag(s, d.Tpord) / V),
    ("REECB1", {}, None, "Paux", "Ip", lambda s, d: lag(s, d.Tpord) / V),
    ("REECD1", {}, None, "Paux", "Ip", lambda _s, _d: 1.0 / V),
    ("REECA1", {}, None, "Vt", "Iq", lambda s, d: -Q / V**2 * lag(s, d.Trv) * lag(s, d.Tiq)),
    *(
        (m, {}, None, "Vt", "Iq", lambda s, d: -(d.Kqv + Q / V**2 * lag(s, d.Tiq)) * lag(s, d.Trv))
        for m in ("REECB1", "REECD1")
    ),
    *(
        (m, {"PFFLAG": 1.0}, None, "Pe", "Iq", lambda s, d: Q / P * lag(s, d.Tp) * lag(s, d.Tiq) / V)
        for m in ELECTRICAL
    ),
    *(
        (m, {"QFLAG": 1.0, "VFLAG": 1.0}, None, x, "Iq", lambda s, d, sign=sign: sign * np.prod(regulators(s, d)))
        for m in ELECTRICAL[:2]
        for x, sign in (("Qext", 1.0), ("Qaux", 1.0), ("Qe", -1.0))
    ),
    *((m, {"QFLAG": 1.0, "VFLAG": 1.0}, None, "Vaux", "Iq", lambda s, d: regulators(s, d)[1]) for m in ELECTRICAL),
    *((m, {"QFLAG": 1.0, "VFLAG": 0.0}, None, "Vaux", "Iq", lambda s, d: regulators(s, d)[1]) for m in ELECTRICAL),
    *((m, {"QFLAG": 1.0, "VFLAG": 0.0}, None, "Qext", "Iq", lambda s, d: regulators(s, d)[1]) for m in ELECTRICAL),
    ("REECA1", {"QFLAG": 1.0, "VFLAG": 1.0}, None, "Vt", "Iq", lambda s, d: -regulators(s, d)[1] * lag(s, d.Trv)),
    ("REECB1", {"QFLAG": 1.0}, None, "Vt", "Iq", lambda s, d: -(regulators(s, d)[1] + d.Kqv) * lag(s, d.Trv)),
    (
        "REECD1",
        {"QFLAG": 1.0, "VFLAG": 1.0},
        None,
        "Qe",  # in the droop of the voltage, too
        "Iq",
        lambda s, d: -np.prod(regulators(s, d)) - d.Kc * lag(s, d.Tr1) * regulators(s, d)[1],
    ),
    (
        "REECD1",
        {"QFLAG": 1.0},
        None,
        "Vt",
        "Iq",
        lambda s, d: -d.Kqv * lag(s, d.Trv) - lag(s, d.Tr1) * regulators(s, d)[1],
    ),
    ("REECA1", {"PFLAG": 1.0}, None, "speed", "Ip", lambda s, d: P * lag(s, d.Tpord) / V),
    ("REECD1", {"PFLAG": 1.0}, None, "speed", "Ip", lambda s, d: P * lag(s, d.Tpord) / V),
    # The plant control before REEC_B with a constant Q: Qext / V behind Tiq.
    ("REECB1", {}, {"RefFlag": 1.0}, "Vbus", "Iq", lambda s, d: -plant(s, d) * lag(s, d.Tfltr)),
    ("REECB1", {}, {"RefFlag": 1.0}, "Qbranch", "Iq", lambda s, d: -d.Kc * plant(s, d) * lag(s, d.Tfltr)),
    ("REECB1", {}, {"RefFlag": 1.0, "VCFlag": 1.0}, "Vcomp", "Iq", lambda s, d: -plant(s, d) * lag(s, d.Tfltr)),
    ("REECB1", {}, {"RefFlag": 1.0, "VCFlag": 1.0}, "Vbus+Qbranch", "Iq", lambda _s, _d: 0.0),
    ("REECB1", {}, {"RefFlag": 1.0}, "Vplant", "Iq", plant),
    ("REECB1", {}, {}, "Vplant", "Iq", lambda _s, _d: 0.0),
    ("REECB1", {}, {}, "Qbranch", "Iq", lambda s, d: -plant(s, d) * lag(s, d.Tfltr)),
    ("REECB1", {}, {}, "Qplant", "Iq", lambda s, d: (1.0 + s * d.Tft) / (1.0 + s * d.Tfv)),
    ("REECB1", {}, {}, "Pext", "Ip", lambda s, _d: lag(s, 0.04) / V),
    ("REECB1", {}, {"Fflag": 1.0}, "Pplant", "Ip", lambda s, d: lag(s, d.Tg)),
    (
        "REECB1",
        {},
        {"Fflag": 1.0},
        "Pbranch",
        "Ip",
        lambda s, d: -(d.Kpg + d.Kig / s) * lag(s, d.Tp) * lag(s, d.Tg),
    ),
    (
        "REECB1",
        {},
        {"Fflag": 1.0},
        "theta_bus",
        "Ip",
        lambda s, d: -20.0 * s / OMEGA_0 * lag(s, T_FREQUENCY) ** 2 * (d.Kpg + d.Kig / s) * lag(s, d.Tg),
    ),
]


@pytest.mark.parametrize(("model", "flags", "plant_flags", "moved", "output", "expected"), EXPECTED)
def test_control_is_the_transfer_function_of_its_specification(
    model: str,
    flags: dict[str, float],
    plant_flags: dict[str, float] | None,
    moved: str,
    output: str,
    expected: Expected,
) -> None:
    electrical = control(model, **flags)
    plants = [] if plant_flags is None else [control("REPCA1", **plant_flags)]
    rows = Rows(converter(), electrical, *plants)
    assert rows.rest.violations == []
    for hertz in (0.02, 0.6, 2.0, 20.0):
        s = 2j * np.pi * hertz
        behind = lag(s, CONVERTER) * (-1.0 if output == "Iq" else 1.0)  # a current ahead of the voltage takes Q
        if plants and moved != "Pext":
            behind *= lag(s, electrical.Tiq if output == "Iq" else electrical.Tpord) / V
        wanted = expected(s, plants[0] if plants else electrical) * behind
        assert rows.response(moved, SOURCE[output], s) == pytest.approx(wanted, rel=1e-5, abs=1e-7)


def test_voltage_behind_the_compensation_of_reecd1() -> None:
    """|V - (Rc + j Xc) I|, in any frame."""
    rows = Rows(converter(), control("REECD1", VCMPFLAG=1.0, QFLAG=1.0))
    voltage, current = 0.3 + 0.9j, 0.7 - 0.4j
    rows.move(Vd=voltage.real, Vq=voltage.imag, Id=current.real, Iq=current.imag)
    assert rows["V_compensated"] == pytest.approx(abs(voltage - (0.02 + 0.1j) * current))


FLAGS = [
    dict(zip(("PFFLAG", "VFLAG", "QFLAG", "PQFLAG"), flags, strict=True))
    for flags in itertools.product((0.0, 1.0), repeat=4)
    if flags[:3] != (1.0, 0.0, 1.0)
]


@pytest.mark.parametrize("model", ELECTRICAL)
def test_every_set_of_flags_starts_at_rest(model: str) -> None:
    """In any dispatch, with and without a plant control, whose output is a voltage where QFLAG is 1 and VFLAG 0.

    A power factor gives no voltage, so PFFLAG 1 is of no use there.
    """
    dispatches = itertools.cycle([(0.8, 0.2), (0.3, -0.4), (0.0, 0.0), (1.0, 0.5)])
    for flags, reference, with_plant in itertools.product(FLAGS, (0.0, 1.0), (False, True)):
        p, q = next(dispatches)
        plants = [control("REPCA1", RefFlag=reference, Fflag=reference, Qmax=1.5, Qmin=-1.5)] if with_plant else []
        rows = Rows(converter(p=p, q=q, Lvplsw=reference), control(model, **flags), *plants)
        assert rows.rest.violations == []
        assert np.abs(rows.dx).max() < 1e-8
        assert [rows["Ip"], rows["Iq_ahead"]] == pytest.approx([p / V, -q / V], abs=1e-8)


@pytest.mark.parametrize("model", ELECTRICAL)
def test_block_whose_time_constant_is_zero_has_no_state(model: str) -> None:
    """But for those of the converter, as its source follows from states; the steady gains stay."""
    fast = {name: 0.0 for name in MODELS[model].fields.split() if quantity_of(name).time}
    plant_fast = dict.fromkeys(("Tfltr", "Tfv", "Tft", "Tp", "Tg"), 0.0)
    flags = {"RefFlag": 1.0, "Fflag": 1.0}
    plain = Rows(converter(), control(model), control("REPCA1", **flags))
    rows = Rows(converter(Tfltr=0.0), control(model, **fast), control("REPCA1", **plant_fast, **flags))
    assert set(rows.control.states) < set(plain.control.states)
    assert rows.rest.violations == []
    for moved, output in (("Vbus", "Iq_ahead"), ("Pbranch", "Ip")):
        s = 1e-3j
        assert rows.response(moved, output, s) == pytest.approx(plain.response(moved, output, s), rel=1e-3)


@pytest.mark.parametrize(
    ("model", "changes", "field"),
    [
        ("REECB1", {"Pmax": 0.7}, "Pmax"),
        ("REECA1", {"Pmin": 0.85}, "Pmin"),
        ("REECD1", {"Imax": 0.5}, None),
        ("REECB1", {"QFLAG": 1.0, "VFLAG": 1.0, "Vmax": 1.01}, "Vmax"),
        ("REECA1", {"QFLAG": 1.0, "VFLAG": 1.0, "Qmax": 0.1}, "Qmax"),
    ],
)
def test_limit_that_excludes_the_start_is_told(model: str, changes: dict[str, float], field: str | None) -> None:
    violations = Rows(converter(), control(model, **changes)).rest.violations
    assert field in {violation.field for violation in violations}
    assert str(violations[0]).startswith(f"inverter_controls: IBR1: {model}: ")


# REGC_A


def test_low_voltage_limit_cuts_the_active_current_and_lets_it_recover_at_its_rate() -> None:
    """LVPL: 0 at Zerox 0.4, 1.22 at Brkpt 0.9; back at Rrpwr 2 p.u./s from where it had come down to."""
    rows = Rows(converter(Lvplsw=1.0, Rrpwr=2.0), control("REECB1", Vdip=0.0, Kqv=0.0))
    for voltage in (0.6, 0.35):
        rows.run(0.5, Vt=voltage)
        ceiling = max(0.0, 1.22 * (voltage - 0.4) / 0.5)
        assert rows["LVPL"] == pytest.approx(ceiling, abs=1e-5)
        assert rows["Ip"] == pytest.approx(ceiling, abs=1e-5)
    rows.run(0.2, Vt=V)
    reached = rows["Ip"]
    rows.run(0.05)
    assert rows["Ip"] - reached == pytest.approx(0.1, rel=1e-3)
    rows.run(1.0)
    assert rows["Ip"] == pytest.approx(P / V, rel=1e-4)


def test_low_voltage_limit_does_not_leave_the_lag_behind_it() -> None:
    """The lag's own state comes down to a limit that falls at once, within 2 ms."""
    rows = Rows(converter(Lvplsw=1.0), control("REECB1"))
    rows.set("V_low", 0.6)
    rows.move(Vt=0.6)
    assert rows["Ip"] == pytest.approx(1.22 * 0.4)
    rows.run(0.01)
    assert rows["Ip_lag"] == pytest.approx(1.22 * 0.4, rel=0.01)


def test_without_the_switch_there_is_no_low_voltage_limit() -> None:
    rows = Rows(converter(Lvplsw=0.0), control("REECB1", Vdip=0.0, Kqv=0.0))
    rows.run(0.4, Vt=0.7)
    assert rows["Ip"] == pytest.approx(P / 0.7, rel=1e-3)


@pytest.mark.parametrize(("p", "upward"), [(0.5, True), (-0.5, False)])
def test_rate_of_the_active_current_is_limited_where_it_grows(p: float, upward: bool) -> None:
    rows = Rows(converter(p=p, Rrpwr=3.0), control("REECD1", Ke=1.0, Pmin=-1.1))
    for change, limited in ((0.4, upward), (-0.4, not upward)):
        rows.run(0.0)
        rows.set("Pord", p + change)
        rows.move()
        free = change / V / 0.02
        assert rows.slope("Ip_lag") == pytest.approx(np.sign(change) * 3.0 if limited else free)


@pytest.mark.parametrize(("q", "rises", "falls"), [(0.2, 4.0, None), (-0.2, None, 6.0), (0.0, None, None)])
def test_rate_of_the_reactive_current_is_limited_by_the_sign_at_the_start(
    q: float, rises: float | None, falls: float | None
) -> None:
    """Iqrmax limits its rise where Q is positive, Iqrmin its fall where Q is negative (WECC's specification)."""
    rows = Rows(converter(q=q, Iqrmax=4.0, Iqrmin=-6.0), control("REECB1"))
    start = rows["Iq_order"]
    for change, rate in ((0.3, rises), (-0.3, falls)):
        rows.set("Iq_order", start + change)
        rows.move()
        assert -rows.slope("Iq_ahead") == pytest.approx(np.sign(change) * (rate or 0.3 / 0.02))


# REEC


@pytest.mark.parametrize("model", ELECTRICAL)
def test_dip_holds_the_states_of_the_controls(model: str) -> None:
    rows = Rows(converter(), control(model, QFLAG=1.0, VFLAG=1.0))
    held = ("V_order", "Iq_order", "Pord")
    for voltage, moving in ((0.8, False), (1.2, False), (1.0, True)):
        rows.set("V_seen", voltage)
        rows.move(Vt=voltage, Pext=0.9, Qe=0.1)
        assert [rows.slope(state) != 0.0 for state in held] == [moving] * 3
    rows = Rows(converter(), control(model))
    rows.set("V_seen", 0.8)
    rows.move(Vt=0.8, Qext=0.4)
    assert rows.slope("Iq_order") == 0.0


@pytest.mark.parametrize("model", ELECTRICAL)
def test_support_of_the_voltage_has_a_dead_band_and_limits(model: str) -> None:
    """Kqv 1.5 beyond -0.03 and 0.02 about Vref0, from Iql1 -1 to Iqh1 1.1; REEC_A only in a dip."""
    rows = Rows(converter(), control(model, dbd1=-0.03, dbd2=0.02, Vref0=1.01))
    for voltage in (0.1, 0.7, 0.97, 1.0, 1.03, 1.1, 1.2, 1.9):
        rows.set("V_seen", voltage)
        rows.move(Vt=voltage)
        error = 1.01 - voltage
        beyond = error - np.clip(error, -0.03, 0.02)
        assert rows["Iqv"] == pytest.approx(np.clip(1.5 * beyond, -1.0, 1.1), abs=1e-12)
    if model == "REECA1":
        for voltage, active in ((0.9, False), (0.8, True), (1.1, False), (1.3, True)):
            rows.set("V_seen", voltage)
            rows.move(Vt=voltage)
            assert (rows["Iqinj"] != 0.0) == active


@pytest.mark.parametrize(("Thld", "expected"), [(0.0, 0.0), (-0.1, None), (0.1, 0.15)])
def test_support_of_reeca1_after_a_dip(Thld: float, expected: float | None) -> None:
    """For |Thld| s it goes on as it was calculated (below 0), or stays at Iqfrz (above 0)."""
    rows = Rows(converter(), control("REECA1", Thld=Thld))
    rows.run(0.1, Vt=0.6)
    assert rows["Iqinj"] == pytest.approx(1.5 * (V - 0.6), rel=0.02)
    rows.run(0.09, Vt=0.9)
    assert rows["Iqinj"] == pytest.approx(rows["Iqv"] if expected is None else expected)
    rows.run(0.02)
    assert rows["Iqinj"] == 0.0


@pytest.mark.parametrize("model", ["REECA1", "REECD1"])
def test_limit_of_the_active_current_stays_after_a_dip(model: str) -> None:
    """For Thld2 s as it was at its end: sqrt(Imax^2 - Iq^2) with the support of the dip."""
    rows = Rows(converter(), control(model, Thld2=0.2, Imax=1.0))
    rows.run(0.4, Vt=0.7)
    least = rows["Ipmax"]
    assert least == pytest.approx(np.sqrt(1.0 - rows["Iqcmd"] ** 2), abs=1e-6)
    while rows["dip"]:
        rows.run(1e-3, Vt=V)
    least = rows["Ipmax"]
    rows.run(0.19)
    assert rows["Ipmax"] == pytest.approx(least, abs=1e-12)
    assert rows["Ipcmd"] <= rows["Ipmax"] < np.sqrt(1.0 - rows["Iqcmd"] ** 2) - 0.1
    rows.run(0.1)
    assert rows["Ipmax"] == pytest.approx(np.sqrt(1.0 - rows["Iqcmd"] ** 2), abs=1e-6)


@pytest.mark.parametrize(("Thld", "frozen"), [(0.1, False), (-0.1, True)])
def test_reactive_command_of_reecd1_after_a_dip(Thld: float, frozen: bool) -> None:
    """It stays for |Thld| s as it was at the end of the dip, at Vdip 0.85 (above 0), or is Iqfrz (below 0)."""
    rows = Rows(converter(), control("REECD1", Thld=Thld))
    rows.run(0.4, Vt=0.6)
    assert rows["Iqcmd"] == pytest.approx(rows["Iq_order"] + 1.5 * (V - 0.6), rel=1e-3)
    at_end = rows["Iq_order"] + 1.5 * (V - 0.85)
    rows.run(0.1, Vt=V)
    assert rows["dip"] == 0.0
    assert rows["Iqcmd"] == pytest.approx(0.15 if frozen else at_end, rel=0.1)
    rows.run(0.1)
    assert rows["Iqcmd"] == pytest.approx(rows["Iq_total"], abs=1e-3)


def test_active_command_of_reecd1_stays_after_a_dip() -> None:
    """As it was at its end, at Vdip 0.85, but for the 2 ms of the hold."""
    rows = Rows(converter(), control("REECD1", Thld2=0.1, Imax=3.0, Kqv=0.0))
    rows.run(0.4, Vt=0.6)
    assert rows["Ipcmd"] == pytest.approx(P / 0.6, rel=1e-3)
    rows.run(0.1, Vt=V)
    assert rows["Ipcmd"] == pytest.approx(P / 0.85, rel=0.04)
    assert rows["Ip_total"] == pytest.approx(P / V, rel=0.02)
    rows.run(0.2)
    assert rows["Ipcmd"] == pytest.approx(P / V, rel=1e-3)


@pytest.mark.parametrize("voltage", [0.05, 1.45])
def test_reecd1_blocks_and_waits_before_it_starts_again(voltage: float) -> None:
    rows = Rows(converter(), control("REECD1"))
    rows.run(0.2, Vt=voltage)
    assert [rows["Ipcmd"], rows["Iqcmd"]] == [0.0, 0.0]
    assert rows.slope("Pord") == 0.0
    rows.run(0.04, Vt=V)
    assert [rows["Ipcmd"], rows["Iqcmd"]] == [0.0, 0.0]
    rows.run(0.2)
    assert [rows["Ipcmd"], rows["Iqcmd"]] == pytest.approx([P / V, Q / V], rel=1e-2)


@pytest.mark.parametrize("model", ELECTRICAL)
@pytest.mark.parametrize("active_first", [False, True])
def test_current_of_priority_leaves_the_rest_of_the_circle_to_the_other(model: str, active_first: bool) -> None:
    rows = Rows(converter(), control(model, PQFLAG=float(active_first), Imax=1.0, Pmax=3.0))
    for p, q in ((0.6, 0.5), (0.9, 0.6), (0.9, -0.8), (0.2, -2.0), (2.0, 0.3)):
        rows.set("Pord", p)
        rows.set("Iq_order", q)
        rows.move()
        active, reactive = p / V, q
        if active_first:
            active = min(active, 1.0)
            room = np.sqrt(1.0 - active**2)
            reactive = np.clip(reactive, -room, room)
        else:
            reactive = np.clip(reactive, -1.0, 1.0)
            active = min(active, np.sqrt(1.0 - reactive**2))
        assert [rows["Ipcmd"], rows["Iqcmd"]] == pytest.approx([active, reactive], abs=1e-12)


TABLE = ((0.2, 0.1), (0.5, 0.4), (0.8, 1.1), (1.1, 0.7))
LONG = (
    *((0.1, 0.3), (0.2, 0.3), (0.2, 0.6), (0.4, 0.5), (0.6, 0.9)),
    *((0.8, 1.2), (0.9, 1.2), (1.1, 1.0), (1.2, 0.2), (1.3, -0.3)),
)


@pytest.mark.parametrize(("model", "points"), [("REECA1", TABLE), ("REECD1", LONG), ("REECD1", TABLE)])
@pytest.mark.parametrize("sort", ["q", "p"])
def test_tables_limit_the_currents_over_the_voltage(
    model: str, points: tuple[tuple[float, float], ...], sort: str
) -> None:
    """Straight between their points, constant beyond them; points of zeros behind the last are none; a step is one."""
    values = {f"{kind}{sort}{i}": x[k] for i, x in enumerate(points, 1) for k, kind in enumerate("VI")}
    never = {"Vblkl": -1.0, "Vblkh": 9.0} if model == "REECD1" else {}
    rows = Rows(converter(p=0.3, q=0.1), control(model, **values, **never))
    voltages, currents = np.array(points).T
    for voltage in (0.0, 0.15, 0.1999, 0.21, 0.5, 0.77, 1.0, 1.15, 1.25, 1.4, 2.0):
        rows.set("V_seen", voltage)
        rows.set("Pord", 2.0)
        rows.set("Iq_order", 2.0 if sort == "q" else 0.0)
        rows.move(Vt=voltage)
        expected = min(float(np.interp(voltage, voltages + 1e-9 * np.arange(len(points)), currents)), 1.3)
        assert rows[f"VDL{sort}"] == pytest.approx(expected, abs=1e-5)
        if sort == "q" and model == "REECA1":
            assert rows["Iqcmd"] == pytest.approx(expected, abs=1e-5)


def test_table_below_zero_makes_the_inverter_absorb() -> None:
    """REEC_D: a limit of the reactive current below 0 is its value, upwards and downwards."""
    values = {f"{kind}q{i}": x[k] for i, x in enumerate(LONG, 1) for k, kind in enumerate("VI")}
    rows = Rows(converter(p=0.3, q=0.1), control("REECD1", **values, Vup=9.0))
    rows.set("V_seen", 1.3)
    for order in (0.5, -0.5):
        rows.set("Iq_order", order)
        rows.move(Vt=1.3)
        assert rows["Iqcmd"] == pytest.approx(-0.3)


@pytest.mark.parametrize("model", ELECTRICAL)
def test_regulators_stop_at_their_limits_and_leave_them_at_once(model: str) -> None:
    """The integral stands still where the output is at its limit and would go on; it goes back without delay."""
    rows = Rows(converter(), control(model, QFLAG=1.0, VFLAG=1.0, Imax=1.0))
    for error, moving in ((0.2, False), (-0.2, True)):
        rows.set("V_order", 1.2)
        rows.move(Qe=rows.reference("Qext") - error)
        assert rows["V_order"] == pytest.approx(min(1.2, 1.2 + 0.3 * error))
        assert rows.slope("V_order") == pytest.approx(2.0 * error if moving else 0.0)
    seen = "V_controlled" if model == "REECD1" else "V_seen"
    for sign in (1.0, -1.0):
        for error, moving in ((0.1 * sign, False), (-0.1 * sign, True)):
            rows.set("Iq_order", sign * rows["Iqmax"])
            rows.set(seen, rows["V_wanted"] - error)
            rows.move(Qe=rows.reference("Qext"))
            assert rows.slope("Iq_order") == pytest.approx(7.0 * error if moving else 0.0)


def test_active_power_is_limited_in_value_and_rate() -> None:
    """REEC_B: both limits are of its lag; REEC_A: the rate is of the reference before it."""
    for model in ELECTRICAL:
        rows = Rows(converter(), control(model, dPmax=0.5, dPmin=-0.8, Pmax=0.9, Pmin=0.6))
        start = rows.reference("Pext")
        reference = 0.0 if model == "REECB1" else (0.5 * 0.77 - 0.1) / 0.8  # s, by which it is ahead of the limit
        for change, time, rate, limit in ((1.0, 0.17, 0.5, 0.9), (-1.0, 0.2 + reference, -0.8, 0.6)):
            rows.run(time, Pext=start + change)
            assert 0.6 < rows["Pord"] < 0.9
            assert rows.slope("Pord") == pytest.approx(rate, rel=0.05)
            rows.run(0.6)
            assert rows["Pord"] == pytest.approx(limit, abs=1e-4)
            assert rows.slope("Pord") == 0.0


def test_power_factor_of_the_start_is_kept() -> None:
    """Q follows the measured power through Tp, in proportion to the start."""
    rows = Rows(converter(), control("REECA1", PFFLAG=1.0))
    rows.run(1.0, Pe=0.4)
    assert -rows["Iq_ahead"] == pytest.approx(0.4 * Q / P / V, rel=1e-6)


# REPC_A


def test_plant_regulates_within_its_dead_band_and_limits() -> None:
    rows = Rows(
        converter(), control("REECB1"), control("REPCA1", RefFlag=1.0, dbd1=-0.01, dbd2=0.02, emax=0.05, emin=-0.04)
    )
    for voltage in (0.9, 0.99, 1.0, 1.015, 1.03, 1.05, 1.2):
        rows.set("V_plant", voltage + 0.08 * Q)
        rows.move(Vbus=voltage)
        error = V - voltage
        bounded = np.clip(error - np.clip(error, -0.01, 0.02), -0.04, 0.05)
        assert rows["plant_bounded"] == pytest.approx(bounded, abs=1e-12)
        assert rows.slope("Q_regulated") == pytest.approx(1.5 * bounded, abs=1e-12)


def test_plant_stops_at_its_limits_of_reactive_power_and_in_a_low_voltage() -> None:
    rows = Rows(converter(), control("REECB1"), control("REPCA1", RefFlag=1.0, Vfrz=0.7))
    for sign, limit in ((1.0, 0.7), (-1.0, -0.7)):
        for error, slope in ((0.1 * sign, 0.0), (-0.1 * sign, -0.15 * sign)):
            rows.set("Q_regulated", limit)
            rows.set("V_plant", V + 0.08 * Q - error)
            rows.move(Vbus=V)
            assert abs(rows["Q_regulated"]) <= 0.7
            assert rows.slope("Q_regulated") == pytest.approx(slope)
    rows.set("Q_regulated", 0.2)
    rows.move(Vbus=0.69)
    assert rows.slope("Q_regulated") == 0.0
    rows.move(Vbus=0.71)
    assert rows.slope("Q_regulated") != 0.0


@pytest.mark.parametrize(
    ("deviation", "droop"), [(0.01, -0.007 * 15.0), (-0.01, 0.006 * 25.0), (0.002, 0.0), (-0.003, 0.0)]
)
def test_plant_answers_a_frequency_beyond_its_dead_band(deviation: float, droop: float) -> None:
    """Ddn 15 above 0.003, Dup 25 below -0.004: here by the angle of the bus, which turns ahead or behind."""
    band = {"fdbd1": -0.003, "fdbd2": 0.004}
    rows = Rows(converter(), control("REECB1"), control("REPCA1", Fflag=1.0, Ddn=15.0, Dup=25.0, **band))
    angle = 3.1
    for _ in range(3000):  # more than a whole turn
        angle += 1e-4 * deviation * OMEGA_0
        rows.move(theta_bus=float((angle + np.pi) % (2.0 * np.pi) - np.pi))
        rows.x += 1e-4 * rows.dx
    assert rows["frequency"] == pytest.approx(deviation, rel=1e-3)
    assert rows["P_error"] == pytest.approx(droop, rel=2e-3, abs=1e-9)


def test_plant_limits_its_error_and_its_reference_of_active_power() -> None:
    rows = Rows(converter(), control("REECB1"), control("REPCA1", Fflag=1.0, femax=0.1, femin=-0.2, Pmax=0.9, Pmin=0.3))
    for measured, error in ((0.5, 0.1), (0.75, 0.05), (1.3, -0.2)):
        rows.set("P_plant", measured)
        rows.move()
        assert rows["P_error"] == pytest.approx(error)
    rows.set("P_regulated", 0.9)
    for measured, slope in ((0.7, 0.0), (0.9, -0.06)):
        rows.set("P_plant", measured)
        rows.move()
        assert rows.slope("P_regulated") == pytest.approx(slope)


def test_page_tells_conditions_and_holds() -> None:
    ends = {line.rpartition("]--> ")[2] for line in diagram(MODELS["REECB1"])}
    assert {"Iq_order; QFLAG == 1, held by dip", "Pord; held by dip", "Iqcmd"} <= ends
