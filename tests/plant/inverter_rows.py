"""Inverters as rows of blocks alone, without a network: a test sets what they measure, and reads what they give."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from pydantic import TypeAdapter

from facts_damping.machine_controls.block_models import MODELS
from facts_damping.parameters.plant.inverters import Inverter, InverterControl
from facts_damping.plant.inverters.start import SIGNALS
from facts_damping.plant.machines import block_controls, block_rest, blocks

if TYPE_CHECKING:
    from numpy.typing import NDArray

RATING = 200.0  # MVA
P, Q, V = 0.8, 0.2, 1.02  # p.u., of the start
OMEGA_0 = 2.0 * np.pi * 60.0
CONVERTERS, CONTROLS = TypeAdapter[Any](Inverter), TypeAdapter[Any](InverterControl)
NAMES = [*SIGNALS.known, *SIGNALS.measured]
# Constants by model, in the order of their records: no two alike where that matters, no limit active.
CONSTANTS = {
    "REGCA1": "0 0.02 1e6 0.9 0.4 1.22 1.2 0.8 0.4 -1.3 0.03 0.7 1e6 -1e6 0.7",
    "REECA1": "0 0 0 0 0 0 0.85 1.15 0.025 0 0 1.5 1.1 -1.0 0 0.15 0 0 0.05 0.9 -0.8 1.2 0.8 0.3 2 0.5 7 0 0.015 "
    "99 -99 1.1 0 1.3 0.04 0 1.3 0 0 0 0 0 0 0 1.3 0 0 0 0 0 0",
    "REECB1": "0 0 0 0 0 0.85 1.15 0.025 0 0 1.5 1.1 -1.0 0 0.05 0.9 -0.8 1.2 0.8 0.3 2 0.5 7 0.015 "
    "99 -99 1.1 0 1.3 0.04",
    "REECD1": "0 0 0 0 0 0 0.85 1.15 0.025 0 0 1.5 1.1 -1.0 0 0.15 0 0 0.05 0.9 -0.8 1.2 0.8 0.3 2 0.5 7 0 0.015 "
    f"99 -99 1.1 0 1.3 0.04 {'0 0 ' * 20} 0.02 0.1 0.035 0.08 0 0.1 1.4 0.05",
    "REPCA1": "0 0 0 0 0 0 0 0.045 3 1.5 0.06 0.12 0 0.02 0.1 0.08 0.2 -0.2 0 0 0.7 -0.7 "
    "0.4 0.6 0.07 0 0 0.5 -0.5 1.2 0 0.11 20 20",
    "WTDTA1": "5 1.5 0.8 1.7 1.2",
    "WTARA1": "0.007 6",
    "WTPTA1": "20 150 12 3 0.8 0.3 27 -5 10 -9",
    "WTTQA1": "0 2.5 0.6 0.05 30 1.2 0.1 0.2 0.58 0.4 0.72 0.6 0.86 0.9 1.01 0",
    "DERA1": "0 0 0 1 0 0 0.025 0.03 -0.02 0.03 5 0 0.035 0.045 20 15 -0.001 0.001 0.4 -0.4 1.1 0 99 -99 "
    "0.055 0.6 4 1.2 0.44 0.49 1.2 1.15 0.16 0.16 0.16 0.16 0.7 59 61 99 99 0.015 1e6 0.02 0.8 1.1 -1.0",
}


def fields(model: str, **changes: float) -> dict[str, float]:
    values = dict(zip(MODELS[model].fields.split(), map(float, CONSTANTS[model].split()), strict=True))
    assert changes.keys() <= values.keys() | {"P", "Q"}
    return values | changes


def converter(model: str = "REGCA1", *, p: float = P, q: float = Q, **changes: float) -> Any:
    row = {"name": "IBR1", "bus": "1", "rating": RATING, "P": p * RATING, "Q": q * RATING, "model": model}
    return CONVERTERS.validate_python(row | fields(model, **changes))


def control(model: str, **changes: float) -> Any:
    row = {"inverter": "IBR1", "model": model}
    return CONTROLS.validate_python(row | fields(model, **changes))


class Rows:
    """The rows of an inverter with its controls, at rest at an operating point, p.u. of its rating."""

    def __init__(self, *models: Any, v: float = V) -> None:
        p, q = models[0].P / RATING, models[0].Q / RATING
        start = {"Vt": v, "Pe": p, "Qe": q, "Vbus": v, "Vcomp": v, "Pbranch": p, "Qbranch": q}
        sensed = start | {f"{name}0": value for name, value in start.items()}
        sensed |= {"Vd": v, "Id": p / v, "Iq": -q / v, "omega_0": OMEGA_0, "speed": 1.0}
        self.control = block_controls.control(*models, signals=SIGNALS)
        self.names = [*NAMES, *self.control.gives]
        references = [name for name in ("Pext", "Qext") if self.uses(name) and name not in self.control.gives]
        wanted = {"Ip": p / v, "Iq_ahead": -q / v}
        self.rest = block_rest.at_rest(self.control, list(models), sensed, wanted, references, SIGNALS)
        self.x, self.values = self.rest.states.copy(), self.rest.signals.copy()
        self.dx = np.zeros_like(self.x)
        self.move()

    def uses(self, name: str) -> bool:
        return any(NAMES.index(name) in row["source"][: row["inputs"]] for row in self.control.rows)

    def move(self, **inputs: float) -> None:
        """Evaluate all signals and derivatives with new inputs."""
        for name, value in inputs.items():
            self.values[NAMES.index(name)] = value
        rows, at = self.control.rows, len(NAMES)
        blocks.outputs(rows, 0, len(rows), at, self.x, self.values)
        blocks.derivatives(rows, 0, len(rows), self.x, self.values, self.dx)

    def __getitem__(self, signal: str) -> float:
        return float(self.values[len(NAMES) + self.control.gives.index(signal)])

    def reference(self, name: str) -> float:
        return float(self.values[NAMES.index(name)])

    def slope(self, state: str) -> float:
        return float(self.dx[self.control.states.index(state)])

    def set(self, state: str, value: float) -> None:
        self.x[self.control.states.index(state)] = value

    def run(self, seconds: float, **inputs: float) -> None:
        """Go on with new inputs, in steps of 0.1 ms."""
        self.move(**inputs)
        for _ in range(round(seconds / 1e-4)):
            self.x += 1e-4 * self.dx
            self.move()

    def response(self, inputs: str, output: str, s: complex) -> complex:
        """From signals that move together to one that it gives, at a complex frequency, by central differences."""
        n, at = len(self.x), [NAMES.index(name) for name in inputs.split("+")]
        start, states = self.values.copy(), self.x.copy()

        def moved(z: NDArray[np.float64]) -> NDArray[np.float64]:
            self.x, self.values = np.ascontiguousarray(z[:n]), start.copy()
            self.values[at] += z[n]
            self.move()
            return np.append(self.dx, self[output])

        z = np.append(states, 0.0)
        slopes = np.array([(moved(z + 1e-6 * e) - moved(z - 1e-6 * e)) / 2e-6 for e in np.eye(n + 1)]).T
        A, B, C, D = slopes[:n, :n], slopes[:n, n], slopes[n, :n], slopes[n, n]
        return complex(C @ np.linalg.solve(s * np.eye(n) - A, B) + D)
