"""Signals by name on the grid of ticks, with units; the same in Parquet and CSV."""

from __future__ import annotations

from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
import pyarrow.parquet
import pytest

from facts_damping import signals
from facts_damping.case.loading import load_case
from facts_damping.cli.main import main
from facts_damping.monitor_table import CODES, MONITORS
from facts_damping.recording import decoded_tables, load
from facts_damping.recording.columns import Block
from facts_damping.recording.decode import Series
from facts_damping.signals import CHANNELS
from facts_damping.simulation import loop
from tests.commands import assert_one_line

if TYPE_CHECKING:
    from pathlib import Path

    from facts_damping.record import Record

RUN = ["duration=2", "link=plc", "controllers.0.name=HBsWC", "scenario=large", "frame_rate=50"]


@pytest.fixture(scope="module")
def record() -> Record:
    return loop.run(load_case(None, RUN))


def test_array_columns_are_on_the_grid_of_ticks_and_have_units(record: Record) -> None:
    assert record.arrays.keys() == record.units.keys()
    assert all(values.shape == (100,) for values in record.arrays.values())
    assert record.arrays["tick"].tolist() == list(range(100))
    assert set(record.units.values()) == {"-", "s", "pu", "rad", "hz", "hz_per_s", "pu/pu"}
    for name, unit in record.units.items():
        ending = {"pu/pu": "_pu_per_pu", "-": ""}.get(unit, f"_{unit}")
        assert name.endswith(ending)


def test_arrays_of_sampled_signals_are_the_recorded_values(record: Record) -> None:
    arrays = record.arrays
    assert arrays["machine.G3.rotor_angle_rad"].tobytes() == record.machines["rotor_angle"][:, 2].tobytes()
    assert arrays["device.sssc.injected_voltage_pu"].tobytes() == record.devices["injected_voltage"][:, 0].tobytes()
    column = list(CHANNELS).index("active_power")
    assert arrays["pmu.TIE.active_power_pu"].tobytes() == record.frames[:, record.pmus.index("TIE"), column].tobytes()


def test_arrays_of_irregular_messages_hold_the_newest_value(record: Record) -> None:
    """Tick by tick, by hand: entries that are older than what is known do not count."""
    speed, pmu = list(CHANNELS).index("speed_deviation"), record.pmus.index("G2")
    known, at, issued = np.nan, -1, np.nan
    for tick in range(100):
        for row in record.delivered[(record.delivered["tick"] == tick) & (record.delivered["pmu"] == pmu)]:
            if row["measured_ns"] > at:
                at, known = row["measured_ns"], row["values"][speed]
        for row in record.issued[record.issued["tick"] == tick]:
            issued = row["value"]
        np.testing.assert_equal(record.arrays["delivered.0.G2.speed_deviation_pu"][tick], known)
        np.testing.assert_equal(record.arrays["issued.controller_0_HBsWC.sssc_pu"][tick], issued)
    assert np.isnan(record.arrays["delivered.0.G2.speed_deviation_pu"][0])
    assert at > 0
    assert record.arrays["delivered.0.G2.measured_s"][-1] == at / 1e9


def test_estimates_and_learning_rates_are_there(record: Record) -> None:
    jacobian = record.arrays["estimate.controller_0_HBsWC.speed.sssc_pu_per_pu"]
    assert jacobian.tobytes() == record.estimates["jacobian"].tobytes()
    rows = record.learning[(record.learning["identifier"] == 0) & (record.learning["group"] == 1)]
    assert record.arrays["learning.controller_0_HBsWC.controller.0.1.rate"].tobytes() == rows["rate"].tobytes()
    assert "learning.controller_0_HBsWC.identifier.lyapunov" in record.arrays


def test_supervision_arrays_have_a_column_for_each_monitor() -> None:
    sets = ["supervision=standard", "arm_at=0.5", "duration=2", "devices=[sssc,statcom]"]
    record = loop.run(load_case(None, sets))
    arrays, place = record.arrays, "supervision.controller_0_LLC"
    names = [name.removeprefix(f"{place}.") for name in arrays if name.startswith(place)]
    assert names == ["state", "fraction", *MONITORS]
    assert {name: record.units[f"{place}.{name}"] for name in MONITORS} == {n: row.unit for n, row in MONITORS.items()}
    assert arrays[f"{place}.state"].tolist() == [1.0] * 30 + [2.0] * 90
    assert arrays[f"{place}.fraction"][[29, 59, 119]] == pytest.approx([1.0, 0.5, 1.0])
    assert arrays[f"{place}.frequency"].tobytes() == record.supervision["values"][:, CODES["frequency"]].tobytes()
    said = arrays["supervised.controller_0_LLC.sssc_pu"]
    assert not said[:30].any()
    assert said[119] == arrays["issued.controller_0_LLC.sssc_pu"][119] != 0.0


