"""WECC-240, a grid of 243 buses with 103 machines and 37 inverters, imported from its files of PSS/E, against ANDES.

Where ANDES has an equation otherwise than PSS/E, ours is put as ANDES has it; where it misreads the files, it was put
right (README.md of `config/references`).
"""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np

from facts_damping.input_files import share_folder
from facts_damping.parameters.field_errors import check
from facts_damping.parameters.plant.system import System
from facts_damping.plant.build import build
from facts_damping.plant.grid.power_flow import solve
from facts_damping.small_signal.linearisation import linearise
from facts_damping_grids.psse.conversion import import_case
from facts_damping_validation.as_there import DIVIDES, models_with
from facts_damping_validation.table import Row, ValidationTable, figures, furthest, within
from facts_damping_validation.time_domain import follow

if TYPE_CHECKING:
    from pathlib import Path

    from facts_damping.compiling.structs import Complex1, Float2

FOLDER = "wecc240"
FILES = ("240busWECC_2018_PSS32_fixed_shunts.raw", "240busWECC_2018_PSS.dyr")
SWINGS = (0.2 * np.pi, 6.0 * np.pi)  # rad/s, of the eigenvalues that are compared with stabilisers
SAME_POWER_FLOW = 1e-8  # p.u.
SAME_SWINGS, SAME_EQUATIONS = 2e-6, 1e-5  # 1/s; the second also of eigenvalues that lie together
NOTHING = 1e-9  # 1/s, of a coefficient of a state matrix
STEP = 1e-5  # p.u., what ANDES's steps of 8.3 ms may leave of speeds
CONTROLS_AS_THERE = {"REECB1": (DIVIDES,)}
TRIP = {"kind": "generator_trip", "machine": "G1431_N", "time": 1.0}


def andes() -> ValidationTable:
    """Power flow, eigenvalues without and with stabilisers, the trip of 2.4 GW."""
    without, stabilised = (check(System, as_there(stabilisers=there), FOLDER) for there in (False, True))
    with models_with(CONTROLS_AS_THERE):
        rows = [_voltages(without), _all_eigenvalues(without), _swings(stabilised), _trip(without)]
    command = f"facts-damping import {' '.join(FILES)}"
    return ValidationTable("WECC-240", "ANDES", command, rows)


def files() -> tuple[Path, Path]:
    """RAW and DYR."""
    folder = share_folder() / "config" / "references" / FOLDER
    raw, dyr = (folder / name for name in FILES)
    return raw, dyr


@cache
def _content() -> dict[str, Any]:
    return import_case(*files()).content


def as_there(*, stabilisers: bool) -> dict[str, Any]:
    """Content of the system at ANDES's powers of its units, with its equations (`models_with(CONTROLS_AS_THERE)`).

    A plant control without a branch sees no power there and stands still; powers are not divided by the speed; HYGOV
    integrates with 1 for 1 / (r Tr) and has Tw in p.u. of the system.
    """
    content = _content() | ({} if stabilisers else {"stabilisers": []})
    powers = {str(row["unit"]): {"P": float(row["P"]), "Q": float(row["Q"])} for row in figures(f"{FOLDER}/units")}
    ratings = {row["name"]: row["rating"] / content["base_power"] for row in content["machines"]}
    machines, inverters = (
        [row | {key: value for key, value in powers[row["name"]].items() if key in row} for row in content[table]]
        for table in ("machines", "inverters")
    )
    governors = [
        row | {"Tr": ratings[row["machine"]] / row["r"], "Tw": ratings[row["machine"]] * row["Tw"]}
        if row["model"] == "HYGOV"
        else row
        for row in content["governors"]
    ]
    controls = [row for row in content["inverter_controls"] if row["model"] != "REPCA1"]
    changed = {"governors": governors, "inverters": inverters, "inverter_controls": controls, "ranges": "physical"}
    changed["machines"] = [row | {"speed_torque": False} for row in machines]
    return content | changed


def _voltages(system: System) -> Row:
    ours, theirs = solve(system).by_bus, figures(f"{FOLDER}/voltages")
    apart = [abs(ours[f"B{row['bus']}"] - row["V"] * np.exp(1j * row["angle"])) for row in theirs]
    return within(f"voltages of the {len(apart)} buses", "p.u.", apart, SAME_POWER_FLOW)


def _theirs(case: str) -> Complex1:
    """Eigenvalues of ANDES, 1/s; its file has of a pair the one above."""
    rows = figures(f"{FOLDER}/eigenvalues")
    rows = rows[rows["stabilisers"] == case]
    above = np.asarray(rows["re"] + 1j * rows["im"])
    return np.concatenate([above, above[above.imag > 0.0].conj()])


def _all_eigenvalues(system: System) -> Row:
    """All of the states that act on each other."""
    theirs, ours = _theirs("without"), _eigenvalues(_coupled(linearise(build(system, [], []))[0]))
    what = f"without stabilisers: all {len(ours)} eigenvalues"
    return within(what, "1/s", furthest(ours, theirs), SAME_EQUATIONS)


def _swings(system: System) -> Row:
    theirs, ours = _theirs("with"), _eigenvalues(linearise(build(system, [], []))[0])
    ours = ours[(np.abs(ours.imag) >= SWINGS[0]) & (np.abs(ours.imag) <= SWINGS[1])]
    what = f"with ten IEEEST: all {len(ours)} eigenvalues of 0.1 to 3 Hz"
    return within(what, "1/s", furthest(ours, theirs), SAME_SWINGS)


def _coupled(A: Float2) -> Float2:
    """The largest part of a state matrix whose states act on each other."""
    from scipy.sparse.csgraph import connected_components  # noqa: PLC0415 (of this table alone)

    _, part = connected_components(np.abs(A) > NOTHING, connection="strong")
    (coupled,) = np.nonzero(part == np.bincount(part).argmax())
    return A[np.ix_(coupled, coupled)]


def _eigenvalues(A: Float2) -> Complex1:
    return np.asarray(np.linalg.eigvals(A), np.complex128)


def _trip(system: System) -> Row:
    theirs = figures(f"{FOLDER}/trip")
    seen = follow(system, [], theirs["t"], [TRIP]).machines["speed_deviation"]
    names = [machine.name for machine in system.machines]
    apart = [seen[:, names.index(name)] + 1.0 - theirs[name] for name in (theirs.dtype.names or ())[1:]]
    return within(f"loss of {TRIP['machine']}, without stabilisers: speeds", "p.u.", apart, STEP)
