"""Two areas with inverters against PSTess: eigenvalues, and runs after a disturbance, by the inverters of each case."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from facts_damping.case.loading import load_system
from facts_damping.input_files import share_folder
from facts_damping.signals import CHANNELS
from facts_damping_validation.small_signal import eigenvalues
from facts_damping_validation.table import Row, figures, within
from facts_damping_validation.time_domain import follow

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray

    from facts_damping.parameters.plant.system import System

SOURCE_TEXT = "PSTess 1.1 (Octave)"
OSCILLATING = 0.01  # rad/s, least imaginary part
AT_ZERO = 0.05  # 1/s, of the angle that all have in common
IDLE = (-20.0, -200.0)  # 1/s, of modulations of loads that stand still, and of lags that drive nothing
RATING = 2.0  # p.u. of the system, of each inverter
ASKED = (1.0, 5.0)  # s, of the two setpoints of a run
# Columns of PSTess by the inverter's PMU and its channel.
COLUMNS = {"V": "voltage_magnitude", "P": "active_power", "Q": "reactive_power", "I": "current_magnitude"}
INVERTERS = {"1": "INVERTER_1", "11": "INVERTER_11"}


class Bound(NamedTuple):
    """What eigenvalues may differ by, 1/s, and why that is more than differences of derivatives leave."""

    tolerance: float = 1e-3
    cause: str = ""


def system_of(name: str) -> System:
    """A system of PSTess."""
    return load_system(str(share_folder() / "config" / "references" / "pstess" / f"{name}.yaml"))


def eigenvalue_rows(case: str, system: System, oscillatory: Bound, real: Bound) -> list[Row]:
    """All oscillatory eigenvalues, and all real ones but those that are idle and that of the common angle."""
    data = figures(f"pstess/{case}_eigenvalues")
    theirs, ours = np.asarray(data["re"] + 1j * data["im"], np.complex128), eigenvalues(system)
    is_real = (np.abs(theirs.imag) <= OSCILLATING) & (np.abs(theirs) > AT_ZERO) & ~np.isin(theirs.real, IDLE)
    rows = []
    for kind, chosen, bound in (("oscillatory", theirs.imag > OSCILLATING, oscillatory), ("real", is_real, real)):
        apart = np.abs(ours[:, None] - theirs[None, chosen]).min(axis=0)
        what = f"{case}: {chosen.sum()} {kind} eigenvalues"
        rows.append(within(what, "1/s", apart, bound.tolerance)._replace(cause=bound.cause))
    return rows


def disturbance_rows(
    what: str,
    theirs: NDArray[np.void],
    system: System,
    events: Sequence[dict[str, Any]] = (),
    setpoints: Mapping[str, float] | None = None,
    columns: str = "VPQ",
) -> list[Row]:
    """Speeds, and columns of the inverters, relative to the range of each; setpoints, p.u., from `ASKED` on."""
    at = ASKED if setpoints else 0.0
    seen = follow(system, [d.name for d in system.devices], theirs["t"], events, setpoints, asked_at=at)
    pmus = [pmu.name for pmu in system.pmus]
    speeds = [(seen.machines["speed_deviation"][:, g] + 1.0, theirs[f"w{bus}"]) for g, bus in enumerate(("2", "12"))]
    compared = {"speeds": speeds}
    for column in columns:
        channel, scale = list(CHANNELS).index(COLUMNS[column]), 1.0 if column == "V" else RATING
        compared[COLUMNS[column].replace("_", " ")] = [
            (seen.frames[:, pmus.index(pmu), channel] / scale, theirs[f"{column}{bus}"])
            for bus, pmu in INVERTERS.items()
        ]
    rows = []
    for name, pairs in compared.items():
        swing = max(np.ptp(other) for _, other in pairs)
        apart = np.array([ours - other for ours, other in pairs])
        rows.append(within(f"{what}: {name}", "of the range", apart / swing, 0.01))
    return rows
