"""A run without its supervision."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from facts_damping.case.model import Case


def unsupervised(case: Case) -> Case:
    """The same run without supervisors, fallbacks and the fallbacks' links: the normal control path."""
    if case.supervision is None:
        return case
    primaries = [c for c, controller in enumerate(case.run.controllers) if controller.fallback_of is None]
    links = sorted({case.used_links[c] for c in primaries})
    fields = {"controllers": [case.run.controllers[c] for c in primaries], "supervision": None, "arm_at": None}
    return replace(
        case,
        run=case.run.model_copy(update=fields),
        controllers=[case.controllers[c] for c in primaries],
        links=[case.links[i] for i in links],
        used_links=[links.index(case.used_links[c]) for c in primaries],
        supervision=None,
    )
