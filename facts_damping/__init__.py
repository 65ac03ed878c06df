"""Wide-area damping of power systems with FACTS devices, as a ROS 2 node graph.

For scripts and notebooks: `import facts_damping as fd`; the functions are in `api`.
"""

from __future__ import annotations

import importlib
from importlib.machinery import PathFinder
from typing import TYPE_CHECKING, Any

from facts_damping.interruption import handle_early

handle_early()  # the rest takes longer to load

from facts_damping.version import __version__ as __version__  # noqa: E402 (after the above)

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint

    from facts_damping.api import *  # noqa: F403 (types, for those who check them)
    from facts_damping_studies.api.scores import Score as Score
    from facts_damping_studies.api.scores import score as score
    from facts_damping_studies.api.sweeps import Sweep as Sweep
    from facts_damping_studies.api.sweeps import sweep as sweep

CORE = (  # names from `api`
    *("FactsDampingError", "InputError", "RecordingError", "RunError"),
    *("Result", "Simulation", "Spec"),
    *("linear_plant", "load_recording", "modes", "simulate", "summarise"),
)


def _added() -> dict[str, EntryPoint]:
    """Public names that other packages add, by entry points of the group `facts_damping.api`."""
    return importlib.import_module("facts_damping.extensions").given("api")  # type: ignore[no-any-return]


def __getattr__(name: str) -> Any:
    """Load public names on first access, so that a command loads only what it needs."""
    if name in CORE:
        return getattr(importlib.import_module("facts_damping.api"), name)
    if PathFinder.find_spec(f"{__name__}.{name}", __path__) is not None:  # noqa: F405 (of every package)
        raise AttributeError(name)  # of `from facts_damping import MODULE`, which loads it then: nothing is looked up
    try:
        names = _public()
    except Exception as error:  # of a package that is installed beside
        raise AttributeError(f"module 'facts_damping' has no attribute '{name}': {error}") from error
    if name in names:
        return _added()[name].load()
    raise AttributeError(f"module 'facts_damping' has no attribute '{name}'; it has {', '.join(names)}")


def _public() -> list[str]:
    """Names for scripts and notebooks, also those that other packages add."""
    return sorted([*CORE, *_added()])


def __dir__() -> list[str]:
    """Names for completion, including those not loaded yet."""
    return sorted({*globals(), *_public()})
