"""Storms: the rules hold under the faults of seeds, a storm repeats itself, and what breaks a rule is shrunk."""

from __future__ import annotations

import importlib
import random
import secrets
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from facts_damping.case.loading import make_case
from facts_damping.cli.main import main
from facts_damping.digest import digest
from facts_damping.errors import InputError
from facts_damping_testing.storm import drawing, model, running, search
from facts_damping_testing.storm.events import KINDS, words
from facts_damping_testing.storm.rules import RULES, violations
from facts_damping_testing.storm.shrinking import fingerprint, shrink
from tests.testing.storm.faults import FAULTS, Fault, insert

if TYPE_CHECKING:
    from collections.abc import Iterator

CORPUS = sorted((Path(__file__).parents[2] / "data" / "storms").glob("*.yaml"))
FIXED = range(110)  # seeds
LONG = 224, 303  # seeds of storms of 47 s in lockstep and of 38 s in real time
RANDOM = 20  # storms of a random seed


def assert_holds(storm: model.Storm, folder: Path) -> running.Trace:
    folder.mkdir()
    trace = running.run(storm, folder)
    assert violations(trace) == [], storm.text()
    return trace


def test_rules_hold_in_storms_of_fixed_seeds_and_of_a_random_one(tmp_path: Path) -> None:
    first = secrets.randbelow(2**31)
    print(f"storms of the seeds {first} to {first + RANDOM - 1}")
    modes, kinds = set[str](), set[str]()
    storms = [drawing.draw(seed) for seed in (*FIXED, *range(first, first + RANDOM))]
    storms += [drawing.long(drawing.draw(seed), random.Random(seed)) for seed in LONG]
    for number, storm in enumerate(storms):
        trace = assert_holds(storm, tmp_path / str(number))
        modes.add(trace.mode)
        kinds.update(done.kind for done in trace.timeline)
    assert modes == set(drawing.MODES)
    assert len(kinds) > 0.8 * len(KINDS)


@pytest.mark.parametrize("path", CORPUS, ids=lambda path: str(path.stem))
def test_storms_of_the_corpus_break_no_rule(path: Path, tmp_path: Path) -> None:
    assert_holds(model.read(path), tmp_path / "storm")


def test_storm_repeats_itself(tmp_path: Path) -> None:
    """With its messages, logs and times; the fields of a file give the same storm."""
    storm = drawing.draw(12)
    (tmp_path / "storm.yaml").write_text(storm.text())
    first, second = (
        assert_holds(repeated, tmp_path / name)
        for name, repeated in (("first", storm), ("second", model.read(tmp_path / "storm.yaml")))
    )
    logs = [[row for row in trace.logs if "messages written" not in row[3]] for trace in (first, second)]
    assert logs[0] == logs[1]
    assert first.world_s == second.world_s
    assert first.record is not None
    assert second.record is not None
    assert digest(first.record) == digest(second.record)


@pytest.fixture(
    params=[
        "an unknown publisher is admitted",
        "the plant applies setpoints again",
        "refusals are logged each time",
        "a stop signal is ignored",
    ]
)
def fault(request: pytest.FixtureRequest) -> Iterator[str]:
    """One of the deliberate faults, in this process."""
    (chosen,) = [deliberate for deliberate in FAULTS if deliberate.what == request.param]
    take_out = insert(chosen)
    yield chosen.what
    take_out()


def test_deliberate_fault_is_found_and_shrunk(fault: str, tmp_path: Path) -> None:
    number = iter(range(10**6))

    def broken(storm: model.Storm) -> list[tuple[str, str]]:
        folder = tmp_path / str(next(number))
        folder.mkdir()
        return violations(running.run(storm, folder))

    storm, violated = next(
        (storm, violated) for seed in range(100) if (violated := broken(storm := drawing.draw(seed)))
    )
    mark = fingerprint(*violated[0])
    mild = shrink(storm, lambda milder: mark in [fingerprint(*row) for row in broken(milder)], most=15)
    assert mark in [fingerprint(*row) for row in broken(mild)], fault
    assert len(mild.events) <= min(2, len(storm.events))


def test_storm_that_reaches_something_new_is_kept_and_varied() -> None:
    search_findings, storm = search.Findings(), drawing.draw(3)
    reached = search.Result([], frozenset(["a log"]), 1.0, 1.0)
    for _ in range(2):
        search_findings.add(storm, reached)
    assert (search_findings.storms, search_findings.kept, search_findings.world_s) == (2, [storm], 2.0)
    chance = random.Random(0)
    varied = [search.vary(storm, chance) for _ in range(20)]
    assert all(varied_storm.run == storm.run for varied_storm in varied)
    assert len({varied_storm.text() for varied_storm in varied}) == len(varied)


