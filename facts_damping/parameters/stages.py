"""The stages of a link as data: each does one thing to the entries that pass it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Literal

from pydantic import Field, model_validator

from facts_damping.parameters.base import Name, ParameterModel, quantity
from facts_damping.parameters.stations import Channel

LONGEST_S = 60.0  # most that a stage may delay


def _delay(default: Any, description: str) -> Any:
    return quantity(default, "s", description, ge=0, le=LONGEST_S)


def _share(default: Any, description: str) -> Any:
    return quantity(default, "-", description, ge=0, le=1)


class StageModel(ParameterModel):
    """What all stages have: a model, a label, and on which entries they act."""

    if TYPE_CHECKING:
        model: str

    stage: Literal["pmu", "network", "alignment", "computation", "actuator"] = "network"
    channels: list[Name] | None = Field(
        None, min_length=1, description="stations, or signals and so all their stations (up), devices (down); none: all"
    )
    start: float = quantity(0.0, "s", "it acts on what is sent from then on", ge=0, le=1e5)
    duration: float | None = quantity(None, "s", "and for so long; none: to the end", gt=0, le=1e5)


class Constant(StageModel):
    """The same delay for all."""

    model: Literal["constant"] = "constant"
    delay: float = _delay(0.0, "delay")


class Uniform(StageModel):
    """Delays that are equally likely within bounds."""

    model: Literal["uniform"] = "uniform"
    low: float = _delay(..., "shortest delay")
    high: float = _delay(..., "longest delay")

    @model_validator(mode="after")
    def _ordered(self) -> Uniform:
        if self.low > self.high:
            raise ValueError(f"low {self.low:g}, high {self.high:g} given; allowed: low not above high")
        return self


class Normal(StageModel):
    """Delays of a normal distribution, cut off: drawn again outside its bounds."""

    model: Literal["normal"] = "normal"
    mean: float = _delay(..., "mean before cutting off")
    std: float = _delay(..., "standard deviation before cutting off")
    low: float = _delay(0.0, "shortest delay")
    high: float = _delay(LONGEST_S, "longest delay")

    @model_validator(mode="after")
    def _around_the_mean(self) -> Normal:
        if not self.low <= self.mean <= self.high:
            raise ValueError(
                f"low {self.low:g}, mean {self.mean:g}, high {self.high:g} given; allowed: the mean between the bounds"
            )
        return self


class Gamma(StageModel):
    """A shortest delay and what a gamma distribution adds: mean delay + shape scale."""

    model: Literal["gamma"] = "gamma"
    delay: float = _delay(0.0, "shortest delay")
    shape: float = quantity(..., "-", "shape k of what is added", gt=0, le=1e3)
    scale: float = _delay(..., "scale theta of what is added")


class Lognormal(StageModel):
    """A shortest delay and what a lognormal distribution adds: mean delay + median exp(sigma^2 / 2)."""

    model: Literal["lognormal"] = "lognormal"
    delay: float = _delay(0.0, "shortest delay")
    median: float = _delay(..., "median of what is added")
    sigma: float = quantity(..., "-", "standard deviation of its logarithm", ge=0, le=3)


class Trace(StageModel):
    """Measured delays in their order, entry by entry, from the beginning again after the last; none: it was lost."""

    model: Literal["trace"] = "trace"
    file: str | None = Field(None, description="CSV (a column `delay_s`, or one a channel), or a recording")
    delays: list[float | None] | dict[Name, list[float | None]] | None = Field(
        None, description="the delays themselves, s: for all channels, or a list a channel"
    )

    @model_validator(mode="after")
    def _one_source(self) -> Trace:
        if (self.file is None) == (self.delays is None):
            raise ValueError("a trace needs either `file` or `delays`")
        series = list(self.delays.values()) if isinstance(self.delays, dict) else [self.delays or []]
        if self.delays is not None and not all(series):
            raise ValueError("delays: an empty list given; allowed: at least one delay")
        wrong = [one for own in series for one in own if one is not None and not 0.0 <= one <= LONGEST_S]
        if wrong:
            raise ValueError(f"delays: {wrong[0]:g} given; allowed: 0 to {LONGEST_S:g}")
        return self


class Bernoulli(StageModel):
    """Entries lost one by one, each with the same probability."""

    model: Literal["bernoulli"] = "bernoulli"
    loss: float = _share(..., "probability that an entry is lost")


class GilbertElliott(StageModel):
    """Losses in bursts: a channel is good or bad (Gilbert 1960, Elliott 1963); on average a share p_GB / (p_GB + p_BG).

    It starts in the stationary state.
    """

    model: Literal["gilbert_elliott"] = "gilbert_elliott"
    p_GB: float = _share(..., "probability to turn from good to bad at an entry")
    p_BG: float = _share(..., "probability to turn from bad to good")
    loss_G: float = _share(0.0, "probability of loss while good")
    loss_B: float = _share(1.0, "probability of loss while bad")


class Duplicate(StageModel):
    """Entries that arrive twice: from here on a copy goes its own way."""

    model: Literal["duplicate"] = "duplicate"
    probability: float = _share(..., "probability that an entry is copied")


class InOrder(StageModel):
    """No overtaking: an entry leaves after those that were sent before it on its channel."""

    model: Literal["in_order"] = "in_order"


class Wait(StageModel):
    """A data concentrator: the stations' entries of one frame leave together; what comes after the wait is dropped."""

    model: Literal["wait"] = "wait"
    stage: Literal["pmu", "network", "alignment", "computation", "actuator"] = "alignment"
    wait: float = _delay(..., "longest wait")
    reference: Literal["first", "stamp"] = Field("first", description="from the first arrival, or from the time stamp")
    send: Literal["complete", "timeout"] = Field("complete", description="once all are there, or at the wait's end")
    missing: Literal["drop", "hold"] = Field("drop", description="hold: a missing entry is its last one, stamped anew")


