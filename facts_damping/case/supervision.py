"""Checks the supervision of a run, also against the controllers."""

from __future__ import annotations

from typing import TYPE_CHECKING

from facts_damping.case.named_files import located
from facts_damping.monitor_table import MONITORS
from facts_damping.parameters.field_errors import FieldError, check_field, check_known
from facts_damping.parameters.supervision import Supervision

if TYPE_CHECKING:
    from facts_damping.case.model import Case
    from facts_damping.case.named_files import Source
    from facts_damping.parameters.plant.system import System
    from facts_damping.parameters.run import Run


def supervision_of(run: Run, source: Source | None) -> Supervision | None:
    """A run's supervision; None if it has none."""
    if source is None:
        if run.arm_at is not None:
            raise FieldError("arm_at", f"{run.arm_at:g} given; allowed: with `supervision`")
        return None
    with located(source) as field:
        supervision = check_field(Supervision, source.content, field)
        _check_monitors(supervision, f"{field}.monitors" if field else "monitors")
    start = supervision.probe.start
    if supervision.arming.probe and run.arm_at is not None and not (start is not None and start < run.arm_at):
        begins = "none" if start is None else f"{start:g}"
        why = f"supervision.arming.probe needs a probe before, and supervision.probe.start is {begins}"
        raise FieldError("arm_at", f"{run.arm_at:g} given, but {why}; allowed: arm_at after a probe")
    return supervision


def _check_monitors(supervision: Supervision, field: str) -> None:
    for name, threshold in supervision.monitors.items():
        check_known(f"{field}.{name}", name, list(MONITORS))
        row, limit = MONITORS[name], None if threshold is None else threshold.limit
        if limit is not None and not row.low <= limit <= row.high:
            allowed = f"{row.low:g} to {row.high:g} {row.unit}"
            raise FieldError(f"{field}.{name}", f"{limit:g} given; allowed: {allowed}", ".limit")


def reserves(run: Run) -> dict[int, int]:
    """Index of the fallback, by index of the controller that it replaces."""
    return {c.fallback_of: i for i, c in enumerate(run.controllers) if c.fallback_of is not None}


def check_fallbacks(case: Case) -> None:
    """Check that a fallback replaces one controller, has its devices, and uses only signals measured at them."""
    rows = case.run.controllers
    for i, fallback in enumerate(rows):
        if fallback.fallback_of is None:
            continue
        here, fallback_text = f"controllers.{i}", f"{fallback.fallback_of} given"
        others = [c for c, other in enumerate(rows) if other.fallback_of is None]
        if case.supervision is None:
            raise FieldError(f"{here}.fallback_of", f"{fallback_text}; allowed: with `supervision`")
        if fallback.fallback_of not in others:
            allowed = f"the index of a controller, {', '.join(map(str, others)) or 'none'}"
            raise FieldError(f"{here}.fallback_of", f"{fallback_text}; allowed: {allowed}")
        if reserves(case.run)[fallback.fallback_of] != i:
            raise FieldError(f"{here}.fallback_of", f"{fallback_text} twice; allowed: one fallback a controller")
        if fallback.devices != rows[fallback.fallback_of].devices:
            names, devices = ", ".join(fallback.devices), ", ".join(rows[fallback.fallback_of].devices)
            raise FieldError(f"{here}.devices", f"{names} given; allowed: those of its controller, {devices}")
        local = local_signals(case.system, fallback.devices)
        for signal in fallback.signals:
            if signal not in local:
                problem = f"'{signal}' given, which is not measured at {' or '.join(fallback.devices)}"
                allowed = ", ".join(local) or "none: no PMU is there"
                raise FieldError(f"{here}.signals", f"{problem}; allowed for a fallback: {allowed}")


def local_signals(system: System, devices: list[str]) -> list[str]:
    """Signals whose PMUs are all at a bus of one of the devices or measure the flow through a device."""
    ends = ("bus", "from_bus", "to_bus")
    buses = {getattr(system.device(name), end, None) for name in devices for end in ends} - {None}
    where = system.pmu_buses()
    at = {s.name for s in system.pmus if where[s.name] in buses or set(s.branches) & set(devices)}
    return [name for name, signal in system.signals.items() if set(signal.weights) <= at]


def ends(system: System) -> list[tuple[int, int]]:
    """Pairs of PMUs, by index, that measure at the two ends of one line."""
    alone = {i: s.branches[0] for i, s in enumerate(system.pmus) if len(s.branches) == 1}
    return [(a, b) for a, line in alone.items() for b, other in alone.items() if a < b and line == other]
