"""`quantity` of `facts_damping.fields`, where earlier pages have it."""

from facts_damping.fields import quantity as quantity
