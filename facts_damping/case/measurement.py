"""Checks how the PMUs of a run measure, and changes numbers of it during the run."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from facts_damping.measurement.filters import reference_filter
from facts_damping.parameters.field_errors import FieldError, check, check_known
from facts_damping.parameters.files import set_field
from facts_damping.parameters.measurement import Measurement

if TYPE_CHECKING:
    from collections.abc import Iterator

    from facts_damping.case.model import Case

FIXED = ("start", "duration", "lost", "voltage_range", "current_range")  # fields that cannot change during a run


def check_measurement(case: Case) -> None:
    """Check that filters fit the frame rate, that PMUs exist, and that controllers' signals are measured."""
    measurement, pmus = case.measurement, [s.name for s in case.system.pmus]
    for name in measurement.pmus:
        check_known("measurement.pmus", name, pmus)
    for i, bad_data in enumerate(measurement.bad_data):
        for name in bad_data.pmus or []:
            check_known(f"measurement.bad_data.{i}.pmus", name, pmus)
    reference_filter(measurement, case.system.frequency, case.run.frame_rate)
    missing = "rocof" if measurement.filter == "ideal" else "speed_deviation"
    for c, controller in enumerate(case.run.controllers):
        for name in controller.signals:
            signal = case.system.signals.get(name)
            if signal is not None and signal.channel == missing:
                measured = [other for other, row in case.system.signals.items() if row.channel != missing]
                why = f"a signal of {missing}, which PMUs do not report with filter {measurement.filter}"
                allowed = ", ".join(measured) or "none"
                raise FieldError(f"controllers.{c}.signals", f"'{name}' given, {why}; allowed: {allowed}")


def numbers(measurement: Measurement) -> dict[str, float]:
    """Numbers that may change during a run, by path: `noise.angle`, `pmus.G1.clock.offset`."""
    return {path: value for path, value in _floats(measurement.model_dump(), "") if path.split(".")[-1] not in FIXED}


def _floats(content: Any, path: str) -> Iterator[tuple[str, float]]:
    if isinstance(content, float):
        yield path.removesuffix("."), content
    rows = content.items() if isinstance(content, dict) else enumerate(content) if isinstance(content, list) else ()
    for key, value in rows:
        yield from _floats(value, f"{path}{key}.")


def with_number(measurement: Measurement, path: str, value: float) -> Measurement:
    """A copy with one number changed. Raises `InputError` for a value that is not allowed."""
    content = measurement.model_dump()
    set_field(content, path, value, "measurement")
    return check(Measurement, content, "measurement")
