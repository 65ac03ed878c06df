"""Reports of recordings, HTML pages (docs/recordings.md): the room `report` of the package `facts_damping_views`."""

import sys
from typing import TYPE_CHECKING

from facts_damping.extensions import module

if TYPE_CHECKING:
    from facts_damping_views.report import *  # noqa: F403

sys.modules[__name__] = module("report", "views")
