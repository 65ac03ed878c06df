"""The stages of a link as data: each does one thing to the entries that pass it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Literal

from pydantic import Field, model_validator

from facts_damping.extensions import rows
from facts_damping.fields import Name, ParameterModel, quantity
from facts_damping.parameters.plant.pmus import Channel

LONGEST_S = 60.0  # most that a stage may delay


def _delay(default: Any, description: str) -> Any:
    return quantity(default, "s", description, ge=0, le=LONGEST_S)


def _fraction(default: Any, description: str) -> Any:
    return quantity(default, "-", description, ge=0, le=1)


def _model(name: str) -> Any:
    return Field(name, description="model of the stage")


def _label(default: str) -> Any:
    return Field(default, description="label: the part of the path that the stage stands for")


class StageModel(ParameterModel):
    """A stage of a link: its label, and the entries on which it acts. The sections that follow have its kinds."""

    if TYPE_CHECKING:
        model: str

    stage: Literal["pmu", "network", "alignment", "computation", "actuator"] = _label("network")
    channels: list[Name] | None = Field(
        None,
        min_length=1,
        description="PMUs, or signals with all their PMUs (up), or devices (down), on which it acts; none: all",
    )
    start: float = quantity(0.0, "s", "it acts on what is sent from this time on", ge=0, le=1e5)
    duration: float | None = quantity(None, "s", "how long it acts; none: to the end", gt=0, le=1e5)


class Constant(StageModel):
    """The same delay for every entry.

    If the PMUs have a filter of their own, constant stages labelled `pmu` delay nothing: they stand for that filter.
    """

    model: Literal["constant"] = _model("constant")
    delay: float = _delay(0.0, "delay")


class Uniform(StageModel):
    """Delays with a uniform distribution; `low` must not be above `high`."""

    model: Literal["uniform"] = _model("uniform")
    low: float = _delay(..., "shortest delay")
    high: float = _delay(..., "longest delay")

    @model_validator(mode="after")
    def _ordered(self) -> Uniform:
        if self.low > self.high:
            raise ValueError(f"low {self.low:g}, high {self.high:g} given; allowed: low not above high")
        return self


class Normal(StageModel):
    """Delays with a normal distribution, drawn again outside the bounds; the mean must lie between them."""

    model: Literal["normal"] = _model("normal")
    mean: float = _delay(..., "mean of the distribution before it is cut off")
    std: float = _delay(..., "standard deviation of the distribution before it is cut off")
    low: float = _delay(0.0, "shortest delay")
    high: float = _delay(LONGEST_S, "longest delay")

    @model_validator(mode="after")
    def _around_the_mean(self) -> Normal:
        if not self.low <= self.mean <= self.high:
            bounds = f"low {self.low:g}, mean {self.mean:g}, high {self.high:g} given"
            raise ValueError(f"{bounds}; allowed: the mean between the bounds")
        return self


class Gamma(StageModel):
    """A shortest delay plus a gamma distribution; the mean is delay + shape scale."""

    model: Literal["gamma"] = _model("gamma")
    delay: float = _delay(0.0, "shortest delay")
    shape: float = quantity(..., "-", "shape k of the gamma distribution", gt=0, le=1e3)
    scale: float = _delay(..., "scale theta of the gamma distribution")


class Lognormal(StageModel):
    """A shortest delay plus a lognormal distribution; the mean is delay + median exp(sigma^2 / 2)."""

    model: Literal["lognormal"] = _model("lognormal")
    delay: float = _delay(0.0, "shortest delay")
    median: float = _delay(..., "median of the lognormal distribution")
    sigma: float = quantity(..., "-", "standard deviation of the logarithm", ge=0, le=3)


class Trace(StageModel):
    """Measured delays, entry by entry in their order; after the last one the trace begins again.

    Give either `file` or `delays`.
    """

    model: Literal["trace"] = _model("trace")
    file: str | None = Field(
        None, description="CSV file with a column `delay_s`, or with one column per channel; or a recording"
    )
    delays: list[float | None] | dict[Name, list[float | None]] | None = Field(
        None, description="delays in s, one list for all channels or one per channel; `null` is a lost entry"
    )

    @model_validator(mode="after")
    def _one_source(self) -> Trace:
        if (self.file is None) == (self.delays is None):
            raise ValueError("a trace needs either `file` or `delays`")
        series = list(self.delays.values()) if isinstance(self.delays, dict) else [self.delays or []]
        if self.delays is not None and not all(series):
            raise ValueError("delays: an empty list given; allowed: at least one delay")
        wrong = [delay for delays in series for delay in delays if delay is not None and not 0.0 <= delay <= LONGEST_S]
        if wrong:
            raise ValueError(f"delays: {wrong[0]:g} given; allowed: 0 to {LONGEST_S:g}")
        return self


class Bernoulli(StageModel):
    """Independent loss of entries, each with the same probability."""

    model: Literal["bernoulli"] = _model("bernoulli")
    loss: float = _fraction(..., "probability that an entry is lost")


class GilbertElliott(StageModel):
    """Loss in bursts: each channel is in a good or a bad state (Gilbert 1960, Elliott 1963).

    The fraction of the bad state is p_GB / (p_GB + p_BG), also at the start.
    """

    model: Literal["gilbert_elliott"] = _model("gilbert_elliott")
    p_GB: float = _fraction(..., "probability of a change from good to bad at an entry")
    p_BG: float = _fraction(..., "probability of a change from bad to good at an entry")
    loss_G: float = _fraction(0.0, "probability that an entry is lost in the good state")
    loss_B: float = _fraction(1.0, "probability that an entry is lost in the bad state")


class Duplicate(StageModel):
    """Copies of entries, with delays of their own in the following stages."""

    model: Literal["duplicate"] = _model("duplicate")
    probability: float = _fraction(..., "probability that an entry is copied")


class InOrder(StageModel):
    """No overtaking: an entry leaves after those that were sent before it on its channel."""

    model: Literal["in_order"] = _model("in_order")


class Wait(StageModel):
    """A data concentrator: the entries of one frame leave together; entries after the wait are dropped.

    On the way up only.
    """

    model: Literal["wait"] = _model("wait")
    stage: Literal["pmu", "network", "alignment", "computation", "actuator"] = _label("alignment")
    wait: float = _delay(..., "longest wait")
    reference: Literal["first", "stamp"] = Field(
        "first", description="the wait counts from the first arrival of the frame, or from its time stamp"
    )
    send: Literal["complete", "timeout"] = Field(
        "complete", description="when entries leave: once all have arrived, or always at the end of the wait"
    )
    missing: Literal["drop", "hold"] = Field(
        "drop", description="`hold`: a missing entry is replaced by the last one of its PMU, with the new stamp"
    )


class Playout(StageModel):
    """A play-out buffer: entries leave at a fixed age, so their delay is constant; later ones leave at once."""

    model: Literal["playout"] = _model("playout")
    delay: float = _delay(..., "age at which an entry leaves, from the time of measurement")


class Disturbance(StageModel):
    """A stage that disturbs values."""

    measurement: Channel | None = Field(
        None, description="value of a frame that is disturbed, on the way up only; none: all values"
    )


class Freeze(Disturbance):
    """Values stay as they are at `start`."""

    model: Literal["freeze"] = _model("freeze")


class Replay(Disturbance):
    """Values of the time before `start` are repeated, again and again."""

    model: Literal["replay"] = _model("replay")
    window: float = quantity(..., "s", "length of the time that is repeated, at most `start`", gt=0, le=600)

    @model_validator(mode="after")
    def _has_begun(self) -> Replay:
        if self.start < self.window:
            raise ValueError(f"start: {self.start:g} given; allowed: from {self.window:g} on, the window's length")
        return self


class Bias(Disturbance):
    """An offset is added to values."""

    model: Literal["bias"] = _model("bias")
    bias: float = quantity(..., "p.u. or rad", "offset that is added", ge=-1e3, le=1e3)


class Scale(Disturbance):
    """Values are multiplied by a factor."""

    model: Literal["scale"] = _model("scale")
    factor: float = quantity(..., "-", "factor by which values are multiplied", ge=-1e3, le=1e3)


class Ramp(Disturbance):
    """An offset that grows from zero at `start` is added to values."""

    model: Literal["ramp"] = _model("ramp")
    rate: float = quantity(..., "p.u./s or rad/s", "rate at which the offset grows", ge=-1e3, le=1e3)


class Noise(Disturbance):
    """Normal white noise of mean zero is added, drawn for each value of each entry."""

    model: Literal["noise"] = _model("noise")
    std: float = quantity(..., "p.u. or rad", "standard deviation of the noise", ge=0, le=1e3)


class Flip(Disturbance):
    """One bit of a value of an entry is inverted; with [signed messages](operate.md) such an entry is lost."""

    model: Literal["flip"] = _model("flip")
    probability: float = _fraction(..., "probability that a bit of an entry is inverted")


class Spoof(StageModel):
    """Time stamps are wrong by an offset."""

    model: Literal["spoof"] = _model("spoof")
    offset: float = quantity(..., "s", "offset that is added to the time of measurement", ge=-LONGEST_S, le=LONGEST_S)


# What a stage of a link may be.
STAGES: list[type[StageModel]] = [
    *(Constant, Uniform, Normal, Gamma, Lognormal, Trace, Bernoulli, GilbertElliott, Duplicate, InOrder, Wait, Playout),
    *(Freeze, Replay, Bias, Scale, Ramp, Noise, Flip, Spoof),
    *rows("stages", StageModel).values(),
]
