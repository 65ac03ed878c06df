"""Systems as MATPOWER cases: read back by another program's reader, their power flow worked out apart."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest
from matpowercaseframes import CaseFrames

from facts_damping.case.loading import load_system
from facts_damping.cli.main import main
from facts_damping.parameters.field_errors import check
from facts_damping.parameters.files import shipped
from facts_damping.parameters.plant.system import System
from facts_damping.plant.grid.power_flow import solve
from facts_damping_grids.matpower_reading import import_case
from facts_damping_grids.matpower_writing import text
from tests.commands import assert_one_line
from tests.plant.running import changed
from tests.two_plants import path as file_of

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray


def mismatch(case: CaseFrames) -> float:
    """Largest power that is not balanced at the case's voltages, p.u., by MATPOWER's branch model (manual, 3.2)."""
    bus, branch, gen = (getattr(case, name).astype(float) for name in ("bus", "branch", "gen"))
    V: NDArray[np.complex128] = (bus["VM"] * np.exp(1j * np.deg2rad(bus["VA"]))).to_numpy()
    Y = np.diag((bus["GS"] + 1j * bus["BS"]).to_numpy() / case.baseMVA)
    for _, row in branch.iterrows():
        f, t = int(row["F_BUS"]) - 1, int(row["T_BUS"]) - 1
        ys, half = 1.0 / complex(row["BR_R"], row["BR_X"]), 0.5j * row["BR_B"]
        tap = (row["TAP"] or 1.0) * np.exp(1j * np.deg2rad(row["SHIFT"]))
        Y[f, f] += (ys + half) / abs(tap) ** 2
        Y[f, t] -= ys / np.conj(tap)
        Y[t, f] -= ys / tap
        Y[t, t] += ys + half
    power = -(bus["PD"] + 1j * bus["QD"]).to_numpy() / case.baseMVA
    for _, row in gen.iterrows():
        power[int(row["GEN_BUS"]) - 1] += complex(row["PG"], row["QG"]) / case.baseMVA
    return float(np.abs(V * np.conj(Y @ V) - power).max())


@pytest.mark.parametrize("name", shipped("systems"))
def test_case_is_balanced_at_its_voltages(name: str, tmp_path: Path) -> None:
    """Long lines, magnetising branches, resistances of devices, loads at nominal voltage, DC links among them."""
    path = tmp_path / "case.m"
    path.write_text(text(load_system(name), "case"))
    assert mismatch(CaseFrames(str(path), update_index=False)) < 1e-9


@pytest.mark.parametrize("V", [None, 1.0])
def test_inverters_are_generators(V: float | None, tmp_path: Path) -> None:
    """One that holds no voltage leaves its bus a PQ bus, with the reactive power that it gives."""
    solar = load_system(file_of("solar"))
    system = changed(solar, inverters=[{**solar.inverters[0].model_dump(), "V": V}])
    path = tmp_path / "case.m"
    path.write_text(text(system, "case"))
    case = CaseFrames(str(path), update_index=False)
    assert mismatch(case) < 1e-9
    assert case.bus["BUS_TYPE"].tolist() == [3, 2, 1 if V is None else 2]
    row, flow = case.gen.iloc[2], solve(system).generation["SOLAR"] * 100
    assert [row["PG"], row["QG"], row["MBASE"]] == pytest.approx([200.0, flow.imag, 300.0])
    assert [row["QMAX"], row["QMIN"]] == pytest.approx([50.0, 50.0] if V is None else [300.0, -300.0])
    assert case.bus["PD"].tolist() == pytest.approx([0.0, 0.0, 700.0])


@pytest.mark.parametrize("name", ["new_england_39", "wscc_9"])
def test_case_that_is_imported_again_has_the_same_power_flow(name: str, tmp_path: Path) -> None:
    path = tmp_path / "again.m"
    main(["export", name, "--out", str(path)])
    flow = solve(load_system(name))
    again = solve(check(System, import_case(path).content, str(path)))
    assert np.abs(flow.voltage - again.voltage).max() < 1e-8


def test_name_that_matlab_cannot_have_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert_one_line(
        2,
        ["export", "wscc_9", "--out", str(tmp_path / "9 buses.m")],
        "allowed: a name of letters, digits and _",
        capsys,
    )
    assert not list(tmp_path.iterdir())
