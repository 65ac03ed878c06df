"""Builds the PMUs of a run from its parameters."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from facts_damping import random_numbers
from facts_damping.measurement import pmu_model
from facts_damping.measurement.filters import reference_filter
from facts_damping.measurement.pmu_model import Pmus, PmuState
from facts_damping.signals import CHANNELS, NEVER, to_ns

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from facts_damping.compiling.structs import Float3
    from facts_damping.parameters.measurement import Clock, Measurement, Noise

KINDS = ("stuck", "spike", "wrong_sign", "swapped_phases", "invalid")  # in order of their codes in `pmu_model`
STREAM = 2  # stream of a run's random numbers; its links use 0 and 1


def wrong_at(measurement: Measurement, pmu: str) -> tuple[Noise, Clock]:
    """Noise and clock of a PMU: its own, else the common ones."""
    errors = measurement.pmus.get(pmu)
    if errors is None:
        return measurement.noise, measurement.clock
    return errors.noise or measurement.noise, errors.clock or measurement.clock


def clocks_differ(measurement: Measurement, pmus: Sequence[str]) -> bool:
    """Whether the entries of a frame may have different time stamps."""
    return len({wrong_at(measurement, name)[1] for name in pmus}) > 1


def _chance(normals: int, uniforms: int, bad: int, pmus: int, seed: int) -> tuple[Float3, Float3]:
    """Random draws of noise, (normals, PMUs, NORMALS), and of spikes, (uniforms, bad, PMUs), per frame."""
    normal, uniform = np.zeros((normals, pmus, pmu_model.NORMALS)), np.zeros((uniforms, bad, pmus))
    for s in range(pmus):
        random = [np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(STREAM, s, i))) for i in range(2)]
        if normals > 1:
            normal[:, s] = random_numbers.standard_normal(random[0], normal[:, s].shape)
        uniform[:, :, s] = random_numbers.random(random[1], uniform[:, :, s].shape)
    return normal, uniform


def _errors(measurement: Measurement, pmus: Sequence[str]) -> NDArray[Any]:
    """A row of ERRORS for each PMU."""
    errors = np.zeros(len(pmus), pmu_model.ERRORS)
    for row, name in zip(errors, pmus, strict=True):
        noise, clock = wrong_at(measurement, name)
        for field in ("magnitude", "angle", "frequency", "rocof"):
            row[field] = getattr(noise, field)
        row["offset"], row["drift"] = clock.offset, clock.drift
        row["lost_ns"] = NEVER if clock.lost is None else to_ns(clock.lost)
    return errors


def _bad_data(measurement: Measurement) -> NDArray[Any]:
    """A row of BAD for each kind of bad data."""
    bad = np.zeros(len(measurement.bad_data), pmu_model.BAD)
    for row, kind in zip(bad, measurement.bad_data, strict=True):
        row["kind"], row["from_ns"] = KINDS.index(kind.kind), to_ns(kind.start)
        row["until_ns"] = NEVER if kind.duration is None else to_ns(kind.start) + to_ns(kind.duration)
        row["probability"], row["size"] = kind.probability, kind.size
    return bad


def make_pmus(
    measurement: Measurement,
    pmus: Sequence[str],
    nominal: float,
    frame_rate: int,
    draws: int,
    seed: int,
    before: Pmus | None = None,
) -> tuple[Pmus, PmuState]:
    """Build the PMUs of a run and their initial state; `draws`: frames after which random numbers repeat.

    Each PMU has its own stream of random numbers; draws of the PMUs `before` are reused. Raises `InputError` for a
    rate without a filter.
    """
    reference = reference_filter(measurement, nominal, frame_rate)
    errors, bad = _errors(measurement, pmus), _bad_data(measurement)
    known = [[bad_data.pmus is None or s in bad_data.pmus for s in pmus] for bad_data in measurement.bad_data]
    channel_mask = np.array(known, np.bool_)
    plain = np.zeros(len(pmus), pmu_model.ERRORS)
    plain["lost_ns"] = NEVER
    integers = measurement.quantisation == "int16"
    exact = not integers and not len(bad) and bool((errors == plain).all())
    if before is not None and len(before.normal) > 1:
        normal, uniform = before.normal, before.uniform
    else:
        spikes = bool((bad["kind"] == pmu_model.SPIKE).any())
        normal, uniform = _chance(1 if exact else draws, draws if spikes else 1, len(bad), len(pmus), seed)
    frozen = Pmus(
        filtered=measurement.filter != "ideal",
        exact=exact,
        p_class=measurement.filter == "p_class",
        nominal=nominal,
        frame_rate=frame_rate,
        weights=reference.weights,
        per_frame=reference.per_frame,
        delay=reference.delay,
        errors=errors,
        bad=bad,
        channel_mask=channel_mask.reshape(len(bad), len(pmus)),
        normal=normal,
        uniform=uniform,
        voltage_step=measurement.voltage_range / pmu_model.MAX_UNSIGNED if integers else 0.0,
        current_step=measurement.current_range / pmu_model.MAX_UNSIGNED if integers else 0.0,
    )
    capacity = reference.delay * reference.per_frame + len(reference.weights) + 1
    state = PmuState(
        np.zeros((len(pmus), 2, 2 * capacity), np.complex128),
        np.zeros(1, np.int64),
        np.zeros((len(bad), len(pmus), len(CHANNELS))),
        np.full((len(bad), len(pmus)), -1, np.int64),
    )
    return frozen, state
