"""The runs behind the page of what holds in a deployment: everybody, on draws that no search has seen."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

from facts_damping.parameters import files
from facts_damping_reproduction import candidates as who
from facts_damping_reproduction.runs import carry_out, shipped

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from facts_damping_reproduction.candidates import Candidate

    Rows = list[dict[str, Any]]

# Draws of each study; the first has twelve kinds of them.
FEW, MANY, CHECKED = 72, 192, 12
AGAIN_SEED = 6201  # of other draws, for the same answers


class HeldOut(NamedTuple):
    """Who was judged, and the rows of each study: a run of everybody in each of its draws."""

    everybody: list[Candidate]
    finalists: list[Candidate]
    beside: list[Candidate]  # networks that do not learn, and what was chosen without noise and delay
    few: Rows  # everybody
    many: Rows  # finalists, and who stands beside them
    again: Rows  # finalists, other draws
    checked: Rows  # all these, also with half the integration step
    unsupervised: Rows  # finalists without supervisor, in the draws of `few`
    ambient: Rows  # everybody, without an event
    delays: Rows  # finalists, with more and more delay
    device_lost: Rows  # finalists with two devices


def gather(folder: Path, jobs: int, draws: int | None = None) -> HeldOut:
    """All rows, in a folder that keeps what was run; `draws`: at most so many of each study, for a look."""
    everybody = who.everybody()
    finalists = who.finalists(everybody)
    controlled = [one for one in finalists if one.name != who.NONE]
    double = [one for one in finalists if one.name == who.NONE or len(one.devices) > 1]
    networks = [one for one in finalists if one.family in who.NETWORKS]
    beside = [who.frozen(one) for one in networks] + [
        who.as_tuned_for_the_thesis(*one) for one in (("LLC-tuned",), ("ANFSC", "direct"), ("HBsWC", "indirect"))
    ]
    events = f"held_out_{who.SYSTEM}"

    def run(title: str, name: str, own: Sequence[Candidate], number: int | None, **more: Any) -> Rows:
        maximum = number if draws is None else min(draws, number or draws)
        axis = {"name": "who", "labels": [one.label for one in own], "rows": [one.changes for one in own]}
        return carry_out(shipped(name, axis, maximum, **more), title, files.new_folder(folder / "runs"), jobs)

    return HeldOut(
        everybody,
        finalists,
        beside,
        few=run("everybody", events, everybody, FEW),
        many=run("finalists", events, [*finalists, *beside], MANY),
        again=run("again", events, finalists, MANY // 2, seed=AGAIN_SEED),
        checked=run("checked", events, [*everybody, *beside], CHECKED, check_step=True),
        unsupervised=run("unsupervised", events, [who.unsupervised(one) for one in controlled], FEW),
        ambient=run("ambient", "held_out_ambient", everybody, None),
        delays=run("delays", "held_out_delay", finalists, None),
        device_lost=run("device lost", "held_out_device_lost", double, None),
    )
