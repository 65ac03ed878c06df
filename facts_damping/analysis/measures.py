"""Inputs of the evaluation: speed differences, and times of the events."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from facts_damping.errors import InputError
from facts_damping.signals import CHANNELS, NANOSECONDS

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

    from facts_damping.signals import Record

SPEED = list(CHANNELS).index("speed_deviation")


def speed_differences(record: Record) -> dict[str, NDArray[np.float64]]:
    """Local and interarea differences of true rotor speeds: name -> (ticks,), p.u. of synchronous speed.

    `dw = sum_i c_i dw_i` over PMUs i with the weights c of `measure_weights`. Raises InputError if
    they do not fit the record.
    """
    weights = measure_weights(record.configuration)
    if not weights:
        raise InputError("measures: none given; allowed: speed differences, or PMUs at machines")
    speeds = pmu_speeds(record)
    return {name: _weighted(record, speeds, f"measures.{name}", one) for name, one in weights.items()}


def pmu_speeds(record: Record) -> NDArray[np.float64]:
    """Speed at each PMU, (ticks, PMUs), p.u.: the true one of its machine, else as reported; NaN: unknown."""
    found: NDArray[np.float64] = record.frames[:, :, SPEED].copy()
    machines = {s.get("name"): s.get("machine") for s in inline_system(record.configuration).get("pmus") or ()}
    for i, pmu in enumerate(record.pmus):
        if machines.get(pmu) in record.machine_names:
            true = record.machines["speed_deviation"][:, record.machine_names.index(str(machines[pmu]))]
            found[:, i] = np.where(np.isfinite(true), true, found[:, i])
    return found


def measure_weights(configuration: Mapping[str, Any]) -> dict[str, Mapping[str, float]]:
    """Weights of the speed differences by PMU: {name: {PMU: weight}}.

    From `measures` = {"local" | "interarea": {name: {PMU: weight}}}, or from an inline system, whose `measures` =
    {"local" | "interarea": [name]} refer to `signals` = {name: {"weights": ...}}. Default: each machine's speed against
    the first machine's; against synchronous speed if there is an infinite bus.
    """
    source = configuration if "measures" in configuration else inline_system(configuration) or configuration
    signals = source.get("signals") or {}
    found: dict[str, Mapping[str, float]] = {}
    for group in (source.get("measures") or {}).values():
        named = group if isinstance(group, dict) else {name: signals[name]["weights"] for name in group}
        found.update(named)
    return found or _against_the_first(source)


def _against_the_first(system: Mapping[str, Any]) -> dict[str, Mapping[str, float]]:
    """Default speed differences of the PMUs at machines, for a system that names none."""
    pmus = [s["name"] for s in system.get("pmus") or () if isinstance(s, dict) and s.get("machine")]
    if system.get("infinite_buses") or len(pmus) == 1:
        return {name: {name: 1.0} for name in pmus}
    return {f"{pmus[0]}-{name}": {pmus[0]: 1.0, name: -1.0} for name in pmus[1:]}


def setpoint_limits(configuration: Mapping[str, Any]) -> dict[str, float]:
    """Largest setpoint of each device, p.u., from an inline system: {device: `setpoint_max`}."""
    devices = inline_system(configuration).get("devices") or []
    return {one["name"]: float(one["setpoint_max"]) for one in devices if "setpoint_max" in one}


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


def _weighted(
    record: Record, speeds: NDArray[np.float64], field: str, weights: Mapping[str, float]
) -> NDArray[np.float64]:
    total = np.zeros(len(record.time_ns))
    for pmu, weight in weights.items():
        if pmu not in record.pmus:
            raise InputError(f"{field}: no PMU {pmu!r}; allowed: {', '.join(record.pmus)}")
        total += float(weight) * speeds[:, record.pmus.index(pmu)]
    return total
