"""Warnings about a run: limits of the model that it left, and controllers that could not act as intended.

The model has balanced phasors at one frequency, and machines and controls without protection. Beyond these limits
relays would have acted, and the models of loads and converters are not valid.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from facts_damping.analysis.grid_state import islands, states_of
from facts_damping.analysis.measures import exactly_measured, inline_system
from facts_damping.analysis.supervision import cause_text
from facts_damping.machine_controls.block_models import MODELS
from facts_damping.monitor_table import ARMED, STATES
from facts_damping.parameters.files import shipped
from facts_damping.signals import CHANNELS, NANOSECONDS

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from numpy.typing import NDArray

    from facts_damping.analysis.latency import Statistics
    from facts_damping.analysis.supervision import SupervisorHistory
    from facts_damping.record import Record

FREQUENCY = 2.5  # Hz from nominal, at a machine
VOLTAGE = (0.7, 1.2)  # p.u., at machines and PMUs outside of faults
LATE_S = 2.0  # s; a longer mean latency suggests a mistake of units
MOSTLY = 0.5  # fraction of the frames
DRIFT = 0.5  # Hz, change of the machines' common frequency from start to end, without governors or an infinite bus
NEVER_ARMED, NOT_TUNED = "never armed", "is not tuned for"
FORMING = [name for name, row in MODELS.items() if row.source and (row.source.forming or row.source.virtual)]
VOLTAGE_CHANNEL = list(CHANNELS).index("voltage_magnitude")


def limit_warnings(record: Record) -> list[str]:
    """A line for each limit that the run exceeded: what, when and for how long. Empty if it stayed within all.

    Limits: frequency 2.5 Hz from nominal at a machine in service; voltage 0.7 to 1.2 p.u. at a machine or PMU
    outside of faults; no separated part of the network; without governors and infinite bus, a change of the common
    frequency of 0.5 Hz; no forced oscillation up to the end. All but voltage and the last are checked only if
    the configuration has the system inline.
    """
    if not len(record.time_ns):
        return []
    return [*_frequency(record), *_voltage(record), *_islands(record), *_drift(record), *_forced(record)]


def _frequency(record: Record) -> Iterator[str]:
    nominal = inline_system(record.configuration).get("frequency")
    if nominal is None:
        return
    away = np.where(_in_service(record), nominal * record.machines["speed_deviation"], 0.0)
    texts = []
    for name, deviation in zip(record.machine_names, away.T, strict=True):
        beyond = np.abs(deviation) > FREQUENCY
        if beyond.any():
            worst = nominal + deviation[np.nanargmax(np.abs(deviation))]
            texts.append(f"{name} {_when(record, beyond)} ({worst:.2f} Hz)")
    if texts:
        yield f"frequency beyond {nominal:g} ± {FREQUENCY:g} Hz: {', '.join(texts)}"


def _voltage(record: Record) -> Iterator[str]:
    """Voltages beyond the limits outside of faults; at PMUs only if these report exactly and without delay."""
    sound = ~_burning(record)
    service = _in_service(record)
    places = {name: record.machines["terminal_voltage"][:, i] for i, name in enumerate(record.machine_names)}
    reported = exactly_measured(record.configuration)
    pmus = {name: record.frames[:, s, VOLTAGE_CHANNEL] for s, name in enumerate(record.pmus) if reported}
    for word, limit, sign in (("below", VOLTAGE[0], 1.0), ("above", VOLTAGE[1], -1.0)):
        texts = []
        for name, voltage in {**pmus, **places}.items():
            counted = sound & service[:, record.machine_names.index(name)] if name in places else sound
            beyond = counted & (sign * voltage < sign * limit)
            if beyond.any():
                texts.append(f"{name} {_when(record, beyond)} ({sign * (sign * voltage[beyond]).min():.3f} p.u.)")
        if texts:
            yield f"voltage {word} {limit:g} p.u. without a fault: {', '.join(texts)}"


def _islands(record: Record) -> Iterator[str]:
    system, before = inline_system(record.configuration), 0
    for state in states_of(record):
        parts = islands(system, state.lines_out)
        if before and len(parts) > before:
            buses = "; ".join(", ".join(part) for part in parts[1:])
            yield f"the grid has split at {state.time_ns / NANOSECONDS:g} s; apart from the rest: buses {buses}"
        before = len(parts)


def _drift(record: Record) -> Iterator[str]:
    """Change of a common frequency that nothing controls."""
    system = inline_system(record.configuration)
    rows = {row["name"]: row for row in system.get("machines") or () if isinstance(row, dict)}
    held = any(row.get("enabled", True) for row in system.get("governors") or ())
    held = held or any(row["model"] in FORMING for row in system.get("inverters") or ())
    if system.get("infinite_buses") or held or set(rows) < set(record.machine_names) or not rows:
        return
    weights = np.array([rows[name]["rating"] * rows[name]["H"] for name in record.machine_names])
    weights = weights * _in_service(record)
    common = np.sum(weights * record.machines["speed_deviation"], axis=1) / np.maximum(weights.sum(axis=1), 1e-9)
    moved = float(system["frequency"] * (common[-1] - common[0]))
    if abs(moved) > DRIFT:
        yield f"the common frequency has moved by {moved:+.2f} Hz at the end, and no governor holds it"


def _forced(record: Record) -> Iterator[str]:
    """Forced oscillations that last to the end, where the verdict is of them instead of the loop."""
    if names := sorted(states_of(record)[-1].forced):
        yield f"a forced oscillation of {', '.join(names)} lasts to the end: the verdict is of what it forces"


def _when(record: Record, beyond: NDArray[np.bool_]) -> str:
    """Text: duration and start."""
    length = np.count_nonzero(beyond) / record.frame_rate
    return f"{length:.2f} s from {record.time_s[np.argmax(beyond)]:.2f} s on"


def _in_service(record: Record) -> NDArray[np.bool_]:
    """Whether each machine is connected, (ticks, machines)."""
    in_service = np.ones(record.machines.shape, np.bool_)
    for state in states_of(record):
        in_service[record.time_ns >= state.time_ns] = [name not in state.machines_out for name in record.machine_names]
    return in_service


def _burning(record: Record) -> NDArray[np.bool_]:
    """Whether a fault is present, (ticks,)."""
    fault_present = np.zeros(len(record.time_ns), np.bool_)
    for state in states_of(record):
        fault_present[record.time_ns >= state.time_ns] = bool(state.faults)
    return fault_present


def controller_warnings(
    record: Record, histories: Sequence[SupervisorHistory], latency: Statistics, duty: Mapping[str, float]
) -> list[str]:
    """Controllers that were not armed, without effect, late, or at their limits, one line each.

    `latency`: ms; `duty`: fraction of the time that each device's setpoint is at its limit.
    """
    mean = latency.mean or 0.0
    late = [f"latency {mean / 1e3:.1f} s on average, more than {LATE_S:g}"] if mean >= 1e3 * LATE_S else []
    limits = {device: f"{100 * fraction:.0f} % of the time" for device, fraction in duty.items() if fraction > MOSTLY}
    limited = [f"{device} was at its limit {text}" for device, text in limits.items()]
    return [*_not_armed(record, histories), *_without_effect(record), *late, *limited, *untuned(record.configuration)]


def untuned(run: Mapping[str, Any]) -> list[str]:
    """A line for each shipped controller of a stored run with default parameters that are of other systems.

    It names a command that tunes the controller, if the run's system and a scenario for it are files.
    """
    asked, name, lines = run.get("asked") or run, inline_system(run).get("name", ""), dict[str, None]()
    file, scenario = asked.get("system"), asked.get("scenario")
    if not isinstance(file, str):
        file = asked.get("system_file") or (name if name in shipped("systems") else None)
    trained = f"{name}/training" in shipped("scenarios")
    more = f" --profile {asked['profile']}" if asked.get("profile") else ""
    more += "" if trained else f" --scenario {scenario}"
    for c, row in enumerate(run.get("controllers") or ()):
        if row.get("untuned"):
            signals, devices = ",".join(row["signals"]), ",".join(row["devices"])
            tunable, set_name = row["name"], ""
            if tunable == "LLC":
                tunable, set_name = "LLC-tuned", f" --set controllers.{c}.name=LLC-tuned"
            command = f"facts-damping tune {file} {tunable} --devices {devices} --signals {signals}{more}"
            how = f": `{command} --out tuned.yaml`, then `--set tuning=tuned.yaml{set_name}`"
            known = file and (trained or isinstance(scenario, str))
            lines[f"{row['name']} {NOT_TUNED} {name} with {signals} and {devices}{how if known else ''}"] = None
    return list(lines)


def _not_armed(record: Record, histories: Sequence[SupervisorHistory]) -> Iterator[str]:
    """Supervised controllers that were never armed, with the reason."""
    arm_at = record.configuration.get("arm_at")
    for history in histories:
        if history.fractions[STATES[ARMED]] == 0.0:
            due = "nobody armed it" if arm_at is None else f"due at {arm_at:g} s"
            why = cause_text(history.refusals[-1]) if history.refusals else due
            yield f"{history.controller} was {NEVER_ARMED} ({why}): it controlled nothing"


def _without_effect(record: Record) -> Iterator[str]:
    """Controllers without any setpoint that reached a device."""
    rows = record.configuration.get("controllers") or []
    fallbacks = {i for i, row in enumerate(rows) if row.get("fallback_of") is not None}
    for c, name in enumerate(record.controller_names):
        if c not in fallbacks and not (record.applied["controller"] == c).any():
            link = (rows[c].get("link") if c < len(rows) else None) or record.configuration.get("link") or {}
            stages = [row for way in ("up", "down") for row in link.get(way) or ()] if isinstance(link, dict) else []
            delay = sum(float(row.get("delay") or 0.0) for row in stages)
            why = f": its link delays by {delay:g} s" if delay > LATE_S else ""
            yield f"no setpoint of {name} came to a device in {record.time_s[-1]:.3g} s{why}"
