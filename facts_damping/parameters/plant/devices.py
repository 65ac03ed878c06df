"""`Parallel` and `Series` of `facts_damping.devices.base`, where earlier pages have them."""

from facts_damping.devices.base import Parallel as Parallel
from facts_damping.devices.base import Series as Series
