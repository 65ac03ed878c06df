"""Cases with inverters of the reference model: the nine buses with one machine and two inverters."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from tests.plant.inverters import constants

from .reference_cases import Case, content, fault

if TYPE_CHECKING:
    from .reference_cases import Row
    from .reference_devices import Targets

FINE = 1 / 3840  # s, step: where limits switch the error is of first order in it
RATINGS = {"I2": ("B2", 163.0, 200.0), "I3": ("B3", 85.0, 120.0)}
ELECTRICAL: Row = {
    "PFFLAG": 0,
    "VFLAG": 1,
    "QFLAG": 1,
    "PQFLAG": 0,
    "Trv": 0.015,
    "Kqp": 0.1,
    "Kqi": 0.5,
    "Kvp": 2,
    "Kvi": 20,
}
PLANT: Row = {
    "RefFlag": 0,
    "VCFlag": 0,
    "Fflag": 1,
    "Tfltr": 0.04,
    "Kp": 0.5,
    "Ki": 2,
    "Tft": 0.05,
    "Tfv": 0.1,
    "Tp": 0.05,
    "Tg": 0.1,
}
DROOP = {"Kpg": 0.2, "Kig": 1.0, "Ddn": 20.0, "Dup": 20.0, "fdbd1": 0.0, "fdbd2": 0.0}


def inverter(name: str, model: str, **changes: Any) -> Row:
    """An inverter in the place of a machine."""
    bus, P, rating = RATINGS[name]
    return {"name": name, "bus": bus, "P": P, "V": 1.025, "rating": rating, **constants(model), **changes}


def controlled(name: str, plant: Row | None = None, **changes: Any) -> list[Row]:
    """An electrical control of an inverter, and one of its plant."""
    controls = [{"inverter": name, **constants("REECB1", **changes)}]
    return controls + ([{"inverter": name, **constants("REPCA1", **plant)}] if plant is not None else [])


def nine_buses(*inverters: Row, controls: list[Row] | None = None, inputs: tuple[str, ...] = ()) -> Row:
    """The nine buses with one machine left; `inputs`: of setpoints, `I2.Paux`."""
    system = content("wscc_9")
    for table in ("machines", "exciters"):
        system[table] = system[table][:1]
    system["pmus"] = system["pmus"][:1]
    places = [text.split(".") for text in inputs]
    system["devices"] = [
        {"name": f"{at}_{what}", "kind": "inverter_input", "inverter": at, "input": what, "rate_max": 2.0}
        for at, what in places
    ]
    return {**system, "inverters": list(inverters), "inverter_controls": controls or [], "signals": {}, "measures": {}}


FORMED: dict[str, Targets] = {"I2_Paux": [(0.1, 0.05)], "I2_Vaux": [(0.15, -0.02)], "I3_Paux": [(0.2, -0.08)]}
FOLLOWED: dict[str, Targets] = {"I2_Pplant": [(0.1, -0.05)], "I2_Qaux": [(0.15, 0.05)], "I3_Paux": [(0.2, -0.08)]}
PLANTS: dict[str, Targets] = {"I2_Qaux": [(0.1, 0.03)], "I2_Qplant": [(0.2, -0.02)], "I3_Vplant": [(0.15, 0.02)]}


def forming() -> Row:
    """A droop and a virtual machine, of which the fault limits the currents."""
    units = inverter("I2", "REGFMA1"), inverter("I3", "REGFMB1")
    return nine_buses(*units, inputs=("I2.Paux", "I2.Vaux", "I3.Paux"))


def following() -> Row:
    """A current source with controls of its plant at a line and of the frequency, and a PLL; the fault is a dip."""
    plant = {**PLANT, **DROOP, "bus": "B7", "branch": "line_7_8"}
    controls = [*controlled("I2", plant, **ELECTRICAL, Vdip=0.7), *controlled("I3", Vdip=0.6, dPmax=2, dPmin=-2)]
    units = inverter("I2", "REGCA1", Lvplsw=1), inverter("I3", "REGCC1")
    return nine_buses(*units, controls=controls, inputs=("I2.Pplant", "I2.Qaux", "I3.Paux"))


def plants() -> Row:
    """A droop with a regulator in a plant that holds reactive power, an EMF that follows in one of a voltage."""
    compensated = {"VCFlag": 1, "RefFlag": 1, "Rc": 0.01, "Xc": 0.05}
    of_voltage = {"bus": "B9", "branch": "line_8_9", **compensated, "Kp": 1, "Ki": 3, "Qmax": 1.2, "Qmin": 0.8}
    controls = controlled("I2", {"RefFlag": 0, "Kp": 0.2, "Ki": 1})[1:]
    controls += controlled("I3", of_voltage, QFLAG=1, PQFLAG=1, Kvp=1, Kvi=10)
    units = inverter("I2", "REGFMA1", VFlag=1, QVFlag=0, Te=0.005), inverter("I3", "REGCB1", RateFlag=1)
    return nine_buses(*units, controls=controls, inputs=("I2.Qaux", "I2.Qplant", "I3.Vplant"))


CASES: dict[str, Case] = {
    "forming": Case(forming, [fault("line_7_8", x=0.01, duration=0.07)], FORMED, 0.7, 5e-6, "RK45", FINE),
    "following": Case(following, [fault(bus="B8", x=0.03, duration=0.07)], FOLLOWED, 0.7, 5e-6, "LSODA", FINE),
    "plants": Case(plants, [fault("line_7_8", x=0.01, duration=0.07)], PLANTS, 0.7, 5e-6, "RK45", FINE),
}
