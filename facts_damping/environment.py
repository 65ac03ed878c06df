"""A Gymnasium environment (docs/own_controllers.md): the package `facts_damping_gym`."""

import sys
from typing import TYPE_CHECKING

from facts_damping.extensions import module

if TYPE_CHECKING:
    from facts_damping_gym import *  # noqa: F403

sys.modules[__name__] = module("environment")
