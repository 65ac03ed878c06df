"""Random noise of all loads of a run."""

from __future__ import annotations

from typing import Any

from pydantic import Field

from facts_damping.parameters.base import Name, ParameterModel, quantity


def _std(default: float | None) -> Any:
    return quantity(default, "-", "standard deviation of P and of Q, relative to what the load draws", ge=0, le=0.2)


def _time_constant(default: float | None) -> Any:
    return quantity(default, "s", "time in which the noise forgets what it was", ge=0.05, le=1e4)


def _correlation(default: float | None) -> Any:
    return quantity(default, "-", "of the noise of P with that of Q; 1: the power factor stays", ge=-1, le=1)


class OwnNoise(ParameterModel):
    """Noise of a load where it differs from that of all."""

    std: float | None = _std(None)
    time_constant: float | None = _time_constant(None)
    correlation: float | None = _correlation(None)


class LoadNoise(ParameterModel):
    """What each load draws more or less than it should: an Ornstein-Uhlenbeck process of P and one of Q.

    Loads are independent of each other, and by default P and Q of a load are, too (F. Milano, R. Zarate-Minano, A
    Systematic Method to Model Power Systems as Stochastic Differential Algebraic Equations, IEEE Trans. Power Systems
    28 (2013) 4537-4544).
    """

    std: float = _std(0.01)
    time_constant: float = _time_constant(1.0)
    correlation: float = _correlation(0.0)
    loads: dict[Name, OwnNoise] = Field({}, description="load: its own std, time_constant, correlation")

    def of(self, load: str) -> tuple[float, float, float]:
        """Standard deviation, time constant (s) and correlation of a load's noise."""
        own = self.loads.get(load, OwnNoise()).model_dump()
        std, time, correlation = (
            getattr(self, name) if own[name] is None else own[name] for name in ("std", "time_constant", "correlation")
        )
        return std, time, correlation
