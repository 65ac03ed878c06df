"""A linear controller as a user gives it: matrices, transfer functions, or zeros, poles and gain."""

from __future__ import annotations

from pydantic import Field, model_validator

from facts_damping.fields import ParameterModel, quantity

Row = list[float]
Polynomials = Row | list[list[Row]]  # one, or a row a device, with one a signal
FORMS = (("A", "B", "C", "D"), ("num", "den"), ("zeros", "poles", "gain"))


class LinearLaw(ParameterModel):
    """A linear law u = K(s) y, or K(z), from signals y to setpoints u, both in p.u.

    It has one of three forms: dx/dt = A x + B y, u = C x + D y; or num(s) / den(s); or gain prod(s - zero) / prod(s -
    pole). With `dt` it is discrete: x(k+1) in place of dx/dt, z in place of s.
    """

    A: list[Row] | None = Field(None, description="matrix of shape (states, states)")
    B: list[Row] | None = Field(None, description="matrix of shape (states, signals)")
    C: list[Row] | None = Field(None, description="matrix of shape (devices, states)")
    D: list[Row] | None = Field(None, description="matrix of shape (devices, signals); none: 0")
    num: Polynomials | None = Field(
        None,
        description="numerator, highest power first; for several signals or devices a row per device with an entry per "
        "signal",
    )
    den: Polynomials | None = Field(None, description="denominator, in the same form as `num`")
    zeros: list[float | str] | None = Field(
        None, description="zeros, for one signal and device; complex values as text, such as -1+2j"
    )
    poles: list[float | str] | None = Field(None, description="poles, in the same form as `zeros`")
    gain: float | None = Field(None, description="factor of the zeros and poles")
    dt: float | None = quantity(
        None, "s", "sampling period of a discrete law, that of the frames; none: continuous", gt=0, le=10
    )

    @model_validator(mode="after")
    def _one_form(self) -> LinearLaw:
        fields = [name for form in FORMS for name in form if getattr(self, name) is not None]
        forms = [form for form in FORMS if any(name in fields for name in form)]
        if len(forms) != 1 or (fields != ["D"] and not set(forms[0]) - {"D"} <= set(fields)):
            allowed = "A, B, C (and D), or D alone; or num, den; or zeros, poles, gain"
            raise ValueError(f"{', '.join(fields) or 'nothing'} given; allowed: {allowed}")
        return self
