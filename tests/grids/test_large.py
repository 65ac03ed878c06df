"""What is shown of a large grid stays readable: NPCC, 140 buses and 48 machines in six areas, from ANDES's wheel."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest

from facts_damping.analysis.histories import centres_of_angle, mean_speeds
from facts_damping.analysis.plotting.pictures import LARGEST, PICTURES, shown, title_of
from facts_damping.analysis.plotting.plots import plot_comparison
from facts_damping.case.loading import load_system, make_case
from facts_damping.cli.main import main
from facts_damping.simulation import loop
from facts_damping.small_signal import modal_tables
from facts_damping.small_signal.modal_tables import MAX_MACHINES, MAX_MODES, MAX_RESIDUES
from facts_damping_studies.modes import modal_pictures, one_line
from facts_damping_views import bus_places
from tests.andes_cases import CASES

if TYPE_CHECKING:
    from pathlib import Path

    from facts_damping.record import Record
    from facts_damping.small_signal.modal_tables import Modal


@pytest.fixture(scope="module")
def system_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("npcc") / "npcc.yaml"
    assert main(["import", str(CASES / "npcc/npcc.raw"), str(CASES / "npcc/npcc_full.dyr"), "--out", str(path)]) == 0
    return path


@pytest.fixture(scope="module")
def modal(system_file: Path) -> Modal:
    sets = ["devices=[{name: damper, kind: statcom, bus: B7, setpoint_max: 0.1, rate_max: 10, I_max: 1}]"]
    return modal_tables.analyse(load_system(str(system_file), sets), ["damper"])


@pytest.fixture(scope="module")
def record(system_file: Path) -> Record:
    events = [{"time": 0.5, "kind": "fault", "bus": "B7", "duration": 0.05}]
    run = {"system": str(system_file), "scenario": events, "devices": [], "controllers": [], "duration": 3.0}
    return loop.run(make_case(run, "test"))


def test_modes_of_a_large_grid_fit_the_eye(modal: Modal, tmp_path: Path) -> None:
    lines = list(modal_tables.modes_text(modal))
    assert len(lines) < 450
    assert sum(line.startswith("\n") and "swing against each other" in line for line in lines) == MAX_MODES
    assert any(line.startswith("and ") and line.endswith("all in --json") for line in lines)
    few = dict(list(modal.system.signals.items())[:2])  # zeros of a transfer function of 500 states take a while
    document = modal_tables.document(modal._replace(system=modal.system.model_copy(update={"signals": few})))
    rows = [len(mode["residues"]) for mode in document["modes"] if mode["residues"]]
    assert set(rows) == {47}  # all of them
    assert max(line.count(",") for line in lines if line.startswith("  G")) <= MAX_MACHINES
    tables = "\n".join(lines).split("residue 1/s")[1:]
    assert all(table.count("  damper ") == MAX_RESIDUES for table in tables)
    assert modal_tables.shown_modes(modal) == sorted(
        modal_tables.shown_modes(modal), key=lambda mode: mode.damping_ratio
    )
    paths = modal_pictures.plot(modal, tmp_path)
    assert [path.name for path in paths] == ["one_line.png", "mode_shapes.png", "transfer_functions.png"]
    assert [np.isfinite(transfer["gain"]) for transfer in document["transfer_functions"]] == [True, True]


def test_flows_of_a_diagram_are_those_of_the_power_flow(modal: Modal) -> None:
    """What enters and leaves each bus by its branches is what is generated there, less what is drawn; in MW."""
    base, flow = modal.system.base_power, modal.built.flow
    balance = dict(zip(flow.names, flow.injection.real * base, strict=True))
    for shunt in modal.system.shunts:
        balance[shunt.bus] -= shunt.P * abs(flow.voltage[flow.names.index(shunt.bus)]) ** 2
    lost = sum(balance.values())
    for start, end, power in one_line.flows(modal.system, flow):
        assert power >= -1e-6, (start, end)
        balance[start] -= power
        balance[end] += power
    assert sum(balance.values()) == pytest.approx(lost, abs=1e-6)
    assert all(left + 1e-9 > -1e-6 and left < lost + 1e-6 for left in balance.values())  # losses, where it arrives
    at = bus_places.places(modal.system)
    apart = np.array([at[bus.name] for bus in modal.system.buses])
    gaps = np.linalg.norm(apart[:, None] - apart[None], axis=2)[~np.eye(len(apart), dtype=bool)]
    assert gaps.min() > 0.002 * np.ptp(apart)


def test_many_machines_are_drawn_by_their_areas(record: Record, tmp_path: Path) -> None:
    panels = {picture.stem: picture.panels(record) for picture in PICTURES}
    areas = [f"mean of area_{i}" for i in range(1, 7)]
    assert [panel.name for panel in panels["speeds"]] == areas
    picture = next(picture_of_run for picture_of_run in PICTURES if picture_of_run.stem == "differences")
    by_name = [{panel.name: panel for panel in panels["differences"]}]
    names_shown = shown(picture, by_name)
    assert title_of(picture, by_name, names_shown) == "Speed difference: the 7 largest of 47"
    size = {name: np.ptp(panel.curves[""].values) for name, panel in by_name[0].items()}
    assert set(names_shown) == set(sorted(size, key=lambda name: -size[name])[:LARGEST])
    assert plot_comparison([("", record)], tmp_path)


def test_mean_speed_turns_the_centre_of_angle(record: Record) -> None:
    """d delta / dt = omega_0 dw of the means, less that of all machines, from which angles count."""
    omega_0, angles = 2.0 * np.pi * 60.0, centres_of_angle(record)
    weights = {m["name"]: m["H"] * m["rating"] for m in record.configuration["system"]["machines"]}
    inertia = np.array([weights[name] for name in record.machine_names])
    all_of_them = record.machines["speed_deviation"] @ inertia / inertia.sum()
    for area, speed in mean_speeds(record).items():
        quiet = slice(60, None)  # after the fault: central differences see no jump
        slope = np.gradient(angles[area], record.time_s)[quiet][1:-1]
        assert slope == pytest.approx(omega_0 * (speed - all_of_them)[quiet][1:-1], abs=2e-3)
