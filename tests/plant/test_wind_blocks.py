"""Wind turbines as rows of blocks, and DER_A: beside equations of their own, at rest, and at their limits."""

from __future__ import annotations

from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from facts_damping.errors import InputError
from tests.plant.inverter_rows import OMEGA_0, P, Q, Rows, V, control, converter

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

W = 0.86 + 0.2 * (1.01 - 0.86) / 0.3  # p.u., the speed for the power of the start, between the last two points
SLOPE = (1.01 - 0.86) / 0.3


def turbine(*without: str, **changes: dict[str, float]) -> Rows:
    """A converter with REEC_A and the parts of a wind turbine; changes of their constants by model."""
    parts = [m for m in ("WTDTA1", "WTARA1", "WTPTA1", "WTTQA1") if m not in without]
    return Rows(converter(), *(control(model, **changes.get(model, {})) for model in ("REECA1", *parts)))


def data(model: str, **changes: float) -> Any:
    return SimpleNamespace(**control(model, **changes).model_dump())


def lag(s: complex, time: float) -> complex:
    return 1.0 / (1.0 + s * time)


def chain(s: complex, Tflag: float) -> dict[str, complex]:
    """What a p.u. of electrical power changes in a turbine: the linear equations of its parts, solved together.

    Two masses of 2 Ht, 2 Hg on a spring that lets them swing against each other at Freq1, in p.u. of torque: the torque
    of a power is power / speed. Pm = Pm0 - Ka theta (theta - Theta0) has the slope -Ka Theta0.
    """
    shaft, air, pitch, torque, order = (data(m) for m in ("WTDTA1", "WTARA1", "WTPTA1", "WTTQA1", "REECA1"))
    turbine_mass, generator_mass = 2.0 * shaft.H * shaft.Htfrac, 2.0 * shaft.H * (1.0 - shaft.Htfrac)
    spring = (2.0 * np.pi * shaft.Freq1) ** 2 / (1.0 / turbine_mass + 1.0 / generator_mass)
    names = ("turbine", "generator", "between", "wind", "theta", "reference", "torque", "Pref", "Pord")
    a: NDArray[np.complex128] = np.eye(len(names), dtype=complex)
    b = np.zeros(len(names), complex)
    at = {name: i for i, name in enumerate(names)}

    def follows(name: str, power: complex = 0.0, **others: complex) -> None:
        """A quantity is the sum of others with their factors, and of the electrical power."""
        b[at[name]] = power
        for other, factor in others.items():
            a[at[name], at[other]] -= factor

    follows("turbine", wind=1.0 / W / (s * turbine_mass), turbine=-P / W**2 / (s * turbine_mass))
    a[0, 2] += 1.0 / (s * turbine_mass)
    follows(
        "generator",
        -1.0 / W / (s * generator_mass),
        between=1.0 / (s * generator_mass),
        generator=(P / W**2 - shaft.DAMP) / (s * generator_mass),
    )
    twisting = spring / s + shaft.Dshaft
    follows("between", turbine=twisting, generator=-twisting)
    follows("wind", theta=-air.Ka * air.Theta0)
    speed, power = pitch.Kpw + pitch.Kiw / s, pitch.Kpc + pitch.Kic / s
    behind = lag(s, pitch.Tp)
    follows("theta", turbine=speed * behind, reference=-speed * behind, Pord=(speed * pitch.Kcc + power) * behind)
    follows("reference", SLOPE * lag(s, torque.Tp) * lag(s, torque.Twref))
    regulator = torque.Kpp + torque.KIP / s
    if Tflag:
        follows("torque", -regulator * lag(s, torque.Tp) / W)
    else:
        follows("torque", generator=regulator, reference=-regulator)
    follows("Pref", torque=W, generator=P / W)
    follows("Pord", Pref=lag(s, order.Tpord))
    return dict(zip(names, np.linalg.solve(a, b), strict=True))


OUTPUTS = {"turbine": "speed_turbine", "generator": "speed", "wind": "Pm", "theta": "pitch", "Pref": "Pref"}


@pytest.mark.parametrize("Tflag", [0.0, 1.0])
@pytest.mark.parametrize("hertz", [0.01, 0.2, 1.7, 8.0])
def test_turbine_answers_a_change_of_power_as_its_parts_do_together(Tflag: float, hertz: float) -> None:
    s, rows = 2j * np.pi * hertz, turbine(WTTQA1={"Tflag": Tflag})
    assert rows.rest.violations == []
    wanted = chain(s, Tflag)
    for part, signal in OUTPUTS.items():
        assert rows.response("Pe", signal, s) == pytest.approx(wanted[part], rel=1e-4, abs=1e-7), part
    behind = lag(s, 0.02) / V
    assert rows.response("Pe", "Ip", s) == pytest.approx(wanted["Pord"] * behind, rel=1e-4, abs=1e-7)


