"""Grid-forming inverters against PSTess: two areas with REGFM_A1, eigenvalues, steps, a brake, a fault.

PSTess linearises with lags of 5 ms in the source, where its data and its runs have none; so do these eigenvalues. It
leaves the charging of a line at its buses when the line is opened; so does the system of the fault.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from facts_damping.case.loading import load_system
from facts_damping.input_files import share_folder
from facts_damping.plant.build import build
from facts_damping.signals import CHANNELS
from facts_damping.small_signal.linearisation import linearise
from facts_damping_validation.small_signal import varied
from facts_damping_validation.table import Row, ValidationTable, figures, within
from facts_damping_validation.time_domain import follow

if TYPE_CHECKING:
    from collections.abc import Sequence

    from facts_damping.compiling.structs import Complex1
    from facts_damping.parameters.plant.system import System

SOURCE_TEXT = "PSTess 1.1 (Octave)"
LAGS = {"Td": 0.005, "Te": 0.005, "Tv": 0.005}  # s, of PSTess's linear model
REGULATED = {"VFlag": 1, "QVFlag": 0}  # of the case `gfmapi`: E by a regulator of the voltage
OSCILLATING = 0.01  # rad/s, least imaginary part
AT_ZERO = 0.05  # 1/s, of the angle that all have in common
RATING = 2.0  # p.u. of the system, of each inverter
SENSITIVE = "two real ones lie so close that PSTess's differences of 1e-4 move them by this"
# Columns of PSTess by the inverter's PMU and its channel.
COLUMNS = {"V": "voltage_magnitude", "P": "active_power", "Q": "reactive_power", "I": "current_magnitude"}
INVERTERS = {"1": "INVERTER_1", "11": "INVERTER_11"}


class Disturbance(NamedTuple):
    """A run: what happens, the file of PSTess's, and the fields of the inverters that differ."""

    what: str
    file: str
    events: Sequence[dict[str, Any]] = ()
    setpoints: dict[str, float] | None = None  # p.u., of devices from `ASKED` on
    inverters: dict[str, Any] | None = None
    charged: str = ""  # the line whose charging stays at its buses
    columns: str = "VPQ"


STEPS, ASKED = {"P1": 0.02, "Q11": -0.05}, (1.0, 5.0)  # p.u., s
BRAKE = {"time": 1.0, "kind": "brake", "bus": "B20", "power": 50.0, "duration": 0.5}
FAULT = (
    {"time": 1.0, "kind": "fault", "bus": "B3", "duration": 0.1},
    {"time": 1.1, "kind": "line_out", "line": "line_3_101"},
    {"time": 1.1, "kind": "load_step", "load": "other_charging", "change": -1},
    {"time": 1.1, "kind": "fault", "bus": "B101", "r": 0.011, "x": 0.11, "duration": 0.02},
)
DISTURBANCES = (
    Disturbance("steps of P and Q", "gfma_steps", setpoints=STEPS),
    Disturbance("steps of P and Q, E by a regulator", "gfmapi_steps", setpoints=STEPS, inverters=REGULATED),
    Disturbance("brake of 50 MW at B20", "gfma_brake", [BRAKE]),
    Disturbance("bolted fault at B3, current limited", "gfma_fault", FAULT, charged="line_3_101", columns="VPQI"),
)


def system_of(inverters: dict[str, Any] | None) -> System:
    """PSTess's system, with fields of its inverters changed."""
    system = load_system(str(share_folder() / "config" / "references" / "pstess" / "two_area_gfm.yaml"))
    return varied(system, {"inverters": inverters or {}})


def eigenvalues() -> ValidationTable:
    """All oscillatory eigenvalues, and all real ones but that of the common angle."""
    rows = list[Row]()
    for case, fields, tolerance, cause in (("gfma", {}, 1e-3, ""), ("gfmapi", REGULATED, 0.01, SENSITIVE)):
        data = figures(f"pstess/{case}_eigenvalues")
        theirs = np.asarray(data["re"] + 1j * data["im"], np.complex128)
        matrix = linearise(build(system_of({**LAGS, **fields}), [], []))[0]
        ours = np.asarray(np.linalg.eigvals(matrix), np.complex128)
        swinging = theirs.imag > OSCILLATING
        # PSTess has four real ones of -20 from modulations of loads that stand still.
        real = (np.abs(theirs.imag) <= OSCILLATING) & (np.abs(theirs) > AT_ZERO) & (theirs.real != -20.0)
        what = f"{case}: {{}} {{}} eigenvalues"
        for kind, chosen, bound, why in (("oscillatory", swinging, 1e-3, ""), ("real", real, tolerance, cause)):
            row = within(what.format(chosen.sum(), kind), "1/s", _apart(ours, theirs[chosen]), bound)
            rows.append(row._replace(cause=why))
    return ValidationTable("Eigenvalues with grid-forming inverters", SOURCE_TEXT, "", rows)


def _apart(ours: Complex1, theirs: Complex1) -> Complex1:
    """Differences of `theirs` from the nearest of ours."""
    return np.asarray(ours[np.abs(ours[:, None] - theirs[None]).argmin(axis=0)] - theirs)


def disturbances() -> ValidationTable:
    """Speeds, voltages, powers and currents, relative to the range of each."""
    rows = list[Row]()
    for run in DISTURBANCES:
        theirs = figures(f"pstess/{run.file}")
        system = system_of(run.inverters)
        system = _charged(system, run.charged) if run.charged else system
        at = ASKED if run.setpoints else 0.0
        seen = follow(system, [d.name for d in system.devices], theirs["t"], run.events, run.setpoints, asked_at=at)
        pmus = [pmu.name for pmu in system.pmus]
        apart = [seen.machines["speed_deviation"][:, g] + 1.0 - theirs[f"w{bus}"] for g, bus in enumerate(("2", "12"))]
        swing = max(np.ptp(theirs["w2"]), np.ptp(theirs["w12"]))
        rows.append(within(f"{run.what}: speeds", "of the range", np.array(apart) / swing, 0.01))
        for column in run.columns:
            scale = 1.0 if column == "V" else RATING
            channel = list(CHANNELS).index(COLUMNS[column])
            pair = [
                (seen.frames[:, pmus.index(pmu), channel] / scale, theirs[f"{column}{bus}"])
                for bus, pmu in INVERTERS.items()
            ]
            apart = [ours - other for ours, other in pair]
            swing = max(np.ptp(other) for _, other in pair)
            rows.append(
                within(
                    f"{run.what}: {COLUMNS[column].replace('_', ' ')}", "of the range", np.array(apart) / swing, 0.01
                )
            )
    return ValidationTable("Disturbances of grid-forming inverters", SOURCE_TEXT, "", rows)


def _charged(system: System, line: str) -> System:
    """The charging of a line as shunts at its buses, and at its second bus once more when `other_charging` goes off.

    PSTess opens a line at its faulted end by a second line from a new bus, whose charging stays at the other end.
    """
    content = system.model_dump(by_alias=True)
    row = next(row for row in content["lines"] if row["name"] == line)
    half = 0.5 * row["b"] * row["length"] * system.base_power
    row["b"] = 0.0
    ends = ((row["from"], half), (row["to"], 2.0 * half))
    content["shunts"] += [{"name": f"charging_{bus}", "bus": bus, "Q": Q} for bus, Q in ends]
    content["loads"].append({"name": "other_charging", "bus": row["to"], "P": 0.0, "Q": half, "at": "nominal"})
    return type(system).model_validate(content)