class Playout(StageModel):
    """A play-out buffer: entries leave at the given age, so their delay is constant; those that come later at once."""

    model: Literal["playout"] = "playout"
    delay: float = _delay(..., "age, from the measurement")


class _Disturbance(StageModel):
    """Disturbed data."""

    measurement: Channel | None = Field(None, description="of a frame's values; none: all")


class Freeze(_Disturbance):
    """Values stay what they are at the start."""

    model: Literal["freeze"] = "freeze"


class Replay(_Disturbance):
    """Values of the window before the start, again and again."""

    model: Literal["replay"] = "replay"
    window: float = quantity(..., "s", "length of the window", gt=0, le=600)

    @model_validator(mode="after")
    def _has_begun(self) -> Replay:
        if self.start < self.window:
            raise ValueError(f"start: {self.start:g} given; allowed: from {self.window:g} on, the window's length")
        return self


class Bias(_Disturbance):
    """Values and an offset."""

    model: Literal["bias"] = "bias"
    bias: float = quantity(..., "p.u. or rad", "what is added", ge=-1e3, le=1e3)


class Scale(_Disturbance):
    """Values times a factor."""

    model: Literal["scale"] = "scale"
    factor: float = quantity(..., "-", "factor", ge=-1e3, le=1e3)


class Ramp(_Disturbance):
    """Values and an offset that grows from zero at the start."""

    model: Literal["ramp"] = "ramp"
    rate: float = quantity(..., "p.u./s or rad/s", "growth", ge=-1e3, le=1e3)


class Noise(_Disturbance):
    """Values and normal white noise of mean zero: every value of every entry by itself."""

    model: Literal["noise"] = "noise"
    std: float = quantity(..., "p.u. or rad", "standard deviation", ge=0, le=1e3)


class Flip(_Disturbance):
    """Bits that are turned over on the way, one in an entry's values. Where messages are signed, such a one is lost."""

    model: Literal["flip"] = "flip"
    probability: float = _share(..., "probability that a bit of an entry is turned over")


class Spoof(StageModel):
    """Time stamps that are wrong by an offset."""

    model: Literal["spoof"] = "spoof"
    offset: float = quantity(..., "s", "added to the time of measurement", ge=-LONGEST_S, le=LONGEST_S)


# What a stage of a link may be.
STAGES: list[type[StageModel]] = [
    Constant,
    Uniform,
    Normal,
    Gamma,
    Lognormal,
    Trace,
    Bernoulli,
    GilbertElliott,
    Duplicate,
    InOrder,
    Wait,
    Playout,
    Freeze,
    Replay,
    Bias,
    Scale,
    Ramp,
    Noise,
    Flip,
    Spoof,
]
