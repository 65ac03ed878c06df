"""Shrinks a storm that breaks a rule to the mildest one that still does: fewer events, a plainer run, shorter."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Any

from facts_damping.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from facts_damping_testing.storm.model import Event, Storm

PLAIN: dict[str, Any] = {"signed": False, "discovery": 0.0, "mode": "lockstep"}
PLAIN_RUN: dict[str, Any] = {
    "watchdog": None,
    "measurement": None,
    "supervision": None,
    "link": "ideal",
    "controllers": [{"name": "LLC"}],
    "devices": None,
    "scenario": {"smib": "nominal", "two_area": "small"},
    "system": "smib",
    "seed": 0,
}  # None: the field is left out


def fingerprint(rule: str, text: str) -> str:
    """What two violations of the same kind have in common: rule and text without numbers and names of controllers."""
    plain = re.sub(r"/tmp\S+|[-+]?\d[\d.e+-]*(, )?", "#", re.sub(r"_\d+_\w+", "_", text))  # noqa: S108 (as in errors)
    return f"{rule}: {plain[:160]}"


def shrink(storm: Storm, breaks: Callable[[Storm], bool], most: int = 200) -> Storm:
    """The mildest storm found for which `breaks` is still true, within a number of trials."""
    left, going = most, True
    while going and left > 0:
        going = False
        for milder in _milder(storm):
            left -= 1
            try:
                going = breaks(milder)
            except InputError:  # the run does not fit together without what was left out
                continue
            if going:
                storm = milder
                break
            if left <= 0:
                break
    return storm


def _milder(storm: Storm) -> Iterator[Storm]:
    """Storms one step milder than a storm, the greatest steps first."""
    events = list(storm.events)
    for size in sorted({max(1, len(events) // 2), 1}, reverse=True):
        for i in range(0, len(events), size):
            yield storm.model_copy(update={"events": events[:i] + events[i + size :]})
    for name, value in PLAIN.items():
        if getattr(storm, name) != value:
            yield storm.model_copy(update={name: value})
    for name, value in PLAIN_RUN.items():
        plain = value.get(storm.run["system"]) if isinstance(value, dict) else value
        if storm.run.get(name) != plain:
            run = {
                key: choice
                for key, choice in storm.run.items()
                if key != name and (name, key) != ("supervision", "arm_at")
            }
            yield storm.model_copy(update={"run": run if plain is None else run | {name: plain}})
    if storm.run["duration"] > 0.25:
        yield storm.model_copy(update={"run": storm.run | {"duration": storm.run["duration"] / 2}})
    for i, event in enumerate(events):
        for change in _changes(event):
            yield storm.model_copy(update={"events": [*events[:i], event.model_copy(update=change), *events[i + 1 :]]})


def _changes(event: Event) -> Iterator[dict[str, Any]]:
    """Changes that make an event milder: at the start, earlier, shorter, smaller."""
    if event.at > 0.0:
        yield {"at": 0.0}
    if event.at > 0.1:
        yield {"at": round(event.at / 2, 3)}
    if event.lasts > 1.5:
        yield {"lasts": float(int(event.lasts / 2)) if event.lasts.is_integer() else round(event.lasts / 2, 3)}
    if 0.0 < event.size < 1.0:
        yield {"size": round(event.size / 2, 4)}