def test_reference_of_the_plant_reaches_torque_and_pitch() -> None:
    """Tflag 1: the regulator sees (Pext - Pe) / speed. An order below the reference pitches back."""
    torque, pitch = data("WTTQA1"), data("WTPTA1")
    for hertz in (0.3, 4.0):
        s = 2j * np.pi * hertz
        alone = turbine("WTARA1", "WTPTA1", WTTQA1={"Tflag": 1.0})  # without aerodynamics the speed does not answer
        wanted = (torque.Kpp + torque.KIP / s) / alone["speed"]
        assert alone.response("Pext", "torque_order", s) == pytest.approx(wanted, rel=1e-5)
        theta, speed, order = (turbine().response("Pext", name, s) for name in ("pitch", "speed_turbine", "Pord"))
        of_speed, of_power = pitch.Kpw + pitch.Kiw / s, pitch.Kpc + pitch.Kic / s
        wanted = of_speed * speed + (of_power + pitch.Kcc * of_speed) * (order - 1.0)
        assert theta == pytest.approx(wanted * lag(s, pitch.Tp), rel=1e-4)


@pytest.mark.parametrize("Theta0", [0.0, 0.5, 6.0, 25.0])
@pytest.mark.parametrize("Tflag", [0.0, 1.0])
def test_turbine_starts_at_the_speed_for_its_power_and_at_its_pitch(Theta0: float, Tflag: float) -> None:
    """Pm = Pm0 at two pitches, Theta0 and 0: it is the first."""
    rows = turbine(WTARA1={"Theta0": Theta0}, WTTQA1={"Tflag": Tflag})
    assert rows.rest.violations == []
    assert [rows["speed"], rows["speed_turbine"], rows["speed_reference"]] == pytest.approx([W] * 3, abs=1e-9)
    assert [rows["pitch"], rows["pitch_of_power"], rows["Pm"], rows["Pref"]] == pytest.approx([Theta0, 0.0, P, P])
    assert np.abs(rows.dx).max() < 1e-8


@pytest.mark.parametrize("changes", [{"Htfrac": 0.0}, {"Htfrac": 1.0}, {"Freq1": 0.0}, {}])
def test_drive_train_alone_turns_at_one(changes: dict[str, float]) -> None:
    """Without torque control at rated speed; one mass of 2 H where the shaft does not twist."""
    rows = turbine("WTARA1", "WTPTA1", "WTTQA1", WTDTA1=changes)
    assert rows["speed"] == pytest.approx(1.0, abs=1e-12)
    rows.move(Pe=P - 0.3)
    inertia = 2.0 * 5.0 * (1.0 if changes else 0.2)
    assert rows.slope("speed") == pytest.approx(0.3 / inertia)  # with the power of the start
    assert ("twist" in rows.control.states) == (not changes)


def test_brake_of_the_generator_counts_from_the_speed_of_the_start() -> None:
    """DAMP 1.5 p.u. of torque per p.u. of speed."""
    rows = turbine("WTPTA1")
    assert rows["speed"] == pytest.approx(W, abs=1e-9)
    rows.set("speed", W + 0.1)
    rows.move()
    assert rows["friction"] == pytest.approx(0.15)


@pytest.mark.parametrize(("power", "speed"), [(0.1, 0.58), (0.2, 0.58), (0.3, 0.65), (0.75, 0.935), (1.1, 1.01)])
def test_speed_reference_stays_beyond_the_ends_of_its_curve(power: float, speed: float) -> None:
    rows = turbine()
    rows.set("power_seen", power)
    rows.move()
    assert rows["speed_wanted"] == pytest.approx(speed)


def test_torque_has_limits_and_is_held_in_a_dip() -> None:
    """Temax 1.2, Temin 0.1; its integral stops there, and while the voltage is below Vdip."""
    rows = turbine()
    for speed, torque in ((W + 1.0, 1.2), (W - 1.0, 0.1)):
        rows.set("speed", speed)
        rows.move()
        assert rows["torque_order"] == torque
        assert rows.slope("torque_order") == 0.0
    rows = turbine()
    rows.set("speed", W + 0.01)
    rows.move()
    assert rows.slope("torque_order") == pytest.approx(0.6 * 0.01, abs=1e-9)
    rows.move(Vt=0.8)
    assert rows.slope("torque_order") == 0.0


