"""Fault campaigns: draws by seed, what must hold, failing draws as run files, resumption, bad input."""

from __future__ import annotations

import csv
import json
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from facts_damping.case.loading import load_case
from facts_damping.cli.main import main
from facts_damping.errors import InputError
from facts_damping.monitor_table import CODES, MONITORS, TRIPPED
from facts_damping.output.terminal import Progress
from facts_damping.parameters.files import shipped
from facts_damping.simulation import loop
from facts_damping_studies.campaigns import campaign, campaign_tables, invariants
from facts_damping_studies.campaigns.actions import Actions
from facts_damping_studies.campaigns.draw_rows import DrawnFault, DrawRow, Intervention
from facts_damping_studies.campaigns.faults import FAULTS, ONLY_REAL
from facts_damping_studies.campaigns.invariants import Effect
from facts_damping_studies.campaigns.parameters import Campaign
from tests.commands import assert_one_line

if TYPE_CHECKING:
    from pathlib import Path

SMALL = """\
description: a few seconds of two_area
seed: 5
draws: 6
window: [0.8, 1.2]
base_runs:
  two_area:
    run: two_area_supervised
    set: {duration: 3, arm_at: 0.2, supervision.arming.ramp: 0.1}
    choose:
      controller:
        LLC: {controllers.0.name: LLC}
        HBsWC: {controllers.0.name: HBsWC}
      link: {ideal: {link: ideal}, pdci: {link: pdci}}
"""


SUPERVISED = """run: two_area_supervised
    set: {duration: 3, arm_at: 0.2, supervision.arming.ramp: 0.1}"""


@pytest.fixture
def small(tmp_path: Path) -> Path:
    path = tmp_path / "small.yaml"
    path.write_text(SMALL)
    return path


def carried_out(path: Path, folder: Path, **more: Any) -> list[DrawRow]:
    progress = Progress("test", "draws")
    try:
        return campaign.run(campaign.plan(str(path), **more), folder, 1, None, progress)
    finally:
        progress.close()


@pytest.mark.parametrize("name", shipped("campaigns"))
def test_shipped_campaigns_can_be_drawn_from(name: str) -> None:
    plan = campaign.plan(name)
    drawn = {campaign.draw(plan, number).fault for number in range(40)}
    assert drawn <= set(campaign.weights(plan.campaign))


@pytest.mark.parametrize("fault", FAULTS)
def test_campaign_fault_makes_a_run(fault: str, small: Path) -> None:
    """Drawn a few times: what it changes can be run, and is not nothing, but where it is only done to real graphs."""
    small.write_text(SMALL + f"faults: {{{fault}: 1}}\n" + ("healthy: 1.0\n" if fault == "none" else ""))
    plan = campaign.plan(str(small))
    for number in range(4):
        drawn = campaign.draw(plan, number, real=True)
        assert drawn.fault == fault
        case = campaign.case_of(plan, drawn)
        sound = campaign.case_of(plan, campaign.healthy(plan, drawn))
        assert (case.document() == sound.document()) == (fault in ("none", *ONLY_REAL))


def test_supervisor_sees_a_wrong_sign_in_the_controller_and_none_behind_it(small: Path) -> None:
    """At the device both are the same; the monitor `harm` judges what passes the supervisor, and trips only one."""
    plan = campaign.plan(str(small), ["duration=7", "controllers.0.name=LLC", "link=ideal", "scenario=small"])
    begun, passed, acting = 120, {}, {}
    for fault in ("none", "wrong_sign", "wrong_sign_behind"):
        choice = campaign.Choice("two_area", {}, fault, begun / 60, None, 1)
        run_record = loop.run(campaign.case_of(plan, campaign.drawn(plan, 0, choice, np.random.default_rng(1))))
        trips = run_record.supervision[run_record.supervision["state"] == TRIPPED]
        assert set(trips["cause"]) == ({CODES["harm"]} if fault == "wrong_sign" else set())
        added = np.nan_to_num(run_record.supervision["values"][:, CODES["harm"]])
        assert (added.max() > MONITORS["harm"].limit) == (fault == "wrong_sign")
        passed[fault], acting[fault] = run_record.supervised["value"], run_record.applied["value"]
    right = passed["none"][begun]
    assert right == acting["none"][begun] != 0.0
    assert [passed[fault][begun] for fault in ("wrong_sign", "wrong_sign_behind")] == [-right, right]
    assert [acting[fault][begun] for fault in ("wrong_sign", "wrong_sign_behind")] == [-right, -right]


