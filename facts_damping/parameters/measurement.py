"""How PMUs measure, as data: their filters, and what is wrong with what they say."""

from __future__ import annotations

from typing import Literal

from pydantic import Field, model_validator

from facts_damping.parameters.base import Name, ParameterModel, quantity


class Noise(ParameterModel):
    """Normal white noise of what is reported, after the filters: standard deviations."""

    magnitude: float = quantity(0.0, "p.u.", "of magnitudes, relative to them", ge=0, le=1)
    angle: float = quantity(0.0, "rad", "of angles", ge=0, le=3)
    frequency: float = quantity(
        0.0, "Hz", "of the frequency, and of the rotor speed where that is reported", ge=0, le=5
    )
    rocof: float = quantity(0.0, "Hz/s", "of the rate of change of frequency", ge=0, le=100)


class Clock(ParameterModel):
    """Error of a station's clock: ahead of UTC by `offset`, and by `drift` more and more once it has lost the time.

    The stamp of a frame is wrong by it, and so are its angles: by -2 pi f_0 times the error.
    """

    offset: float = quantity(0.0, "s", "how far it is ahead, always", ge=-1, le=1)
    lost: float | None = quantity(None, "s", "when it loses the time of the satellites; none: never", ge=0, le=1e5)
    drift: float = quantity(0.0, "s/s", "how fast it runs ahead from then on", ge=-1e-3, le=1e-3)

    @model_validator(mode="after")
    def _drifts_alone(self) -> Clock:
        if self.drift != 0.0 and self.lost is None:
            raise ValueError(
                f"drift: {self.drift:g} given without `lost`; allowed: 0, as a clock in time does not drift"
            )
        return self


class StationErrors(ParameterModel):
    """What is wrong at one station, where it is not what is wrong at all."""

    noise: Noise | None = Field(None, description="none: that of all stations")
    clock: Clock | None = Field(None, description="none: that of all stations")


class BadData(ParameterModel):
    """Wrong frames of some stations for a time.

    stuck: values stay what they are at the start; spike: now and then magnitudes, speed and ROCOF are larger by a
    share; wrong_sign: a current transformer the wrong way round; swapped_phases: two phases of the voltage exchanged,
    so that the positive sequence of a balanced voltage is gone; invalid: marked as data error, without values.
    """

    kind: Literal["stuck", "spike", "wrong_sign", "swapped_phases", "invalid"]
    stations: list[Name] | None = Field(None, min_length=1, description="none: all")
    start: float = quantity(0.0, "s", "first time of measurement concerned", ge=0, le=1e5)
    duration: float | None = quantity(None, "s", "for so long; none: to the end", gt=0, le=1e5)
    probability: float = quantity(0.01, "-", "share of frames (spike)", ge=0, le=1)
    size: float = quantity(0.5, "-", "how much larger, relative (spike)", ge=-10, le=10)

    @model_validator(mode="after")
    def _of_spikes(self) -> BadData:
        given = self.model_fields_set & {"probability", "size"}
        if self.kind != "spike" and any(getattr(self, n) != type(self).model_fields[n].default for n in given):
            raise ValueError(f"{', '.join(sorted(given))}: given for {self.kind}; allowed: for spike only")
        return self


class Measurement(ParameterModel):
    """How the PMUs of a run measure; the default is the thesis's: rotor speeds and exact phasors, at once."""

    description: str = ""
    filter: Literal["ideal", "p_class", "m_class"] = Field(
        "ideal", description="ideal: exact; p_class, m_class: the reference filters of IEEE/IEC 60255-118-1, annex D"
    )
    noise: Noise = Noise()
    clock: Clock = Clock()
    quantisation: Literal["none", "int16"] = Field(
        "none", description="int16: 16-bit integers of IEEE C37.118.2, polar, 0.1 mrad, 1 mHz, 0.01 Hz/s"
    )
    voltage_range: float = quantity(2.0, "p.u.", "largest voltage of 16 bits", gt=0, le=100)
    current_range: float = quantity(40.0, "p.u.", "largest current of 16 bits", gt=0, le=1e4)
    stations: dict[Name, StationErrors] = Field({}, description="station: what differs there")
    bad_data: list[BadData] = []
