"""The arms of the experiment: where each searches, and the controllers of a run at a point."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

from facts_damping.control.parameter_tables import Range
from facts_damping_studies.search.structures import Choice, Structure

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from numpy.typing import NDArray

HERE = "facts_damping_reproduction.adaptation.policies"
DEPLOYMENT = {"system": "two_area", "profile": "deployment"}
GAINS = {"rate": Range(1e-3, 1.0, logarithmic=True), "leak": Range(0.01, 1.0, logarithmic=True)}
WEIGHT = {"weight": Range(1e-4, 1e2, logarithmic=True)}
STILL = {"eta": 0.0, "identifier_eta": 0.0}  # a network that does not learn


class Space(NamedTuple):
    """Where an arm searches: number of coordinates from 0 to 1, and its controllers at a point."""

    size: int
    rows: Callable[[NDArray[Any]], list[dict[str, Any]]]


def choice(
    devices: Sequence[str], name: str, scheme: Any = None, *, system: str, profile: str, signals: Sequence[str] = ()
) -> Choice:
    """The search space of a shipped controller; delay is not compensated."""
    return Choice(Structure(name, scheme, tuple(devices), profile, tuple(signals)), system)


def space(
    arm: dict[str, Any], network: dict[str, Any], devices: Sequence[str], where: Mapping[str, Any] = DEPLOYMENT
) -> Space:
    """The space of an arm that is searched; `network`: name and scheme of that of all arms; `where`: for `choice`."""
    if arm["kind"] == "searched":
        controllers = choice(devices, arm["name"], **where)
        return Space(controllers.size, lambda at: [controllers.controller(at).model_dump()])
    if arm["kind"] == "network":
        controllers, more = choice(devices, **network, **where), {} if arm["learning"] else STILL
        return Space(controllers.size, lambda at: [_with(controllers.controller(at).model_dump(), more)])
    signals = {"devices": list(devices), "signals": ["frequency"]}
    if arm["policy"] == "IdentifiedLQG":
        return Space(
            1,
            lambda at: [
                {**signals, "name": "identified", "policy": f"{HERE}:IdentifiedLQG", "parameters": _values(WEIGHT, at)}
            ],
        )
    lead = choice(devices, "LLC-tuned", **where)

    def adaptive(at: NDArray[Any]) -> list[dict[str, Any]]:
        parameters = lead.controller(at[: lead.size]).parameters
        lead_lag = {name: parameters[name] for name in ("gain", "T1", "T2", "T3", "T4")}
        return [
            {
                **signals,
                "name": "adaptive",
                "policy": f"{HERE}:AdaptiveGain",
                "parameters": {**lead_lag, **_values(GAINS, at[lead.size :])},
            }
        ]

    return Space(lead.size + len(GAINS), adaptive)


def _values(ranges: dict[str, Range], at: NDArray[Any]) -> dict[str, float]:
    return {
        name: parameter_range.value(float(v)) for (name, parameter_range), v in zip(ranges.items(), at, strict=True)
    }


def _with(row: dict[str, Any], parameters: dict[str, float]) -> dict[str, Any]:
    return {**row, "parameters": {**row["parameters"], **parameters}}
