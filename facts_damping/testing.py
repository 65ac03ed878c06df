"""For tests of nodes, including the user's own: `Loopback`, and the fixture `loopback` (docs/extensions.md)."""

import sys
from typing import TYPE_CHECKING

from facts_damping.extensions import module

if TYPE_CHECKING:
    from facts_damping_testing.fixtures import *  # noqa: F403

sys.modules[__name__] = module("testing")
