"""The public face for scripts and notebooks: `import facts_damping as fd`."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

from facts_damping.analysis.summary import summarise
from facts_damping.case import loading
from facts_damping.errors import FactsDampingError, InputError
from facts_damping.parameters.files import find, read_table
from facts_damping.recording.reader import load as load_recording
from facts_damping.simulation import loop
from facts_damping.small_signal import modal_analysis

if TYPE_CHECKING:
    from facts_damping.signals import Record
    from facts_damping.small_signal.modal_analysis import Modal

__all__ = ["FactsDampingError", "InputError", "load_recording", "modes", "simulate", "summarise"]


def simulate(run: str | None = None, **fields: Any) -> Record:
    """The closed loop of a run, in process: the bits of the lockstep graph.

    `run`: name under config/runs, or a path; none: all defaults. `fields`: of the run that differ, whole
    (`link="delay_100ms"`) or by path (`**{"controllers.0.name": "HBsWC"}`). Raises `InputError` as the commands do, in
    one line.
    """
    path = None if run is None else find("runs", run)
    content = {} if path is None else read_table(path)
    loading.change(content, fields, {name: json.dumps(value, default=str) for name, value in fields.items()})
    return loop.run(loading.make_case(content, str(path or "defaults")))


def modes(system: str, devices: list[str] | None = None) -> Modal:
    """Power flow, linear model and modes of a system at its start.

    `system`: name under config/systems, or a path; `devices`: that are installed, none: those of a run that it has.
    """
    found = loading.load_system(system)
    return modal_analysis.analyse(
        found, loading.installed(found, None if devices is None else ",".join(devices) or "none")
    )