def test_pitch_keeps_its_limits_and_rates() -> None:
    """0 to 27 deg, at 10 and -9 deg/s; what the regulator of the power gives has those limits alone, too."""
    rows = turbine(WTPTA1={"TetaMin": 0.0})
    rows.set("speed_turbine", 2.0)
    rows.move()
    assert rows.slope("pitch_moved") == 10.0
    rows.set("pitch_moved", 27.0 - 6.0)
    rows.move()
    assert (rows["pitch"], rows.slope("pitch_moved"), rows.slope("pitch_of_speed")) == (27.0, 0.0, 0.0)
    rows.set("speed_turbine", 0.1)
    rows.move()
    assert rows.slope("pitch_moved") == -9.0
    rows.set("Pord", 0.1)
    rows.move()
    assert (rows["pitch_of_power"], rows.slope("pitch_of_power")) == (0.0, 0.0)
    assert rows["pitch_of_speed"] == -6.0


def test_pitch_spills_power() -> None:
    """Pm0 - Ka theta (theta - Theta0), deg."""
    rows = turbine()
    rows.set("pitch_moved", 4.0)
    rows.move()
    assert rows["Pm"] == pytest.approx(P - 0.007 * 10.0 * 4.0)


@pytest.mark.parametrize(
    ("missing", "said"),
    [
        ("WTARA1", r"REGCA1 of IBR1: no pitch_start given; allowed: with one of WTARA1"),
        ("WTDTA1", r"REGCA1 of IBR1: no speed_generator, speed_turbine given; allowed: with one of WTDTA1"),
    ],
)
def test_part_that_is_missing_is_told(missing: str, said: str) -> None:
    with pytest.raises(InputError, match=said):
        turbine(missing)


# DER_A

EXPECTED: list[tuple[dict[str, float], str, str, Callable[[complex, Any], complex]]] = [
    ({}, "Pext", "Ip", lambda s, d: lag(s, d.Tpord) / V),
    ({}, "Paux", "Ip", lambda s, d: lag(s, d.Tpord) / V),
    ({}, "Vt", "Ip", lambda s, d: -P / V**2 * lag(s, d.Trv)),
    ({}, "Qext", "Iq", lambda s, d: lag(s, d.Tiq) / V),
    ({}, "Vt", "Iq", lambda s, d: -Q / V**2 * lag(s, d.Trv) * lag(s, d.Tiq)),  # within the dead band
    ({"dbd1": 0.0, "dbd2": 0.0}, "Vaux", "Iq", lambda _s, d: d.Kqv),
    ({"PfFlag": 1.0}, "Pe", "Iq", lambda s, d: Q / P * lag(s, d.Tp) * lag(s, d.Tiq) / V),
    ({}, "theta", "Ip", lambda _s, _d: 0.0),
    ({"FreqFlag": 1.0}, "Pe", "Ip", lambda s, d: -(d.Kpg + d.Kig / s) * lag(s, d.Tp) * lag(s, d.Tpord) / V),
    (
        {"FreqFlag": 1.0, "fdbd1": 0.0, "fdbd2": 0.0, "Dup": 20.0},
        "theta",
        "Ip",
        lambda s, d: -20.0 * s / OMEGA_0 * lag(s, 0.02) * lag(s, d.Trf) * (d.Kpg + d.Kig / s) * lag(s, d.Tpord) / V,
    ),
]


@pytest.mark.parametrize(("changes", "moved", "output", "expected"), EXPECTED)
def test_der_a_is_the_transfer_function_of_its_specification(
    changes: dict[str, float], moved: str, output: str, expected: Callable[[complex, Any], complex]
) -> None:
    der = converter("DERA1", **changes)
    rows = Rows(der)
    assert rows.rest.violations == []
    for hertz in (0.05, 1.0, 12.0):
        s = 2j * np.pi * hertz
        wanted = expected(s, der) * lag(s, der.Tg) * (1.0 if output == "Ip" else -1.0)
        assert rows.response(moved, {"Ip": "Ip", "Iq": "Iq_ahead"}[output], s) == pytest.approx(
            wanted, rel=1e-5, abs=1e-7
        )


@pytest.mark.parametrize(("PQFlag", "Ip", "Iq"), [(0.0, np.sqrt(1.2**2 - 1.0), 1.0), (1.0, 1.0, np.sqrt(1.2**2 - 1.0))])
def test_der_a_gives_one_current_first(PQFlag: float, Ip: float, Iq: float) -> None:
    """Of 1 p.u. each the second has what is left of the circle of 1.2."""
    rows = Rows(converter("DERA1", PQFlag=PQFlag))
    rows.set("Pord", V)
    rows.set("Iq_order", 1.0)
    rows.move()
    assert (rows["Ipcmd"], rows["Iqcmd"]) == pytest.approx((Ip, Iq))


def test_der_a_of_generators_takes_no_active_power() -> None:
    for GenFlag, least in ((1.0, 0.0), (0.0, -1.2)):
        rows = Rows(converter("DERA1", GenFlag=GenFlag, q=0.0, Pmin=-2.0))
        rows.set("Pord", -1.5)
        rows.move()
        assert rows["Ipcmd"] == pytest.approx(least, abs=1e-9)
