"""Everything that a node needs, loaded: what the process of `forked` imports before it is copied."""

from __future__ import annotations

from facts_damping.configuration import load_case
from facts_damping.loop import rehearse
from facts_damping.nodes import controller, identifier, plant_sim, recorder, replay_source, wan_link

NODES = (controller, identifier, plant_sim, recorder, replay_source, wan_link)

# The kernels, out of their cache into this process: a network with an identifier uses them all.
rehearse(load_case(None, ["controllers.0.name=HBsWC", "controllers.0.scheme=indirect"]))
