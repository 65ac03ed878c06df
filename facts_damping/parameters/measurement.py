"""How PMUs measure, as data: their filters and their errors."""

from __future__ import annotations

from typing import Literal

from pydantic import Field, model_validator

from facts_damping.fields import Name, ParameterModel, quantity


class Noise(ParameterModel):
    """Noise of the reported values, normal and white, added after the filters: standard deviations."""

    magnitude: float = quantity(0.0, "p.u.", "noise of magnitudes, relative to the magnitude", ge=0, le=1)
    angle: float = quantity(0.0, "rad", "noise of angles", ge=0, le=3)
    frequency: float = quantity(
        0.0, "Hz", "noise of the frequency, and of the rotor speed if that is reported", ge=0, le=5
    )
    rocof: float = quantity(0.0, "Hz/s", "noise of the rate of change of frequency", ge=0, le=100)


class Clock(ParameterModel):
    """The error of a PMU's clock: a constant offset, and a drift after the clock has lost the satellites.

    The error shifts the time stamps of the PMU's frames, and their angles by -2 pi f_0 times the error.
    """

    offset: float = quantity(0.0, "s", "how far the clock is ahead of UTC", ge=-1, le=1)
    lost: float | None = quantity(None, "s", "time at which the clock loses the satellites; none: never", ge=0, le=1e5)
    drift: float = quantity(0.0, "s/s", "rate at which the clock gains time from then on", ge=-1e-3, le=1e-3)

    @model_validator(mode="after")
    def _drifts_alone(self) -> Clock:
        if self.drift != 0.0 and self.lost is None:
            allowed = "0, as a clock in time does not drift"
            raise ValueError(f"drift: {self.drift:g} given without `lost`; allowed: {allowed}")
        return self


class PmuErrors(ParameterModel):
    """Errors of one PMU, in place of those of all PMUs."""

    noise: Noise | None = Field(None, description="noise of this PMU; none: that of all PMUs")
    clock: Clock | None = Field(None, description="clock of this PMU; none: that of all PMUs")


class BadData(ParameterModel):
    """Wrong frames of some PMUs for some time.

    `stuck`: values stay as they are at the start. `spike`: in some frames magnitudes, speed and ROCOF (the rate of
    change of frequency) are larger by the fraction `size`. `wrong_sign`: a current transformer is connected the wrong
    way round. `swapped_phases`: two phases of the voltage are exchanged, so that a balanced voltage has no positive
    sequence. `invalid`: frames are marked as data error and have no values.
    """

    kind: Literal["stuck", "spike", "wrong_sign", "swapped_phases", "invalid"] = Field(
        ..., description="what is wrong with the frames"
    )
    pmus: list[Name] | None = Field(None, min_length=1, description="PMUs concerned; none: all")
    start: float = quantity(0.0, "s", "time of measurement of the first wrong frame", ge=0, le=1e5)
    duration: float | None = quantity(None, "s", "how long frames are wrong; none: to the end", gt=0, le=1e5)
    probability: float = quantity(0.01, "-", "fraction of the frames that are wrong; for `spike` only", ge=0, le=1)
    size: float = quantity(0.5, "-", "fraction by which values are larger; for `spike` only", ge=-10, le=10)

    @model_validator(mode="after")
    def _of_spikes(self) -> BadData:
        fields = self.model_fields_set & {"probability", "size"}
        if self.kind != "spike" and any(getattr(self, n) != type(self).model_fields[n].default for n in fields):
            raise ValueError(f"{', '.join(sorted(fields))}: given for {self.kind}; allowed: for spike only")
        return self


class Measurement(ParameterModel):
    """How the PMUs of a run [measure](measurement.md); by default rotor speeds and exact phasors, without latency."""

    description: str = Field("", description="text that `facts-damping list measurement` shows")
    filter: Literal["ideal", "p_class", "m_class"] = Field(
        "ideal", description="none (`ideal`), or the reference filter of class P or M of IEEE/IEC 60255-118-1, annex D"
    )
    noise: Noise = Field(Noise(), description="noise of all PMUs")
    clock: Clock = Field(Clock(), description="error of the clocks of all PMUs")
    quantisation: Literal["none", "int16"] = Field(
        "none", description="`int16`: the 16-bit integers of IEEE C37.118.2, polar, 0.1 mrad, 1 mHz, 0.01 Hz/s"
    )
    voltage_range: float = quantity(2.0, "p.u.", "largest voltage that 16 bits can express", gt=0, le=100)
    current_range: float = quantity(40.0, "p.u.", "largest current that 16 bits can express", gt=0, le=1e4)
    pmus: dict[Name, PmuErrors] = Field({}, description="PMU: its own noise and clock")
    bad_data: list[BadData] = Field([], description="wrong frames, one entry for each time and kind")
