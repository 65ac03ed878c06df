"""Systems linearised at their start."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from facts_damping.api.cases import short_traceback
from facts_damping.case import loading
from facts_damping.small_signal import linear_plant as linear
from facts_damping.small_signal import modal_tables

if TYPE_CHECKING:
    from facts_damping.small_signal.modal_tables import Modal


@short_traceback
def modes(system: str, devices: list[str] | None = None) -> Modal:
    """Power flow, linear model and modes of a system at its start.

    `system`: name under config/systems, or a path; `devices`: that are installed, none: those of a run that it has.
    """
    loaded = loading.load_system(system)
    names = None if devices is None else ",".join(devices) or "none"
    return modal_tables.analyse(loaded, loading.installed(loaded, names))


@short_traceback
def linear_plant(system: str, devices: list[str] | None = None) -> Any:
    """The linearised plant as `control.StateSpace`: setpoints to signals, p.u. (docs/own_controllers.md).

    Raises `InputError` where python-control is not installed.
    """
    return linear.state_space(linear.of(modes(system, devices)))
