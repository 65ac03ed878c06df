"""Table of possible faults in a deployment: what each changes in a run, with random parameters."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

    from facts_damping.case.model import Case

UNITS = {"frequency": 60.0, "active_power": 50.0}  # equivalent of 1 p.u. of speed: Hz, p.u. of power


@dataclass
class Numbers:
    """Given numbers from 0 to 1 in place of a random generator: each choice takes the next one."""

    values: Sequence[float]
    taken: int = 0

    def random(self) -> float:
        """The next number."""
        self.taken += 1
        return float(self.values[self.taken - 1])

    def integers(self, high: int) -> int:
        """A whole number from 0 to below `high`."""
        return min(int(high * self.random()), high - 1)

    def uniform(self, low: float, high: float) -> float:
        """A number between bounds."""
        return low + (high - low) * self.random()

    def choice(self, names: Sequence[str], p: NDArray[np.float64]) -> str:
        """One of several names with probabilities `p`."""
        return names[min(int(np.searchsorted(np.cumsum(p), self.random(), side="right")), len(names) - 1)]


Source = np.random.Generator | Numbers


@dataclass(frozen=True)
class Chance:
    """Random numbers for a draw, start and duration of the fault (None: to the end), and the base run."""

    random: Source
    start: float  # s
    duration: float | None  # s
    case: Case

    def between(self, low: float, high: float) -> float:
        """A log-uniform random number."""
        return round(float(low * (high / low) ** self.random.random()), 9)

    def one_of(self, choices: Sequence[Any]) -> Any:
        """One of several choices with equal probability."""
        return choices[int(self.random.integers(len(choices)))]

    @property
    def span(self) -> dict[str, Any]:
        """Start and duration in the form used by stages, bad data and faults."""
        return {"start": self.start, "duration": self.duration}

    @property
    def channel(self) -> str:
        """Channel of the controller's first signal."""
        return self.case.system.signals[self.case.controllers[0].signals[0]].channel

    @property
    def limit(self) -> float:
        """Limit of the controller's first device, p.u."""
        return float(self.case.system.device(self.case.controllers[0].devices[0]).setpoint_max)

    def pmu(self) -> str:
        """One of the PMUs used by the controller's signals."""
        signals = [self.case.system.signals[name] for name in self.case.controllers[0].signals]
        return str(self.one_of(sorted({name for signal in signals for name in signal.weights})))


Change = dict[str, Any]  # path in the run: value
Drawn = Any  # a value, or a function that draws it from a `Chance`


class Fault(NamedTuple):
    """A fault: its group, whether control is wrong while it lasts, its description, its random changes."""

    group: str  # path, PMU, controller, supervisor or none
    wrong: bool
    description: str
    draw: Callable[[Chance], Change]
    real: str = ""  # method for real graphs, instead of the random changes (fault_injection.py)
    mild: float = 0.0  # number from 0 to 1 that gives the mildest size


def _between(low: float, high: float) -> Callable[[Chance], float]:
    return lambda chance: chance.between(low, high)


def _either(low: float, high: float) -> Callable[[Chance], float]:
    return lambda chance: float(chance.one_of((-1.0, 1.0))) * chance.between(low, high)


def _of_channel(size: Callable[[Chance], float]) -> Callable[[Chance], float]:
    """A random size in the unit of the controller's signal; `size`: p.u. of speed."""
    return lambda chance: size(chance) * UNITS.get(chance.channel, 1.0)


def _of_limit(size: Callable[[Chance], float]) -> Callable[[Chance], float]:
    return lambda chance: size(chance) * chance.limit


def _before(chance: Chance) -> float:
    """A window of 1 to 2 s, s, at most the time before the fault."""
    return round(min(chance.between(1.0, 2.0), chance.start), 9)


def _channel(chance: Chance) -> str:
    return chance.channel


def _pmu(chance: Chance) -> list[str]:
    return [chance.pmu()]


def _made(fields: dict[str, Drawn], chance: Chance) -> dict[str, Any]:
    return {name: value(chance) if callable(value) else value for name, value in fields.items()}


