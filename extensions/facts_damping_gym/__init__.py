"""A Gymnasium environment: an agent replaces a controller of a run (docs/own_controllers.md).

Importing this registers `gymnasium.make("facts_damping/WideAreaDamping-v0")`.
"""

import importlib
from contextlib import suppress

from facts_damping_gym.window import Window

__all__ = ["NAME", "Window"]

NAME = "facts_damping/WideAreaDamping-v0"

with suppress(ImportError):  # a trained class does not need gymnasium
    importlib.import_module("gymnasium").register(
        id=NAME,
        entry_point="facts_damping_gym.single:WideAreaDamping",
        vector_entry_point="facts_damping_gym.vector:WideAreaDampingVector",
    )
