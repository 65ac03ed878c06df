"""The PSS/E cases inside ANDES's wheel: `make test` fetches it, and unpacks it beside what it installs."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from facts_damping.parameters.plant.system import System

WHEEL = Path(sys.prefix) / "andes"  # unpacked: its folder `andes` has `cases`
CASES = WHEEL / "andes" / "cases"


def with_torques(system: System) -> System:
    """An imported system with what ANDES leaves out: that the speed divides a turbine's power."""
    machines = [machine.model_copy(update={"speed_torque": False}) for machine in system.machines]
    return system.model_copy(update={"machines": machines})
