"""The controllers that are judged in the profile deployment: chosen there, and their references."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

from facts_damping.case.controllers import chosen
from facts_damping.studies.search.structures import Structure

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from facts_damping.parameters.run import Tuned, TunedController
    from facts_damping.studies.sweeps.enumerated_axes import Scheme

SYSTEM, PROFILE = "two_area", "deployment"
NONE = "none"  # of control, as `compare` calls it; of compensation
SETS = {("sssc",): "SSSC", ("sssc", "statcom"): "both"}
FIXED, DIRECT, INDIRECT = "fixed", "direct", "indirect"
NETWORKS = (DIRECT, INDIRECT)


class Candidate(NamedTuple):
    """A controller that is judged: its name on the page, what it is, what it sets in a run, its score in training."""

    label: str
    family: str  # FIXED, or a network's scheme; `none` without control
    name: str
    devices: tuple[str, ...]
    compensation: str
    changes: dict[str, Any]
    score: float | None = None  # on training cases that chose nothing; none: it was not searched

    @property
    def chosen(self) -> bool:
        """Whether its parameters were chosen in the profile."""
        return self.score is not None


NOBODY = Candidate(NONE, NONE, NONE, ("sssc",), NONE, {"controllers": []})


def everybody() -> list[Candidate]:
    """No control, the lead-lag as printed, and all that were searched, those of a set of devices by their score."""
    found = [NOBODY, *(_made("LLC", None, devices) for devices in SETS)]
    for file in chosen(SYSTEM, PROFILE):
        found += [candidate(file, row) for row in file.controllers]
    return found


def candidate(file: Tuned, row: TunedController) -> Candidate:
    """The candidate with the parameters of a row."""
    return _made(row.name, row.scheme, tuple(file.devices), row.compensation, row.objective)


def _made(
    name: str,
    scheme: Scheme,
    devices: tuple[str, ...],
    compensation: str = NONE,
    score: float | None = None,
) -> Candidate:
    row: dict[str, Any] = {
        "name": name,
        "devices": list(devices),
        "signals": Structure(name, scheme, devices, PROFILE).signals,
        "compensation": compensation,
    }
    row |= {} if scheme is None else {"scheme": scheme}
    told = [" ".join(filter(None, (name, scheme))), SETS[devices], *([] if compensation == NONE else [compensation])]
    changes = {"devices": list(devices), "controllers": [row]}
    return Candidate(", ".join(told), scheme or FIXED, name, devices, compensation, changes, score)


def best(candidates: Iterable[Candidate], **like: Any) -> Candidate | None:
    """The best in training of those that are so."""
    own = [one for one in candidates if one.chosen and all(getattr(one, name) == value for name, value in like.items())]
    return min(own, key=lambda one: float(one.score or 0.0), default=None)


def best_network(candidates: Iterable[Candidate]) -> Candidate | None:
    """The best network in training."""
    return best(one for one in candidates if one.family in NETWORKS)


def finalists(candidates: Sequence[Candidate]) -> list[Candidate]:
    """Those that are judged on all draws: none, LLC, each fixed design, the best network of each scheme.

    With each set of devices, without compensation; and the best with one, fixed and network.
    """
    found = [one for one in candidates if not one.chosen]
    for devices in SETS:
        plain = [one for one in candidates if one.devices == devices and one.compensation == NONE]
        found += [one for one in plain if one.chosen and one.family == FIXED]
        found += [one for family in NETWORKS if (one := best(plain, family=family))]
        other = [one for one in candidates if one.devices == devices and one.compensation != NONE]
        found += [one for one in (best(other, family=FIXED), best_network(other)) if one]
    return found


def frozen(candidate: Candidate) -> Candidate:
    """A network that does not learn: what its search chose, with rates of zero."""
    row = {**candidate.changes["controllers"][0], "parameters": {"eta": 0.0, "identifier_eta": 0.0}}
    return candidate._replace(
        label=f"{candidate.label}, not learning", changes={**candidate.changes, "controllers": [row]}, score=None
    )


def unsupervised(candidate: Candidate) -> Candidate:
    """The same without supervisor."""
    more = {"supervision": "off", "arm_at": None}
    return candidate._replace(
        label=f"{candidate.label}, unsupervised", changes={**candidate.changes, **more}, score=None
    )


def as_tuned_for_the_thesis(name: str, scheme: Scheme = None) -> Candidate:
    """A controller with what was chosen for exact frequencies, without noise and delay."""
    made = _made(name, scheme, ("sssc",))
    return made._replace(label=f"{made.label}, chosen without", changes={**made.changes, "tuning": "thesis"})
