"""Checks that need several files: unknown devices, controllers, signals and events."""

from __future__ import annotations

from typing import TYPE_CHECKING

from facts_damping.case.measurement import check_measurement
from facts_damping.control.table import kind_of
from facts_damping.errors import InputError, check_known
from facts_damping.parameters.validation import origin
from facts_damping.plant.events import topology_intervals

if TYPE_CHECKING:
    from facts_damping.case.model import Case

MAX_TICKS = 2_000_000  # of a run: all its signals are kept in memory


def check_events(case: Case, scenario_file: str, source: str, sets: dict[str, str] | None) -> None:
    """Raise `InputError` for impossible events; the message names the scenario's file or the run's field."""
    try:
        topology_intervals(case.system, case.scenario.events)
    except InputError as error:
        text = str(error)
        if not text.startswith("events."):
            raise
        if scenario_file:
            raise InputError(f"{scenario_file}: {text}") from error
        place = text.removeprefix("events.")
        field = f"scenario.{place.split(':')[0].split(' ')[0]}"
        raise InputError(
            f"{origin(field, source, sets)}{place.removeprefix(field.removeprefix('scenario.'))}"
        ) from error


def check_case(case: Case, source: str, sets: dict[str, str] | None) -> None:
    """Raise `InputError` for devices, controllers, signals or parameters that the other files do not have."""
    run, system = case.run, case.system
    if case.ticks > MAX_TICKS:
        raise InputError(
            f"{origin('duration', source, sets)}: {case.duration:g} s at {run.frame_rate} frames/s given, "
            f"{case.ticks} frames; allowed: at most {MAX_TICKS} frames"
        )
    for i, device in enumerate(run.devices):
        check_known(origin(f"devices.{i}", source, sets), device, [d.name for d in system.devices])
        if device in run.devices[:i]:
            raise InputError(f"{origin(f'devices.{i}', source, sets)}: '{device}' given twice; allowed: each once")
    for name in run.load_noise.loads if run.load_noise else ():
        check_known(origin(f"load_noise.loads.{name}", source, sets), name, [load.name for load in system.loads])
    _check_channels(case, source, sets)
    check_measurement(case, source, sets)
    commanded: set[str] = set()
    for c, controller in enumerate(run.controllers):
        here, row = f"controllers.{c}", kind_of(controller)

        def where(field: str, here: str = here) -> str:
            return origin(f"{here}.{field}", source, sets)

        for device in controller.devices:
            check_known(where("devices"), device, run.devices)
            if controller.fallback_of is None and device in commanded:
                raise InputError(
                    f"{where('devices')}: '{device}' given, which is commanded already; allowed: each device once"
                )
            commanded |= {device} if controller.fallback_of is None else set()
        for signal in controller.signals:
            check_known(where("signals"), signal, list(system.signals))
            if controller.signals.count(signal) > 1:
                raise InputError(f"{where('signals')}: '{signal}' given twice; allowed: each once")
        if len(controller.signals) > row.signals:
            raise InputError(
                f"{where('signals')}: {len(controller.signals)} given; allowed: {row.signals} for {controller.name}"
            )


def _check_channels(case: Case, source: str, sets: dict[str, str] | None) -> None:
    """Check that stages of links name PMUs or signals (up), or installed devices (down)."""
    known = {"up": [*(s.name for s in case.system.pmus), *case.system.signals], "down": case.run.devices}
    own = [f"controllers.{c}.link" for c, controller in enumerate(case.run.controllers) if controller.link is not None]
    fields = [*["link"][: len(case.links) - len(own)], *own]
    for field, link in zip(fields, case.links, strict=True):
        for way, names in known.items():
            for i, stage in enumerate(getattr(link, way)):
                for name in stage.channels or []:
                    check_known(origin(f"{field}.{way}.{i}.channels", source, sets), name, names)
