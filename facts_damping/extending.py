"""What an extension imports: `from facts_damping.extending import ControllerKind, Parameter, compiled`.

A name is loaded when it is asked for: rows are read while their tables are being made (docs/extensions.md).
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from facts_damping import random_numbers as random_numbers
    from facts_damping.analysis.indices import Index as Index
    from facts_damping.cli.options import common as common
    from facts_damping.compiling import compiled as compiled
    from facts_damping.control.parameter_tables import Parameter as Parameter
    from facts_damping.control.parameter_tables import Range as Range
    from facts_damping.control.parameter_tables import powers as powers
    from facts_damping.control.table import ControllerKind as ControllerKind
    from facts_damping.devices.base import Parallel as Parallel
    from facts_damping.devices.base import Series as Series
    from facts_damping.devices.kind import DeviceKind as DeviceKind
    from facts_damping.devices.kind import Shown as Shown
    from facts_damping.devices.kind import Start as Start
    from facts_damping.devices.kind import table as table
    from facts_damping.elementary import atan2 as atan2
    from facts_damping.elementary import cos as cos
    from facts_damping.elementary import exp as exp
    from facts_damping.elementary import exp_complex as exp_complex
    from facts_damping.elementary import expm1 as expm1
    from facts_damping.elementary import hypot as hypot
    from facts_damping.elementary import log as log
    from facts_damping.elementary import log1p as log1p
    from facts_damping.elementary import magnitude as magnitude
    from facts_damping.elementary import phase as phase
    from facts_damping.elementary import power as power
    from facts_damping.elementary import rect as rect
    from facts_damping.elementary import sin as sin
    from facts_damping.elementary import sin_cos as sin_cos
    from facts_damping.elementary import tan as tan
    from facts_damping.elementary import tanh as tanh
    from facts_damping.fields import quantity as quantity
    from facts_damping.link.stages import DRAWN as DRAWN
    from facts_damping.link.stages import StageKind as StageKind
    from facts_damping.machine_controls.blocks import Block as Block
    from facts_damping.machine_controls.blocks import Model as Model
    from facts_damping.neurofuzzy.table import Antecedent as Antecedent
    from facts_damping.neurofuzzy.table import Consequent as Consequent
    from facts_damping.neurofuzzy.table import H as H
    from facts_damping.neurofuzzy.table import S as S
    from facts_damping.neurofuzzy.table import Variant as Variant
    from facts_damping.neurofuzzy.table import W as W
    from facts_damping.parameters.stages import StageModel as StageModel
    from facts_damping.recording import load as load

ROOMS: dict[str, tuple[str, ...]] = {
    "analysis.indices": ("Index",),
    "cli.options": ("common",),
    "compiling": ("compiled",),
    "control.parameter_tables": ("Parameter", "Range", "powers"),
    "control.table": ("ControllerKind",),
    "devices.base": ("Parallel", "Series"),
    "devices.kind": ("DeviceKind", "Shown", "Start", "table"),
    "elementary": (
        "atan2",
        "cos",
        "exp",
        "exp_complex",
        "expm1",
        "hypot",
        "log",
        "log1p",
        "magnitude",
        "phase",
        "power",
        "rect",
        "sin",
        "sin_cos",
        "tan",
        "tanh",
    ),
    "fields": ("quantity",),
    "link.stages": ("DRAWN", "StageKind"),
    "machine_controls.blocks": ("Block", "Model"),
    "neurofuzzy.table": ("Antecedent", "Consequent", "H", "S", "Variant", "W"),
    "parameters.stages": ("StageModel",),
    "recording": ("load",),
}  # names by the module that has them
MODULES = ("random_numbers",)
NAMES = {name: room for room, names in ROOMS.items() for name in names}


def __getattr__(name: str) -> Any:
    """A name of an extension's imports."""
    if name in MODULES:
        return importlib.import_module(f"facts_damping.{name}")
    if name in NAMES:
        return getattr(importlib.import_module(f"facts_damping.{NAMES[name]}"), name)
    raise AttributeError(f"module '{__name__}' has no attribute '{name}'; it has {', '.join(__dir__())}")


def __dir__() -> list[str]:
    """Names for completion."""
    return sorted([*NAMES, *MODULES])
