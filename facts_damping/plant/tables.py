"""States and ports of a plant as they are added, one owner after the other."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Sequence

    from facts_damping.compiling.structs import Float1
    from facts_damping.plant.grid.reduction import Place


class States:
    """Values and names of all states in their order in the state vector."""

    def __init__(self) -> None:
        self.values: list[float] = []
        self.names: list[str] = []

    def add(self, owner: str, names: Sequence[str], values: Sequence[float] | Float1) -> None:
        """Add the states of an owner."""
        self.names += [f"{owner}.{name}" for name in names]
        self.values += [float(value) for value in values]

    @property
    def offset(self) -> int:
        """Number of states so far."""
        return len(self.values)


class Ports:
    """Rows of PORT for all ports, and their places."""

    def __init__(self) -> None:
        self.rows: list[tuple[int, int, float, float]] = []
        self.places: list[Place] = []

    def add(self, kind: int, row: int, place: Place, minimum: float = 0.0, maximum: float = math.inf) -> int:
        """Add a port; return its number."""
        self.rows.append((kind, row, minimum, maximum))
        self.places.append(place)
        return len(self.rows) - 1
