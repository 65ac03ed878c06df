"""Export of the linearised plant: as NPZ for python-control, slycot or MATLAB, and as `control.StateSpace`.

It is the continuous plant seen by a controller, in deviations from the start: from setpoints (p.u., references of the
devices) to signals after their washouts (s T / (1 + s T), a state each). It excludes frames and hold, links, device
dead times (`dead_time_s`), PMU filters, and limits.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from facts_damping.extras import library
from facts_damping.output.writing import replacing
from facts_damping.small_signal.residues import with_washouts

if TYPE_CHECKING:
    from pathlib import Path

    from facts_damping.compiling.structs import Float1, Float2
    from facts_damping.small_signal.modal_tables import Modal


class LinearPlant(NamedTuple):
    """dx = A x + B u, y = C x + D u."""

    A: Float2  # (states, states), 1/s
    B: Float2  # (states, devices)
    C: Float2  # (signals, states)
    D: Float2  # (signals, devices)
    states: list[str]
    devices: list[str]  # u, p.u.
    signals: list[str]  # y, p.u.
    x_0: Float1  # (states,), operating point of the linearisation; 0 for washouts
    dead_time_s: Float1  # (devices,)


def of(modal: Modal) -> LinearPlant:
    """The plant of an analysis, including its signals' washouts."""
    model, names = modal.model, list(modal.system.signals)
    washed = [f"{name}.washout" for name, tau in zip(names, model.washout, strict=True) if tau > 0.0]
    return LinearPlant(
        *with_washouts(model, range(len(names))),
        [*modal.built.state_names, *washed],
        list(modal.devices),
        names,
        np.concatenate([modal.built.state.x, np.zeros(len(washed))]),
        np.broadcast_to(np.asarray(model.dead_time, np.float64), len(modal.devices)).copy(),
    )


def save(plant: LinearPlant, path: Path) -> None:
    """Write a plant as NPZ, with arrays named as the fields of `LinearPlant`."""
    arrays: dict[str, Any] = {name: np.array(value) for name, value in plant._asdict().items()}
    with replacing(path) as beside, beside.open("wb") as file:
        np.savez(file, **arrays)


def state_space(plant: LinearPlant) -> Any:
    """A plant as `control.StateSpace` of python-control. Raises `InputError` if that is not installed."""
    labels = {"states": plant.states, "inputs": plant.devices, "outputs": plant.signals}
    return library("control", "control", "python-control").StateSpace(plant.A, plant.B, plant.C, plant.D, **labels)
