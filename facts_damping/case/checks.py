"""Checks that need several files: unknown devices, controllers, signals and events."""

from __future__ import annotations

from typing import TYPE_CHECKING

from facts_damping.case.measurement import check_measurement
from facts_damping.control.table import kind_of
from facts_damping.errors import InputError
from facts_damping.parameters.field_errors import FieldError, check_known
from facts_damping.plant.events import topology_intervals

if TYPE_CHECKING:
    from facts_damping.case.model import Case

MAX_TICKS = 2_000_000  # of a run: all its signals are kept in memory


def check_events(case: Case, scenario_file: str) -> None:
    """Raise `InputError` for impossible events; the message names the scenario's file or the run's field."""
    try:
        topology_intervals(case.system, case.scenario.events)
    except InputError as error:
        text = str(error)
        if not text.startswith("events."):
            raise
        if scenario_file:
            raise InputError(f"{scenario_file}: {text}") from error
        place, _, problem = text.removeprefix("events.").partition(": ")
        path, space, more = place.partition(" ")
        raise FieldError(f"scenario.{path}", problem, space + more) from error


def check_case(case: Case) -> None:
    """Raise `InputError` for devices, controllers, signals or parameters that the other files do not have."""
    run, system = case.run, case.system
    if case.ticks > MAX_TICKS:
        problem = f"{case.duration:g} s at {run.frame_rate} frames/s given, {case.ticks} frames"
        raise FieldError("duration", f"{problem}; allowed: at most {MAX_TICKS} frames")
    for i, device in enumerate(run.devices):
        check_known(f"devices.{i}", device, [d.name for d in system.devices])
        if device in run.devices[:i]:
            raise FieldError(f"devices.{i}", f"'{device}' given twice; allowed: each once")
    for name in run.load_noise.loads if run.load_noise else ():
        check_known(f"load_noise.loads.{name}", name, [load.name for load in system.loads])
    _check_channels(case)
    check_measurement(case)
    commanded: set[str] = set()
    for c, controller in enumerate(case.controllers):
        here, row = f"controllers.{c}", kind_of(controller)
        for device in controller.devices:
            check_known(f"{here}.devices", device, run.devices)
            if controller.fallback_of is None and device in commanded:
                problem = f"'{device}' given, which has a controller already"
                raise FieldError(f"{here}.devices", f"{problem}; allowed: each device once")
            commanded |= {device} if controller.fallback_of is None else set()
        for signal in controller.signals:
            check_known(f"{here}.signals", signal, list(system.signals))
            if controller.signals.count(signal) > 1:
                raise FieldError(f"{here}.signals", f"'{signal}' given twice; allowed: each once")
        if len(controller.signals) > row.signals:
            allowed = f"{row.signals} for {controller.name}"
            raise FieldError(f"{here}.signals", f"{len(controller.signals)} given; allowed: {allowed}")


def _check_channels(case: Case) -> None:
    """Check that stages of links name PMUs or signals (up), or installed devices (down)."""
    known = {"up": [*(s.name for s in case.system.pmus), *case.system.signals], "down": case.run.devices}
    at = [f"controllers.{c}.link" for c, controller in enumerate(case.run.controllers) if controller.link is not None]
    fields = [*["link"][: len(case.links) - len(at)], *at]
    for field, link in zip(fields, case.links, strict=True):
        for way, names in known.items():
            for i, stage in enumerate(getattr(link, way)):
                for name in stage.channels or []:
                    check_known(f"{field}.{way}.{i}.channels", name, names)