def test_frame_rate_is_told_by_the_ticks_where_nothing_else_tells(record: Record) -> None:
    bare = load_case(None, ["duration=1", "frame_rate=30"])
    bare_run = loop.run(bare)
    bare_run.configuration.clear()
    assert bare_run.frame_rate == 30
    assert bare_run.ticks.tolist() == list(range(30))


@pytest.mark.parametrize("kind", ["parquet", "csv"])
def test_export_holds_the_same_columns(tmp_path: Path, record: Record, write_record: Any, kind: str) -> None:
    write_record(record, tmp_path / "run")
    file = tmp_path / f"table.{kind}"
    assert main(["export", str(tmp_path / "run"), "--out", str(file)]) == 0
    arrays = load(tmp_path / "run").arrays
    table = pd.read_parquet(file) if kind == "parquet" else pd.read_csv(file, engine="pyarrow")
    assert list(table.columns) == list(arrays)
    for name, values in arrays.items():
        np.testing.assert_array_equal(table[name].to_numpy(), values, err_msg=name)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["run", file.name]
    if kind == "parquet":
        schema = pyarrow.parquet.read_schema(file)
        assert schema.field("machine.G1.rotor_angle_rad").metadata == {b"unit": b"rad"}
        assert b"HBsWC" in schema.metadata[b"run.yaml"]


def test_export_for_the_plots_of_andes(tmp_path: Path, record: Record, write_record: Any) -> None:
    """Read as `andes.plot.TDSData` of ANDES 2.0 does: rows `number, name, TeX`; `data` of the `.npz`, time first."""
    write_record(record, tmp_path / "run")
    assert main(["export", str(tmp_path / "run"), "--out", str(tmp_path / "run_out.lst")]) == 0
    rows = [[cell.strip() for cell in line.split(",")] for line in (tmp_path / "run_out.lst").read_text().splitlines()]
    data = np.load(tmp_path / "run_out.npz")["data"]
    assert [int(row[0]) for row in rows] == list(range(data.shape[1]))
    assert rows[0][1] == "Time [s]"
    assert data[:, 0].tolist() == record.time_s.tolist()
    for name in ("machine.G3.rotor_angle_rad", "device.sssc.injected_voltage_pu"):
        at = next(int(row[0]) for row in rows if row[1] == name)
        assert data[:, at].tobytes() == record.arrays[name].tobytes()


@pytest.mark.parametrize(("out", "said"), [("table.xlsx", "allowed: a file that ends with .parquet, .csv, .lst or .m"),
                                           ("none/table.csv", "cannot be written")])  # fmt: skip
def test_export_refuses_in_one_line(
    tmp_path: Path, record: Record, write_record: Any, capsys: Any, out: str, said: str
) -> None:
    write_record(record, tmp_path / "run")
    assert_one_line(2, ["export", str(tmp_path / "run"), "--out", str(tmp_path / out)], said, capsys)


def test_recording_with_fewer_monitors_has_no_values_of_the_others() -> None:
    """Of a version before `forced`, and of one that knows another one."""
    monitors = [*(name for name in MONITORS if name != "forced"), "later"]
    numbers = dict.fromkeys(signals.SUPERVISION_FIELDS.values(), np.zeros(2))
    words = {"controller": "c", "state": "armed", "cause": "", "refused": ""}
    values = [np.full(2, float(k)) for k in range(len(monitors))]
    message = SimpleNamespace(**words, **numbers, monitors=monitors, values=values)
    series = Series("/supervisor/state", np.arange(2), [Block(np.arange(2), message)])
    rows = decoded_tables.supervision([series], ["c"])["values"]
    assert rows[0, :-1].tolist() == list(range(23))
    assert np.isnan(rows[:, CODES["forced"]]).all()
