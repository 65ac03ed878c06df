"""Wide-area damping of power systems with FACTS devices, as a ROS 2 node graph.

For scripts and notebooks: `import facts_damping as fd`; the functions are in `api`.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

from facts_damping.interruption import handle_early

handle_early()  # the rest takes longer to load

from facts_damping.version import __version__ as __version__  # noqa: E402 (after the above)

if TYPE_CHECKING:
    from facts_damping.api import *  # noqa: F403 (types, for those who check them)

PUBLIC = (  # names from `api`
    *("FactsDampingError", "InputError", "RecordingError", "RunError"),
    *("Result", "Score", "Simulation", "Spec", "Sweep"),
    *("linear_plant", "load_recording", "modes", "score", "simulate", "summarise", "sweep"),
)


def __getattr__(name: str) -> Any:
    """Load public names on first access, so that a command loads only what it needs."""
    if name in PUBLIC:
        return getattr(importlib.import_module("facts_damping.api"), name)
    raise AttributeError(f"module 'facts_damping' has no attribute '{name}'; it has {', '.join(PUBLIC)}")


def __dir__() -> list[str]:
    """Names for completion, including those not loaded yet."""
    return sorted([*globals(), *PUBLIC])
