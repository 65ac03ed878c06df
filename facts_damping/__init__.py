"""Wide-area damping of power systems with FACTS devices, as a ROS 2 node graph."""

from __future__ import annotations

import importlib
from typing import Any

from facts_damping.version import __version__ as __version__


def __getattr__(name: str) -> Any:
    """What `api` has: loaded when it is asked for, so that a command loads what it needs alone."""
    api = importlib.import_module("facts_damping.api")
    if name in api.__all__:
        return getattr(api, name)
    raise AttributeError(f"module 'facts_damping' has no attribute '{name}'; it has {', '.join(api.__all__)}")
