"""A Gymnasium environment: an agent in the place of a run's controller (docs/gymnasium.md).

Once this is imported, `gymnasium.make("facts_damping/WideAreaDamping-v0")` knows it.
"""

import importlib
from contextlib import suppress

NAME = "facts_damping/WideAreaDamping-v0"

with suppress(ImportError):  # a trained class runs without it
    importlib.import_module("gymnasium").register(
        id=NAME,
        entry_point="facts_damping.environment.single:WideAreaDamping",
        vector_entry_point="facts_damping.environment.vector:WideAreaDampingVector",
    )