def _path(way: str, *stages: dict[str, Drawn]) -> Callable[[Chance], Change]:
    """Append stages to one way of a link, or to both."""

    def draw(chance: Chance) -> Change:
        link = chance.case.link.model_dump()
        for direction in ("up", "down") if way == "both" else (way,):
            link[direction] = [*link[direction], *(chance.span | _made(stage, chance) for stage in stages)]
        return {"link": link}

    return draw


def _one_path(way: str, *stages: dict[str, Drawn]) -> Callable[[Chance], Change]:
    return lambda chance: _path(way, chance.one_of(stages))(chance)


def _bad_data(**fields: Drawn) -> Callable[[Chance], Change]:
    return lambda chance: {"measurement.bad_data": [_made({"pmus": _pmu, **fields}, chance) | chance.span]}


def _clock(**fields: Drawn) -> Callable[[Chance], Change]:
    return lambda chance: {f"measurement.pmus.{chance.pmu()}": {"clock": _made(fields, chance)}}


def _controller(**fields: Drawn) -> Callable[[Chance], Change]:
    return lambda chance: {"controllers.0.faults": [_made(fields, chance) | chance.span]}


def _supervisor(kind: str) -> Callable[[Chance], Change]:
    return lambda chance: {"supervision.fault": {"kind": kind, **chance.span}}


def _nothing(_chance: Chance) -> Change:
    return {}


_LATE = {"model": "constant", "delay": _between(0.02, 1.5)}
_CUT = {"model": "bernoulli", "loss": 1.0}
_FLIP = {"model": "flip", "probability": _between(0.001, 0.2)}
_ONE = {"measurement": _channel, "channels": _pmu}

NOTHING = "none"  # name of the case without a fault