def test_search_counts_what_it_tries_until_an_interrupt(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupt(so_far: search.Findings) -> None:
        if so_far.storms == 3:
            raise KeyboardInterrupt

    monkeypatch.setattr(search, "RAM", tmp_path)
    findings = search.search(1.0, 1, 1, interrupt)
    assert (findings.storms, findings.complete) == (3, False)
    assert list(tmp_path.iterdir()) == []  # though its worker was killed within a storm
    assert findings.plant_s > 0.0
    assert not findings.broken


def test_storm_events_of_all_kinds_are_put_into_words() -> None:
    for kind in KINDS:
        event = model.Event(at=0.0, kind=kind, node="plant_sim", topic="pmu/frames", lasts=1.0, size=2.0, name="arm")
        assert "{" not in words(event)


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        ("seed: 1\nevents: [{at: 1, kind: hail}]", "events.0.kind: 'hail' given; allowed: late"),
        (
            "seed: 1\nevents: [{at: 0, kind: killed, node: nobody}]",
            "events.0.node: 'nobody' given; allowed: , ",
        ),
        ("seed: 1\nevents: [{at: 0, kind: forged, topic: x}]", "events.0.topic: 'x' given; allowed: "),
        ("seed: 1\nmode: fast", "mode: 'fast' given"),
    ],
)
def test_storm_that_is_none_is_refused_in_one_line(content: str, expected: str, tmp_path: Path) -> None:
    path = tmp_path / "storm.yaml"
    path.write_text(content)
    with pytest.raises(InputError) as refused:
        running.run(model.read(path), tmp_path)
    assert expected in str(refused.value)
    assert "\n" not in str(refused.value)


def test_storm_rules_state_what_they_demand() -> None:
    assert all((rule.__doc__ or "").endswith(".") for rule in RULES.values())


def only_record(trace: running.Trace) -> running.Trace:
    """What a recording of a graph on DDS gives."""
    return running.Trace(trace.case, trace.mode, trace.record)


def test_rules_judge_a_recording_alone(tmp_path: Path) -> None:
    trace: Any = assert_holds(model.Storm(seed=1, run={"duration": 1.0}), tmp_path / "storm")
    assert violations(only_record(trace)) == []
    trace.record.devices["reference"][-1] = 10.0
    assert {name for name, _ in violations(only_record(trace))} == {"setpoints_are_limited", "equals_in_process"}


def test_growing_memory_is_a_violation() -> None:
    """50 blocks are kept in each tick, or 1."""
    trace = running.Trace(make_case({}, "run"), "lockstep")
    grown = [violations(replace(trace, memory=[(500, 10**6), (1000, 10**6 + 500 * each)])) for each in (50, 1)]
    assert [[name for name, _ in violated] for violated in grown] == [["memory_is_bounded"], []]


@pytest.mark.parametrize("fault", FAULTS, ids=lambda fault: fault.what)
def test_deliberate_fault_finds_its_place(fault: Fault) -> None:
    module = importlib.import_module(f"facts_damping.nodes.{fault.module}")
    text = Path(str(module.__file__)).read_text(encoding="utf-8")
    assert text.count(fault.right) == 1


@pytest.mark.parametrize(
    ("broken", "said", "status"),
    [
        ([], "no violation in 4 storms", 0),
        (["trips_hold"], "1 violation of 1 rule in 4 storms", 1),
        (["trips_hold", "time_goes_on", "trips_hold"], "3 violations of 2 rules in 4 storms", 1),
    ],
)
def test_verdict_on_many_storms_is_the_first_line(
    broken: list[str],
    said: str,
    status: int,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    findings, storm = search.Findings(complete=True), drawing.draw(3)
    for number in range(4):
        rows = [(rule, "it does not") for rule in broken] if number == 0 else []
        findings.add(storm, search.Result(rows, frozenset(), 1.0, 1.0))
    monkeypatch.setattr(search, "search", lambda *_: findings)
    monkeypatch.setattr(search, "shrunk", lambda mild, _: mild)
    assert main(["storm", "--minutes", "1", "--out", str(tmp_path)]) == status
    assert capsys.readouterr().out.splitlines()[0] == said
    assert len(list(tmp_path.glob("storm-*.yaml"))) == len(set(broken))
