"""Random noise of all loads of a run."""

from __future__ import annotations

from typing import Any

from pydantic import Field

from facts_damping.fields import Name, ParameterModel, quantity


def _std(default: float | None) -> Any:
    return quantity(
        default, "-", "standard deviation of P and of Q, as a fraction of the power that the load draws", ge=0, le=0.2
    )


def _time_constant(default: float | None) -> Any:
    return quantity(default, "s", "time constant of the noise: its correlation time", ge=0.05, le=1e4)


def _correlation(default: float | None) -> Any:
    return quantity(
        default, "-", "correlation of the noise of P with that of Q; 1: the power factor is constant", ge=-1, le=1
    )


class OwnNoise(ParameterModel):
    """Noise of one load; a field that is not given has the value for all loads."""

    std: float | None = _std(None)
    time_constant: float | None = _time_constant(None)
    correlation: float | None = _correlation(None)


class LoadNoise(ParameterModel):
    """Random noise of all loads: an Ornstein-Uhlenbeck process for P and one for Q of each load.

    Different loads are independent of each other. By default P and Q of a load are independent, too (Milano and
    Zarate-Minano, IEEE Trans. Power Systems 28 (2013) 4537-4544). The defaults are a choice, not measured values.
    """

    std: float = _std(0.01)
    time_constant: float = _time_constant(1.0)
    correlation: float = _correlation(0.0)
    loads: dict[Name, OwnNoise] = Field({}, description="load: its own values, where they differ")

    def of(self, load: str) -> tuple[float, float, float]:
        """Standard deviation, time constant (s) and correlation of a load's noise."""
        noise = self.loads.get(load, OwnNoise())
        values = {**self.model_dump(exclude={"loads"}), **noise.model_dump(exclude_none=True)}
        return values["std"], values["time_constant"], values["correlation"]