FAULTS = {
    NOTHING: Fault("none", False, "nothing fails", _nothing),
    # On the way.
    "lost": Fault("path", False, "5 to 70 % of the frames are lost, independently",
                  _path("up", {"model": "bernoulli", "loss": _between(0.05, 0.7)})),
    "bursts": Fault("path", False, "frames are lost in bursts of 5 to 50",
                    _path("up", {"model": "gilbert_elliott", "p_GB": 0.02, "p_BG": _between(0.02, 0.2)}), mild=1.0),
    "cut_up": Fault("path", False, "no frame arrives", _path("up", _CUT)),
    "cut_down": Fault("path", False, "no setpoint arrives", _path("down", _CUT)),
    "cut_both": Fault("path", False, "no frame and no setpoint arrives", _path("both", _CUT), "kill wan_link"),
    "delayed": Fault("path", True, "frames are late by 20 ms to 1.5 s more", _path("up", _LATE)),
    "one_late": Fault("path", True, "one PMU's frames are late by 20 ms to 1.5 s more",
                      _path("up", {**_LATE, "channels": _pmu})),
    "delayed_down": Fault("path", True, "setpoints are late by 20 ms to 1.5 s more", _path("down", _LATE)),
    "reordered": Fault("path", True, "each frame is late by up to 20 to 500 ms; frames overtake each other",
                       _path("up", {"model": "uniform", "low": 0.0, "high": _between(0.02, 0.5)})),
    "repeated": Fault("path", False, "frames arrive twice, each copy up to 300 ms late",
                      _path("up", {"model": "duplicate", "probability": 1.0},
                            {"model": "uniform", "low": 0.0, "high": 0.3})),
    "flipped_up": Fault("path", True, "one bit is flipped in 0.1 to 20 % of the frames", _path("up", _FLIP)),
    "flipped_down": Fault("path", True, "one bit is flipped in 0.1 to 20 % of the setpoints", _path("down", _FLIP)),
    "replayed": Fault("path", True, "frames repeat up to 2 s of earlier values",
                      _path("up", {"model": "replay", "window": _before})),
    "frozen": Fault("path", True, "frames keep the values of its start", _path("up", {"model": "freeze"})),
    "biased": Fault("path", True, "one PMU's values have an offset, speed of 12 uHz to 1.2 Hz",
                    _path("up", {"model": "bias", "bias": _of_channel(_either(2e-7, 0.02)), **_ONE})),
    "ramped": Fault("path", True, "one PMU's values drift, speed by 60 uHz/s to 0.12 Hz/s",
                    _path("up", {"model": "ramp", "rate": _of_channel(_either(1e-6, 2e-3)), **_ONE})),
    "sign_swapped": Fault("path", True, "measurements of the signal have the wrong sign",
                          _path("up", {"model": "scale", "factor": -1.0, "measurement": _channel})),
    "scaled": Fault("path", True, "one PMU's values are multiplied by 0.1 to 10",
                    _path("up", {"model": "scale", "factor": _between(0.1, 10.0), **_ONE}), mild=0.5),
    "noisy": Fault("path", True, "measurements of the signal are noisy, speed by 1 mHz to 0.2 Hz",
                   _path("up", {"model": "noise", "std": _of_channel(_between(1.7e-5, 3e-3)),
                                "measurement": _channel})),
    "spoofed": Fault("path", True, "stamps of frames are wrong by 10 ms to 5 s",
                     _path("up", {"model": "spoof", "offset": _either(0.01, 5.0)})),
    "wrong_sign_behind": Fault("path", True, "setpoints have the wrong sign behind the supervisor",
                               _path("down", {"model": "scale", "factor": -1.0})),
    "tampered": Fault("path", True, "setpoints are changed with a valid key: sign, offset, noise or freeze",
                      _one_path("down", {"model": "scale", "factor": -1.0}, {"model": "freeze"},
                                {"model": "bias", "bias": _of_limit(_either(0.05, 1.0))},
                                {"model": "noise", "std": _of_limit(_between(0.05, 0.5))})),
    # At a PMU:
    "stuck": Fault("pmu", True, "a PMU repeats its values", _bad_data(kind="stuck")),
    "spikes": Fault("pmu", True, "5 % of a PMU's values are 1.5 times as large",
                    _bad_data(kind="spike", probability=0.05)),
    "wrong_ct": Fault("pmu", False, "a current transformer is reversed", _bad_data(kind="wrong_sign")),
    "swapped_phases": Fault("pmu", True, "two phases of a voltage are swapped", _bad_data(kind="swapped_phases")),
    "invalid": Fault("pmu", False, "a PMU marks its data as invalid", _bad_data(kind="invalid")),
    "clock_drift": Fault("pmu", True, "a PMU's clock drifts by 10 us/s to 1 ms/s",
                         _clock(lost=lambda chance: chance.start, drift=_either(1e-5, 1e-3))),
    "clock_offset": Fault("pmu", True, "a PMU's clock is wrong by 10 us to 0.5 s from the beginning",
                          _clock(offset=_either(1e-5, 0.5))),
    # In the controller and the supervisor:
    "wrong_sign": Fault("controller", True, "its setpoints have the wrong sign in the controller",
                        _controller(kind="wrong_sign")),
    "gain": Fault("controller", True, "its setpoints are 2 to 50 times as large",
                  _controller(kind="gain", size=_between(2.0, 50.0))),
    "output_stuck": Fault("controller", True, "its setpoints stay constant", _controller(kind="stuck")),
    "random": Fault("controller", True, "its setpoints are random", _controller(kind="random")),
    "bang_bang": Fault("controller", True, "its setpoints switch between the limits", _controller(kind="bang_bang")),
    "nan": Fault("controller", True, "its setpoints are not numbers", _controller(kind="nan")),
    "weights": Fault("controller", True, "its parameters change by normal noise times 0.1 to 10",
                     _controller(kind="weights", size=_between(0.1, 10.0))),
    "hung": Fault("controller", False, "it hangs for a while", _controller(kind="hung"), "stop controller"),
    "dead": Fault("controller", False, "it dies and is restarted", _controller(kind="dead"), "kill controller"),
    "supervisor_hung": Fault("supervisor", False, "it hangs for a while", _supervisor("hung"), "stop supervisor"),
    "supervisor_dead": Fault("supervisor", False, "it dies and is restarted", _supervisor("dead"),
                             "kill supervisor"),
    # From another participant in the ROS domain: refused before the simulated part, so only applied to real graphs.
    "forged": Fault("path", False, "another node forges messages", _nothing, "forge"),
    "forged_with_key": Fault("path", False, "the same, signed with the graph's key", _nothing, "forge signed"),
}  # fmt: skip
ONLY_REAL = tuple(name for name, row in FAULTS.items() if row.real.startswith("forge"))
