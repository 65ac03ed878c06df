"""Inverters at the start: any dispatch is at rest, or every limit that excludes it is named at once."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from facts_damping.errors import InputError
from facts_damping.parameters.plant.system import System
from facts_damping_reproduction.inverter_faults.cases import units
from tests.plant.running import plant, slopes

if TYPE_CHECKING:
    from collections.abc import Sequence

RATING = 100.0  # MVA
CONVERTERS = ("REGCA1", "REGCB1", "REGCC1", "REGFMA1", "REGFMB1")


def at_voltage(V: float, rows: Sequence[dict[str, Any]], controls: Sequence[dict[str, Any]]) -> System:
    """Inverters, each at the end of a line from an infinite bus of a voltage."""
    names = [row["name"] for row in rows]
    tables = {
        "buses": [{"name": name, "nominal_voltage": 100.0} for name in ("A", *names)],
        "lines": [{"name": f"to_{name}", "from": "A", "to": name, "r": 0.005, "x": 0.1} for name in names],
        "infinite_buses": [{"name": "grid", "bus": "A", "V": V}],
        "inverters": [{"bus": row["name"], "rating": RATING, **row} for row in rows],
        "inverter_controls": [*controls],
        "pmus": [{"name": name, "machine": name} for name in names],
    }
    return System.model_validate({"name": "one", "ranges": "physical", **tables})


@st.composite
def units_at_any_dispatch(draw: st.DrawFn) -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
    """One or two inverters with controls, flags as they come, at any power."""
    rows, controls = list[dict[str, Any]](), list[dict[str, Any]]()
    for name in ("I1", "I2")[: draw(st.integers(1, 2))]:
        model = draw(st.sampled_from(CONVERTERS))
        power = {"P": draw(st.floats(0.0, RATING)), "Q": draw(st.floats(-60.0, 60.0))}
        rows.append({"name": name, "model": model, **units()["inverters"][model], **power})
        if model == "REGCA1":
            rows[-1]["Lvplsw"] = draw(st.integers(0, 1))
        if model.startswith("REGFM"):
            continue
        electrical = draw(st.sampled_from(["REECA1", "REECB1"]))
        flags = {flag: draw(st.integers(0, 1)) for flag in ("PFFLAG", "VFLAG", "QFLAG", "PQFLAG")}
        controls.append({"inverter": name, "model": electrical, **units()["electrical"][electrical], **flags})
        if draw(st.booleans()):
            plant_flags = {flag: draw(st.integers(0, 1)) for flag in ("VCFlag", "RefFlag", "Fflag")}
            controls.append({"inverter": name, "model": "REPCA1", **units()["plant"]["REPCA1"], **plant_flags})
    return rows, controls


@settings(deadline=None, max_examples=60)
@given(drawn=units_at_any_dispatch(), V=st.floats(0.9, 1.1))
def test_any_dispatch_is_at_rest_or_its_limits_are_named(
    drawn: tuple[list[dict[str, Any]], list[dict[str, Any]]], V: float
) -> None:
    rows, controls = drawn
    try:
        built = plant(at_voltage(V, rows, controls))
    except InputError as error:
        for line in str(error).splitlines():
            assert "at the start; allowed" in line
            assert any(name in line for name in ("I1", "I2"))
    else:
        assert np.abs(slopes(built)).max() < 1e-9


def test_all_limits_of_all_inverters_are_named_at_once() -> None:
    """Of current sources, EMFs and controls, with the field of each; one without steady state, too."""
    values, electrical = units()["inverters"], units()["electrical"]["REECB1"]
    rows = [
        {"name": "voltage", "model": "REGCA1", **values["REGCA1"], "P": 50.0, "Lvpnt0": 1.1, "Lvpnt1": 1.2},
        {"name": "forming", "model": "REGFMB1", **values["REGFMB1"], "P": 90.0, "Q": 60.0, "ImaxF": 1.0},
        {"name": "power", "model": "REGCB1", **values["REGCB1"], "P": 90.0, "Q": 20.0},
        {"name": "factor", "model": "REGCA1", **values["REGCA1"], "P": 50.0, "Q": 20.0},
    ]
    flags = {"QFLAG": 1, "VFLAG": 1}
    changes = {"voltage": {}, "power": {"Imax": 0.8, "Pmax": 0.85, "Qmax": 0.1, **flags}}
    changes |= {"factor": {"PFFLAG": 1, "VFLAG": 0, "QFLAG": 1}}
    controls = [{"inverter": name, "model": "REECB1", **electrical, **changes[name]} for name in changes]
    with pytest.raises(InputError) as error:
        plant(at_voltage(1.0, rows, controls))
    said = str(error.value).splitlines()
    for name, field in [("voltage", "Lvpnt0"), ("forming", "ImaxF"), ("power", "Pmax"), ("power", "Qmax")]:
        assert any(f"inverters: {name}: " in line.replace("inverter_controls", "inverters") and f"({field})" in line
                   for line in said), (name, field)  # fmt: skip
    assert any(line.startswith("REGCA1 of factor: no steady state of ") for line in said)
