"""The experiment on learning: cases apart from each other, the statistics, and the whole way with a small plan."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from facts_damping.case import tuned
from facts_damping.cli.main import main
from facts_damping_reproduction.adaptation import experiment, pages
from facts_damping_reproduction.adaptation.cases import BEGIN, KINDS, evaluation, training
from facts_damping_reproduction.adaptation.decide import ALIKE, BETTER, OPEN, WORSE, decision, ratio
from facts_damping_studies.score.entries import NONE

if TYPE_CHECKING:
    from pathlib import Path

SMALL: dict[str, dict[str, Any]] = {
    "search": {"seeds": 1, "cases": 1, "points": 0, "least": 5, "generations": 1},
    "evaluation": {"cases": 3, "begin": 4.0, "after": 2.0},
}


def shape(case: dict[str, Any]) -> tuple[str, ...]:
    """What its event is, without a drift before it."""
    return tuple(f"{e['kind']} {'bus' if 'bus' in e else ''}" for e in case["scenario"] if e["time"] >= BEGIN)


def test_training_and_evaluation_share_no_kind_of_event_and_no_case() -> None:
    known = training(6, BEGIN, 8.0)
    held = [case["set"] for case in evaluation(60, 65.0, 8.0, 0)]
    late = {tuple(kind for kind in shape(case_sets) if not kind.startswith("load")) for case_sets in held}
    assert not {shape(case_sets) for case_sets in known} & late
    seeds = [case_sets["seed"] for case_sets in (*known, *held, *(x["set"] for x in evaluation(60, 65.0, 8.0, 1)))]
    assert len(set(seeds)) == len(seeds)


def found_of(
    levels: dict[str, float], random: np.random.Generator, spread: float, noise: float, of_events: float = 0.0
) -> dict[str, Any]:
    """Results as of the experiment: an arm has a level, its searches and kinds of events spread, and cases differ."""
    events = [i // 3 % 4 for i in range(60)]
    kinds = [KINDS[i % 3] for i in range(60)]
    rows: dict[Any, Any] = {(NONE, 0): [{"lost": False, "index": 1.0}] * 60}
    shared = random.normal(0.0, 0.5, 60)
    event_levels = {name: random.normal(0.0, of_events, 4) for name in levels}
    for name, level in levels.items():
        for seed in range(5):
            log_indices = level + random.normal(0.0, spread) + shared + random.normal(0.0, noise, 60)
            log_indices += event_levels[name][events]
            rows[name, seed] = [{"lost": False, "index": float(np.exp(x))} for x in log_indices]
    return {"rows": rows, "kinds": kinds, "events": events}


def test_interval_is_over_searches_and_cases() -> None:
    """The luck of the search is in it: of 60 experiments about 95 % of the intervals hold the truth."""
    random, held = np.random.default_rng(5), 0
    for _ in range(60):
        comparison = ratio([found_of({"a": -0.8, "b": -0.6}, random, 0.12, 0.1)], "a", "b", KINDS, 0.05)
        held += comparison.low <= np.exp(-0.2) <= comparison.high
    assert held >= 50
    tight = ratio([found_of({"a": -0.8, "b": -0.6}, random, 0.0, 0.1)], "a", "b", KINDS, 0.05)
    assert tight.high - tight.low < 0.1
    wide = ratio([found_of({"a": -0.8, "b": -0.6}, random, 0.0, 0.1, of_events=0.3)], "a", "b", KINDS, 0.05)
    assert wide.high - wide.low > 0.2  # other events may have another answer


@pytest.mark.parametrize(
    ("low", "high", "said"),
    [(0.8, 0.94, BETTER), (0.8, 0.96, OPEN), (0.96, 1.2, ALIKE), (1.06, 1.2, WORSE), (0.9, 1.1, OPEN)],
)
def test_rule_of_the_plan(low: float, high: float, said: str) -> None:
    assert decision(low, high, 0.05) == said


def test_repetitions_stand_beside_each_other() -> None:
    """A large difference is told by each of five, and all together have a narrower interval."""
    random, names = np.random.default_rng(6), list(experiment.plan()["arms"])
    levels = {name: -1.0 + 0.2 * (name == "neuro-fuzzy") for name in names}
    every = {seed: found_of(levels, random, 0.05, 0.1) for seed in range(5)}
    for results in every.values():
        results |= {"arms": names, "searches": {("LQG", 0): {"value": -2.0}, ("LLC-tuned", 0): {"value": -1.9}}}
    first = next(line for line in pages.repetitions(every, pages.ratios(list(every.values()))) if "best fixed" in line)
    assert first.count(WORSE) == 6
    assert "5 of 5" in first
    single, whole = (ratio(some, "neuro-fuzzy", "LQG", KINDS, 0.05) for some in ([every[0]], list(every.values())))
    assert whole.high - whole.low < 0.6 * (single.high - single.low)
    assert whole.low < np.exp(0.2) < whole.high


def test_whole_way_with_a_small_plan(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    whole = experiment.plan()
    arms = {
        name: whole["arms"][name]
        for name in ("LLC", "LLC-tuned", "LQG", "neuro-fuzzy", "neuro-fuzzy, frozen at the event")
    }
    arms |= {"neuro-fuzzy, not learning": whole["arms"]["neuro-fuzzy, not learning"]}
    arms |= {
        name: {**whole["arms"][name], "begin": BEGIN} for name in ("LLC-tuned, adaptive gain", "LQG, model identified")
    }
    common = {**whole["set"], **whole["search"]["set"]}  # steps twice as long, and so on
    small: dict[str, Any] = {**whole, "set": common, "arms": arms, "networks": whole["networks"][:1]}
    for name, part in SMALL.items():
        small[name] = {**whole[name], **part}
    monkeypatch.setattr(experiment, "plan", lambda: small)
    monkeypatch.setattr(experiment, "FIRST_GENERATIONS", 1)
    monkeypatch.setattr(pages, "plan", lambda: small)
    words = [
        "reproduce",
        "--profile",
        "deployment",
        "--jobs",
        "1",
        "--out",
        str(tmp_path),
        "--json",
        str(tmp_path / "x.json"),
    ]
    assert main(words) == 0
    page, document = (tmp_path / "what_holds.md").read_text(), json.loads((tmp_path / "x.json").read_text())
    assert all(line in page for line in document["answers"])
    assert len((tmp_path / "what_holds.csv").read_text().splitlines()) == 1 + len(document["ratios"])
    assert "With the STATCOM as a second device" in page
    laws = {name for name, _ in tuned.rows("what_holds", tuned.read(tmp_path / "what_holds.yaml"))}
    assert {"LQG@what_holds.0", "adaptive@what_holds.0"} <= laws
    assert len({name for name in laws if "not_learning" in name}) == len(laws) / 6
    times = {path: path.stat().st_mtime_ns for path in (tmp_path / "seed_0").rglob("*.json")}
    assert main(words) == 0
    assert {path: path.stat().st_mtime_ns for path in (tmp_path / "seed_0").rglob("*.json")} == times
