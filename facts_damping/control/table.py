"""The table of controllers: a row a kind, with its parameters as data."""

from __future__ import annotations

from typing import NamedTuple

LEAD_LAG = 0


class Parameter(NamedTuple):
    """A controller's parameter: default, unit, allowed range, meaning."""

    default: float
    unit: str
    low: float
    high: float
    description: str


class Kind(NamedTuple):
    """A row of the table: the code that the compiled step branches on, shapes, parameters, states."""

    code: int
    description: str
    signals: int  # how many it takes
    devices: int  # how many it commands
    states: int
    parameters: dict[str, Parameter]


CONTROLLERS = {
    "LLC": Kind(
        LEAD_LAG,
        "lead-lag: washout and two lead-lag sections (thesis, appendix B)",
        signals=1,
        devices=1,
        states=6,
        parameters={
            "gain": Parameter(10.0, "p.u./p.u.", -1000.0, 1000.0, "gain kG of the washout"),
            "Tw": Parameter(10.0, "s", 0.01, 1000.0, "time constant of the washout"),
            "T1": Parameter(0.0761, "s", 0.0, 100.0, "numerator of the first section"),
            "T2": Parameter(0.3, "s", 0.001, 100.0, "denominator of the first section"),
            "T3": Parameter(0.4272, "s", 0.0, 100.0, "numerator of the second section"),
            "T4": Parameter(0.3, "s", 0.001, 100.0, "denominator of the second section"),
        },
    ),
}
