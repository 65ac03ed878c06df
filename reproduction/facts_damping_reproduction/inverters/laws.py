"""The arms, and the search of a lead-lag for those with a device: the same for each, scaled by its residue."""

from __future__ import annotations

from functools import cache, partial
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from facts_damping.analysis.measures import columns, speed_differences
from facts_damping.control.parameter_tables import Range, four_digits
from facts_damping.simulation import loop
from facts_damping.small_signal.eigenmodes import sign_and_lead
from facts_damping.small_signal.modal_tables import analyse
from facts_damping_reproduction.adaptation.arms import Space
from facts_damping_reproduction.adaptation.cases import training
from facts_damping_reproduction.adaptation.experiment import evolve, index
from facts_damping_reproduction.inverters.study import grid, interarea, made, plan
from facts_damping_studies.design.lead_lag import late
from facts_damping_studies.score.card import log_ratio

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

SIGNAL = "f13"  # difference of the areas' frequencies
RAISED = 0.1  # of the damping ratio, by a gain of one unit
TIMES = ("T1", "T2", "T3", "T4")
MAIN, BARE = "arms", "bare"  # parts of the plan that have arms


class Arm(NamedTuple):
    """An arm: the part of the plan and its name, fields of its grid, and the device of its controller, if any."""

    part: str
    name: str
    sets: dict[str, Any]
    device: str | None

    @property
    def devices(self) -> list[str]:
        """Devices beside the SSSC."""
        return [self.device] if self.device else []


def arms(part: str) -> dict[str, Arm]:
    """The arms of a part of the plan by name."""
    rows = plan()[BARE]["arms"] if part == BARE else plan()[MAIN]
    below = plan()[BARE]["set"] if part == BARE else {}
    return {
        name: Arm(part, name, {**grid(row["kind"], plan()["share"]), **below, **row.get("set", {})}, row.get("device"))
        for name, row in rows.items()
    }


def without_control(part: str) -> Arm:
    """The grid of inverters that follow, without control: the reference of a part."""
    return Arm(
        part,
        "no control",
        {**grid("following", plan()["share"]), **(plan()[BARE]["set"] if part == BARE else {})},
        None,
    )


def controller(arm: Arm, parameters: dict[str, float]) -> dict[str, Any]:
    """A lead-lag from the difference of the areas' frequencies to the device of an arm."""
    return {"name": "LLC", "devices": [arm.device], "signals": [SIGNAL], "parameters": parameters}


@cache
def unit_gain(part: str, name: str) -> float:
    """Gain, p.u./p.u., that by the interarea mode's residue and delay raises its damping ratio by `RAISED`; with sign."""
    arm = arms(part)[name]
    case = made({**arm.sets, "scenario": []}, devices=arm.devices)
    mode = interarea(analyse(case.system, case.run.devices).modes)
    if mode is None:
        raise ValueError(f"{name}: no interarea mode; allowed: a grid with one")
    residue = next(r for r in mode.residues if (r.device, r.signal) == (arm.device, SIGNAL))
    delayed = residue.angle_deg + float(
        np.angle(late(mode.eigenvalue, plan()["typical"], case.run.frame_rate), deg=True)
    )
    return sign_and_lead(delayed)[0] * RAISED * abs(mode.eigenvalue) / residue.magnitude


def space(arm: Arm) -> Space:
    """Where an arm searches: its gain and four time constants."""
    asked, unit = plan()["search"], unit_gain(arm.part, arm.name)
    gain, T = (Range(low, high, logarithmic=True) for low, high in (asked["gain"], asked["T"]))

    def rows(at: NDArray[Any]) -> list[dict[str, Any]]:
        times = {name: T.value(float(x)) for name, x in zip(TIMES, at[1:], strict=True)}
        return [controller(arm, {"gain": four_digits(unit * gain.value(float(at[0]))), "Tw": 10.0, **times})]

    return Space(1 + len(TIMES), rows)


def trained(arm: Arm, rows: Sequence[dict[str, Any]]) -> list[float | None]:
    """The index in each training case; None: synchronism is lost."""
    asked, indices = plan()["search"], list[float | None]()
    after = plan()["cases"]["after"]
    for sets in training(asked["cases"], asked["begin"], after):
        record = loop.run(made({**asked["set"], **sets, **arm.sets}, rows, arm.devices))
        whole = record.in_synchronism.all()
        indices.append(index(record, asked["begin"], after, columns(speed_differences(record))) if whole else None)
    return indices


@cache
def _free(part: str, name: str) -> list[float | None]:
    return trained(arms(part)[name], ())


def objective(part: str, name: str, rows: Sequence[dict[str, Any]]) -> float:
    """Mean log of the index relative to the same grid without control, over the training cases."""
    pairs = zip(trained(arms(part)[name], rows), _free(part, name), strict=True)
    return float(np.mean([log_ratio(a, b) for a, b in pairs]))


def searched(part: str, task: tuple[str, int]) -> tuple[str, int, dict[str, Any]]:
    """What the search with a seed finds for an arm."""
    name, seed = task
    arm = arms(part)[name]
    best = evolve(space(arm), partial(objective, part, name), plan()["search"], seed)
    return name, seed, best._asdict()
