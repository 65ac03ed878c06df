"""Inputs of the evaluation: speed differences, times of the events, and any signal by its name."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from facts_damping.errors import InputError
from facts_damping.signals import CHANNELS, NANOSECONDS

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

    from facts_damping.record import Record

SPEED, FREQUENCY = (list(CHANNELS).index(name) for name in ("speed_deviation", "frequency"))
# Units of columns that may be analysed, as shown in pictures.
UNITS = {"pu": "p.u.", "rad": "rad", "hz": "Hz", "hz_per_s": "Hz/s", "s": "s", "pu/pu": "p.u./p.u."}


def speed_differences(record: Record) -> dict[str, NDArray[np.float64]]:
    """Local and interarea differences of true rotor speeds: name -> (ticks,), p.u. of synchronous speed.

    `dw = sum_i c_i dw_i` over PMUs i with the weights c of `measure_weights`; where there is no rotor, dw_i is the
    deviation of the frequency that the PMU reports. Raises InputError if they do not fit the record.
    """
    weights = measure_weights(record.configuration)
    if not weights:
        raise InputError("measures: none given; allowed: speed differences, or PMUs at machines or inverters")
    speeds, differences = _with_frequencies(record, pmu_speeds(record)), {}
    for name, parts in weights.items():
        differences[name] = np.zeros(len(record.time_ns))
        for pmu, weight in parts.items():
            if pmu not in record.pmus:
                raise InputError(f"measures.{name}: no PMU {pmu!r}; allowed: {', '.join(record.pmus)}")
            differences[name] += float(weight) * speeds[:, record.pmus.index(pmu)]
    return differences


def _with_frequencies(record: Record, speeds: NDArray[np.float64]) -> NDArray[np.float64]:
    """The speeds, p.u., with the deviation of the frequency that PMUs without a rotor report; gaps are interpolated."""
    nominal, units = float(inline_system(record.configuration).get("frequency", math.nan)), _units_of_pmus(record)
    for i, pmu in enumerate(record.pmus):
        hertz, ticks = record.frames[:, i, FREQUENCY], np.arange(len(speeds))
        known = np.isfinite(hertz)
        if units.get(pmu) not in record.machine_names and known.any() and not np.isfinite(speeds[:, i]).any():
            speeds[:, i] = np.interp(ticks, ticks[known], hertz[known]) / nominal - 1.0
    return speeds


def _units_of_pmus(record: Record) -> dict[Any, Any]:
    """The machine or inverter of each PMU; None: it is at a bus."""
    return {s.get("name"): s.get("machine") for s in inline_system(record.configuration).get("pmus") or ()}


def pmu_speeds(record: Record) -> NDArray[np.float64]:
    """Speed at each PMU, (ticks, PMUs), p.u.: the true one of its machine, else as reported; NaN: unknown."""
    speed: NDArray[np.float64] = record.frames[:, :, SPEED].copy()
    machines = _units_of_pmus(record)
    for i, pmu in enumerate(record.pmus):
        if machines.get(pmu) in record.machine_names:
            true = record.machines["speed_deviation"][:, record.machine_names.index(str(machines[pmu]))]
            speed[:, i] = np.where(np.isfinite(true), true, speed[:, i])
    return speed


def measure_weights(configuration: Mapping[str, Any]) -> dict[str, Mapping[str, float]]:
    """Weights of the speed differences by PMU: {name: {PMU: weight}}.

    From `measures` = {"local" | "interarea": {name: {PMU: weight}}}, or from an inline system, whose `measures` =
    {"local" | "interarea": [name]} refer to `signals` = {name: {"weights": ...}}. Default: each machine's speed against
    the first machine's; against synchronous speed if there is an infinite bus. With fewer than two machines, inverters
    count as well.
    """
    source = configuration if "measures" in configuration else inline_system(configuration) or configuration
    signals = source.get("signals") or {}
    weights: dict[str, Mapping[str, float]] = {}
    for group in (source.get("measures") or {}).values():
        named = group if isinstance(group, dict) else {name: signals[name]["weights"] for name in group}
        weights.update(named)
    return weights or _against_the_first(source)


def _against_the_first(system: Mapping[str, Any]) -> dict[str, Mapping[str, float]]:
    """Default speed differences of the PMUs at machines, for a system that names none."""
    at = {s["name"]: s["machine"] for s in system.get("pmus") or () if isinstance(s, dict) and s.get("machine")}
    inverters = {row["name"] for row in system.get("inverters") or ()}
    pmus = [name for name, unit in at.items() if unit not in inverters]
    pmus = list(at) if len(pmus) < 2 else pmus
    if system.get("infinite_buses") or len(pmus) == 1:
        return {name: {name: 1.0} for name in pmus}
    return {f"{pmus[0]}-{name}": {pmus[0]: 1.0, name: -1.0} for name in pmus[1:]}


def device_limits(configuration: Mapping[str, Any], field: str = "setpoint_max") -> dict[str, float]:
    """A limit of each device that has it, p.u., such as of its setpoint, from an inline system: {device: `field`}."""
    devices = inline_system(configuration).get("devices") or []
    return {device["name"]: float(device[field]) for device in devices if field in device}


def inline_system(configuration: Mapping[str, Any]) -> Mapping[str, Any]:
    """The system if the configuration has it inline; empty if it only names it."""
    system = configuration.get("system")
    return system if isinstance(system, dict) else {}


def exactly_measured(configuration: Mapping[str, Any]) -> bool:
    """Whether PMUs report exactly and without delay: PMUs without filter, noise and other errors."""
    measurement = configuration.get("measurement")
    if not isinstance(measurement, dict):
        return measurement in (None, "ideal")
    errors = [value for key, value in measurement.items() if key in ("noise", "clock") for value in value.values()]
    plain = not any(errors) and not measurement.get("bad_data") and not measurement.get("pmus")
    return plain and measurement.get("filter", "ideal") == "ideal"


def event_times(record: Record) -> list[float]:
    """Times of the events up to the record's end, s, ascending.

    From the events in the record (`time_ns`), which include the clearing of faults; if there are none, from
    `configuration["events"]` (`time`, `duration`, s).
    """
    times = [event.time_ns / NANOSECONDS for event in record.events]
    for event in () if times else record.configuration.get("events") or ():
        times += [event["time"]] + ([event["time"] + event["duration"]] if event.get("duration") else [])
    return sorted(time for time in times if len(record.time_ns) and time <= record.time_s[-1])


def columns(signals: Mapping[str, NDArray[np.float64]]) -> NDArray[np.float64]:
    """Signals as columns: (ticks, n)."""
    return np.column_stack(list(signals.values()))


def recorded(record: Record, name: str) -> tuple[NDArray[np.float64], str]:
    """Values of a signal (ticks,), NaN where unknown, and its unit as shown in pictures, such as `p.u.` or `rad`.

    `name`: a signal of the system, as its PMUs measure it, without washout; or a column of `record.arrays` with a
    unit. Angles are unwrapped. Raises InputError for any other name.
    """
    signals = inline_system(record.configuration).get("signals") or {}
    if name in signals:
        channel = signals[name].get("channel", "speed_deviation")
        column, weights = list(CHANNELS).index(channel), signals[name]["weights"].items()
        values = sum(weight * record.frames[:, record.pmus.index(pmu), column] for pmu, weight in weights)
        unit = CHANNELS[channel]
    elif record.units.get(name) in UNITS and name != "time_s":
        values, unit = record.arrays[name], record.units[name]
    else:
        columns = [column for column, unit in record.units.items() if unit in UNITS and column != "time_s"]
        raise InputError(
            f"signal: '{name}' given; allowed: {', '.join([*sorted(signals), *columns[:1], *columns[-1:]])}, "
            "or any other column of `facts-damping export` that has a unit"
        )
    if unit == "rad":
        values, known = values.copy(), np.isfinite(values)
        values[known] = np.unwrap(values[known])
    return values, UNITS[unit]
