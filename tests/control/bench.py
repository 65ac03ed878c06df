"""What the tests of controllers share: PMUs, signals, devices, and controllers that are given entries."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from facts_damping.control.bank import Known, act, build_bank, settings
from facts_damping.control.inputs import Wiring
from facts_damping.control.neuro_fuzzy import PlantPrior
from facts_damping.control.table import SETTINGS, defaults, kind
from facts_damping.neurofuzzy.table import VARIANTS
from facts_damping.parameters.plant.pmus import Signal
from facts_damping.parameters.run import Controller
from facts_damping.signals import CHANNELS, DELIVERY, NANOSECONDS, SETPOINT

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

MS = 1_000_000
FRAMES = 60  # frames/s
PMUS = ["A", "B", "C"]
SIGNALS = {
    "speed": Signal(channel="speed_deviation", weights={"A": 1.0}),
    "difference": Signal(channel="speed_deviation", weights={"A": 2.0, "B": -1.0}),
    "power": Signal(channel="active_power", weights={"C": 1.0}, deviation=True),
}
LIMITS = {"first": (0.3, 5.0), "second": (0.1, 10.0)}  # p.u., p.u./s
SIGN = -1.0  # of dy/du, all signals and devices
SCALE, CHANGE_SCALE = 0.01, 0.001  # p.u., p.u./frame: defaults of neuro-fuzzy controllers


class Entry(NamedTuple):
    """One PMU entry as a link delivers it; times in ms."""

    pmu: str
    measured: float
    arrival: float
    speed: float = 0.0
    power: float = 0.0


def frame_ns(k: int) -> int:
    """Time of frame k, as a plant has it."""
    return k * NANOSECONDS // FRAMES


def delivery(*entries: Entry) -> NDArray[Any]:
    """The entries of one tick as a table."""
    delivered = np.zeros(len(entries), DELIVERY)
    for row, entry in zip(delivered, entries, strict=True):
        row["pmu"] = PMUS.index(entry.pmu)
        row["measured_ns"], row["arrival_ns"] = round(entry.measured * MS), round(entry.arrival * MS)
        row["values"] = np.nan
        row["values"][list(CHANNELS).index("speed_deviation")] = entry.speed
        row["values"][list(CHANNELS).index("active_power")] = entry.power
    return delivered


def known(signals: int = 1, devices: int = 1, jacobian: NDArray[np.float64] | float = SIGN) -> PlantPrior:
    """A plant whose signals swing alike at 0.6 Hz."""
    many, turn = np.ones((signals, devices)), complex(np.exp(1j * 2 * np.pi * 0.6 / FRAMES))
    return PlantPrior(SIGN * many, jacobian * many, np.ones(signals, np.complex128), turn)


def settings_of(row: Controller) -> NDArray[Any]:
    """A controller's parameters as a record of SETTINGS."""
    return settings(row, np.zeros(1, SETTINGS), np.ones(1))


class Bench:
    """Controllers that are given entries, tick by tick."""

    def __init__(
        self,
        *controllers: Controller,
        signals: Mapping[str, Signal] = SIGNALS,
        limits: Mapping[str, tuple[float, float]] = LIMITS,
        plant: PlantPrior | None = None,
    ) -> None:
        """`plant`: what networks know of it; none: SIGN, and signals that swing alike."""
        plants = [None if c.scheme is None else plant or known(len(c.signals), len(c.devices)) for c in controllers]
        self.bank, self.state = build_bank(
            controllers, Wiring(signals, PMUS, limits, FRAMES), [Known(prior) for prior in plants]
        )
        self.tick = 0

    def give(self, *entries: Entry, controller: int = 0) -> NDArray[Any]:
        """The setpoints that a controller issues on the entries of one tick."""
        out = np.zeros(4 * len(entries) + 2, SETPOINT)
        out["value"][:2] = 77.0
        end = act(self.bank, self.state, controller, self.tick, delivery(*entries), len(entries), out, 1)
        self.tick += 1
        assert out["value"][0] == 77.0  # what others have issued stays
        return out[1:end]

    def frame(self, k: int, speed: float, late_ms: float = 0.0) -> float:
        """The setpoint on frame k of PMU A, which arrives `late_ms` after its measurement."""
        measured = frame_ns(k) / MS
        (setpoint,) = self.give(Entry("A", measured, measured + late_ms, speed))
        return float(setpoint["value"])

    @property
    def theta(self) -> NDArray[np.float64]:
        """Parameters of the first controller's network, now."""
        return np.array(self.state.learner.theta[0])


def controller(
    name: str, scheme: str, profile: str = "deployed", /, **parameters: float | str | list[float]
) -> Controller:
    """A neuro-fuzzy controller of the speed with all of its parameters: those of a profile, but for those given."""
    values = {**defaults(kind(name), profile), **parameters}
    return Controller.model_validate(
        {"name": name, "scheme": scheme, "signals": ["speed"], "devices": ["first"], "parameters": values}
    )


def raw(name: str = "ANFTSC", scheme: str = "direct", /, **parameters: float | str) -> Bench:
    """A controller without guards, but for those given."""
    return Bench(controller(name, scheme, "thesis", **parameters))


def wide(name: str, scheme: str, profile: str = "deployed", /, **parameters: float | str) -> Bench:
    """A controller whose rules cover the range of its inputs: triangles have to be wider than the table's."""
    width = {"width": 5.0} if VARIANTS[name].antecedent == "triangular" else {}
    return Bench(controller(name, scheme, profile, **width, **parameters))


def llc(signal: str = "difference", device: str = "first", **parameters: float | str | list[float]) -> Controller:
    return Controller(signals=[signal], devices=[device], parameters=parameters)