def test_draw_is_its_number_s_whatever_was_drawn_before(small: Path) -> None:
    plan = campaign.plan(str(small))
    first = [campaign.draw(plan, number) for number in range(6)]
    assert [campaign.draw(plan, number) for number in reversed(range(6))] == first[::-1]
    assert campaign.plan(str(small), draws=100).fingerprint == plan.fingerprint  # more draws: the same ones, and more
    other = plan._replace(campaign=plan.campaign.model_copy(update={"seed": 6}))
    assert [campaign.draw(other, number) for number in range(6)] != first


def test_draw_that_fails_is_a_run_file_that_runs_again_bit_for_bit(
    small: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(invariants.ALONE, "within_limits", invariants.Rule("", lambda *_: -1.0))
    rows = carried_out(small, tmp_path / "out", draws=2)
    assert [row.holds for row in rows] == [False, False]
    plan = campaign.plan(str(small))
    for number in (0, 1):
        again = loop.run(load_case(str(tmp_path / "out" / "failed" / f"{number}.yaml")))
        once = loop.run(campaign.case_of(plan, campaign.draw(plan, number)))
        for name in ("issued", "supervised", "supervision", "applied", "machines"):
            assert getattr(again, name).tobytes() == getattr(once, name).tobytes()


def test_interrupted_campaign_goes_on(small: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    first = carried_out(small, tmp_path / "out", draws=3)
    asked: list[int] = []
    one_draw = campaign.one_draw

    def noted(plan: campaign.CampaignPlan, number: int) -> tuple[str, DrawRow]:
        asked.append(number)
        return one_draw(plan, number)

    monkeypatch.setattr(campaign, "one_draw", noted)
    rows = carried_out(small, tmp_path / "out")
    assert asked == [3, 4, 5]
    assert rows[:3] == first
    assert rows == carried_out(small, tmp_path / "other")


def drawn_row(itae: float | None = 1.0, fault: str = "none", lasts: str = "", **actions: Any) -> DrawRow:
    """A row of a campaign: nothing fails, and the controller stays armed."""
    did = Actions(armed_s=0.5)._replace(**actions)
    judgement = Intervention(did, Effect(ITAE=itae, does_no_harm=True), released=False, alone={})
    drawn = DrawnFault("smib", fault, "none", wrong=False, start_s=1.0, labels={"lasts": lasts})
    free = Effect(ITAE=1.0).controlled
    return DrawRow(0, error=None, drawn=drawn, judgement=judgement, unsupervised=free)


def test_costly_trips_are_counted_of_all_healthy_draws() -> None:
    off: dict[str, Any] = {"tripped_s": 5.0, "cause": "growing"}
    costly = [drawn_row(1.06, **off), drawn_row(None, **off)]
    others = [drawn_row(0.9, **off), drawn_row(1.04, **off), drawn_row(2.0), drawn_row(armed_s=None)]
    rows = [*costly, *others, drawn_row(9.0, "wrong_sign", **off)]
    of_all = campaign_tables.healthy_table(rows).rows[0]
    assert of_all[:4] == ["smib", "all", "6", "1"]
    assert [(cell.number, cell.percent) for cell in of_all[4:]] == [(4, 66.67), (2, 33.33), (1, 16.67)]


@pytest.mark.parametrize("fault", ["wrong_sign", "wrong_sign_behind"])
def test_wrong_sign_that_was_never_found_is_missed(fault: str) -> None:
    long = [drawn_row(fault=fault, detected_s=detected_s) for detected_s in (2.0, None)]
    beside = [drawn_row(fault=fault, lasts="0.1"), drawn_row(fault=fault, armed_s=None), drawn_row()]
    *_, row = campaign_tables.missed_table([*long, *beside]).markdown()
    assert "| 2 | 1: 50.00 % (9.45 to 90.55) | 0 |" in row


def test_page_has_a_table_of_each_part(small: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    faults = "faults: {wrong_sign: 1, wrong_sign_behind: 1, cut_both: 2}"
    small.write_text(SMALL.replace("seed: 5", "seed: 8") + faults)
    folder, document = tmp_path / "out", tmp_path / "told.json"
    command = ["campaign", str(small), "--set", "seed=1", "--out", str(folder), "--jobs", "1", "--json", str(document)]
    status, said = main(command), capsys.readouterr()
    text, rows = (folder / "page.md").read_text(), json.loads(document.read_text())["draws"]
    broken = len(list((folder / "failed").glob("*.yaml")))
    assert broken == sum(row["does_no_harm"] is False or row["keeps_synchronism"] is False for row in rows) == 1
    assert status == 3
    assert (
        said.err == f"facts-damping: the campaign ended, but: 1 case with a requirement violated: {folder / 'failed'}\n"
    )
    off = sum(row["fallback_s"] is not None or row["tripped_s"] is not None for row in rows)
    assert said.out.splitlines()[1].startswith(f"{off} fell back or were tripped: ")
    assert "1 with a requirement violated" in said.out
    assert "{{" not in text
    assert all(words in text for name, words in campaign_tables.WORDS.items() if name in invariants.INVARIANTS)
    assert len(rows) == 6
    assert "6 cases with" in said.out
    assert (folder / "draws.parquet").is_file()
    with (folder / "table_outcomes.csv").open(encoding="utf-8") as file:
        (head, first, *_) = csv.reader(file)
    assert head[:4] == ["what", "cases", "with supervision, number", "with supervision, percent"]
    assert first[:2] == ["synchronism lost", "6"]
    lost = sum(row["lost_s"] is not None for row in rows)
    assert first[2:4] == [f"{lost}", f"{round(100 * lost / 6, 2)}"]
    assert f"| synchronism lost | 6 | {lost}: {100 * lost / 6:.2f} %" in text


@pytest.mark.parametrize(
    ("change", "named"),
    [
        (("seed: 5", "seed: -1"), "seed: -1 given"),
        (("draws: 6", "draws: 0"), "draws: 0 given"),
        (("window: [0.8, 1.2]", "window: [2, 1]"), "window: 2 to 1 s given"),
        (("window: [0.8, 1.2]", "faults: {thunder: 1}"), "faults: 'thunder' given; allowed: none, lost"),
        (("window: [0.8, 1.2]", "faults: {lost: -1}"), "faults.lost: -1 given"),
        ((SUPERVISED, "run: two_area_small"), "base_runs.two_area: a run without supervision given"),
        (("link: {ideal", "link: {}\n      other: {ideal"), "choose.link: none given"),
        (("{controllers.0.name: LLC}", "{controllers.0.nam: LLC}"), "controllers.0.nam"),
        (("{controllers.0.name: HBsWC}", "{controllers.0.nam: HBsWC}"), "controllers.0.nam"),
    ],
)
def test_invalid_campaign_is_refused_in_one_line(
    small: Path, change: tuple[str, str], named: str, capsys: pytest.CaptureFixture[str]
) -> None:
    small.write_text(SMALL.replace(*change))
    assert_one_line(2, ["campaign", str(small)], named, capsys)


def test_another_campaign_s_folder_is_refused(small: Path, tmp_path: Path) -> None:
    carried_out(small, tmp_path / "out", draws=1)
    small.write_text(SMALL.replace("seed: 5", "seed: 6"))
    with pytest.raises(InputError, match="holds runs of another study"):
        carried_out(small, tmp_path / "out", draws=1)


def test_healthy_is_the_share_in_which_nothing_fails() -> None:
    base_runs = {"it": {"run": "two_area_supervised"}}
    for fraction in (0.0, 0.25, 1.0):
        weights = campaign.weights(Campaign.model_validate({"draws": 1, "base_runs": base_runs, "healthy": fraction}))
        assert weights.get("none", 0.0) / sum(weights.values()) == pytest.approx(fraction)


def test_of_graphs_one_fault_in_two_is_done_to_a_node(small: Path) -> None:
    """Those that only say something forged, too; of a campaign that has such faults."""
    weights = campaign.weights(campaign.plan(str(small)).campaign, real=True)
    assert set(ONLY_REAL) < set(weights)
    assert sum(weight for name, weight in weights.items() if FAULTS[name].real) == pytest.approx(
        sum(weights.values()) / 2
    )
    small.write_text(SMALL + "faults: {biased: 1, hung: 3}")
    assert campaign.weights(campaign.plan(str(small)).campaign, real=True) == {"biased": 1.0, "hung": 3.0}
