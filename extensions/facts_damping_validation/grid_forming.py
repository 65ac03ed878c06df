"""Grid-forming inverters against PSTess: two areas with REGFM_A1, eigenvalues, steps, a brake, a fault.

PSTess linearises with lags of 5 ms in the source, where its data and its runs have none; so do these eigenvalues. It
leaves the charging of a line at its buses when the line is opened; so does the system of the fault.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

from facts_damping_validation.pstess import Bound, disturbance_rows, eigenvalue_rows, system_of
from facts_damping_validation.small_signal import varied
from facts_damping_validation.table import Row, figures

if TYPE_CHECKING:
    from collections.abc import Sequence

    from facts_damping.parameters.plant.system import System

LAGS = {"Td": 0.005, "Te": 0.005, "Tv": 0.005}  # s, of PSTess's linear model
REGULATED = {"VFlag": 1, "QVFlag": 0}  # of the case `gfmapi`: E by a regulator of the voltage
SENSITIVE = "two real ones lie so close that PSTess's differences of 1e-4 move them by this"


class Disturbance(NamedTuple):
    """A run: what happens, the file of PSTess's, and the fields of the inverters that differ."""

    what: str
    file: str
    events: Sequence[dict[str, Any]] = ()
    setpoints: dict[str, float] | None = None  # p.u.
    inverters: dict[str, Any] | None = None
    charged: str = ""  # the line whose charging stays at its buses
    columns: str = "VPQ"


STEPS = {"P1": 0.02, "Q11": -0.05}  # p.u.
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


def eigenvalues() -> list[Row]:
    """Eigenvalues as shipped, and with a regulator of the voltage."""
    rows = list[Row]()
    for case, fields, real in (("gfma", {}, Bound()), ("gfmapi", REGULATED, Bound(0.01, SENSITIVE))):
        rows += eigenvalue_rows(case, _system({**LAGS, **fields}), Bound(), real)
    return rows


def disturbances() -> list[Row]:
    """Steps of setpoints, a brake, and a fault with the current limited."""
    rows = list[Row]()
    for run in DISTURBANCES:
        system = _system(run.inverters or {})
        system = _charged(system, run.charged) if run.charged else system
        theirs = figures(f"pstess/{run.file}")
        rows += disturbance_rows(run.what, theirs, system, run.events, run.setpoints, run.columns)
    return rows


def _system(inverters: dict[str, Any]) -> System:
    """PSTess's system, with fields of its inverters changed."""
    return varied(system_of("two_area_gfm"), {"inverters": inverters})


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
