"""The search of a controller: reproducible, on training alone, by its rules; the shipped runs are what it chose."""

from __future__ import annotations

import json
import pickle
import re
from collections import Counter
from functools import cache
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
import pytest

from facts_damping.analysis.indices import INDICES
from facts_damping.case.loading import load_case, load_system
from facts_damping.cli.main import main
from facts_damping.cli.parser import parser
from facts_damping.control.table import kind
from facts_damping.errors import InputError
from facts_damping.neurofuzzy.table import ANTECEDENTS, CONSEQUENTS
from facts_damping.parameters import files
from facts_damping.parameters.field_errors import check
from facts_damping.parameters.files import shipped
from facts_damping.parameters.run import Controller, Tuned
from facts_damping_studies.search import scoring
from facts_damping_studies.search import search as study
from facts_damping_studies.search.optimisers import METHODS, Found
from facts_damping_studies.search.scoring import LOST, REFERENCE, Figures, Score, draws, score
from facts_damping_studies.search.search import CHOICES, GROWTH, KEPT, Entry, Rung, SearchTask, rungs, search
from facts_damping_studies.search.structures import Choice, Structure, started, structures
from tests.commands import assert_one_line

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from numpy.typing import NDArray

    from facts_damping.control.parameter_tables import Value
    from facts_damping_studies.search.scoring import Draw
    from facts_damping_studies.sweeps.enumerated_axes import Scheme

TINY = ["smib", "gaussian+sam", "--budget", "1", "--seed", "4", "--jobs", "1"]
BEST = sorted(name for name in shipped("runs") if name.startswith(("best_", "lead_lag_", "search_")))


MANY = 16  # draws of a search's last rung


def quiet(_done: int, _of: int) -> None:
    """No progress."""


def assert_close(again: Mapping[str, Value], values: Mapping[str, Value]) -> None:
    """The same parameters, numbers to their four digits."""
    assert again.keys() == values.keys()
    for key, value in values.items():
        if isinstance(value, str):
            assert again[key] == value, key
        else:
            np.testing.assert_allclose(np.array(again[key], float), np.array(value, float), rtol=2e-3, err_msg=key)


@pytest.fixture(scope="module")
def nominal() -> list[Draw]:
    return draws("smib", None, 3)


@pytest.fixture
def each_run_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """A controller that is scored again on the same draw is not run again."""
    known: dict[tuple[int, str], tuple[dict[str, Any], Figures]] = {}  # the content stays, and so its id its own
    plain = scoring.run

    def run(content: dict[str, Any], controller: Controller | None) -> Figures:
        key = id(content), "" if controller is None else controller.model_dump_json()
        if key not in known:
            known[key] = content, plain(content, controller)
        return known[key][1]

    monkeypatch.setattr(scoring, "run", run)


@pytest.fixture
def few_points(monkeypatch: pytest.MonkeyPatch) -> None:
    """The first points of a structure are few."""
    monkeypatch.setattr(study, "POPULATION", 6)


# The score


def test_llc_tuned_is_as_good_as_itself(nominal: list[Draw]) -> None:
    scored = score(Controller(name=REFERENCE), nominal)
    assert scored == Score(0.0, dict.fromkeys(("ITAE", "IAE", "ITSE", "ISE"), 1.0), 0.0)


def test_without_control_all_is_worse(nominal: list[Draw]) -> None:
    scored = score(Controller(name="LLC", parameters={"gain": 0.0}), nominal)
    assert scored.value > 0.3
    assert min(scored.ratios.values()) > 1.0


@pytest.mark.usefixtures("each_run_once")
def test_score_is_the_worst_index_and_the_price_of_what_effort_is_more(nominal: list[Draw]) -> None:
    weak = Controller(name="LLC", parameters={"gain": 1.0})
    strong = Controller(name="LLC", parameters={"gain": 1000.0})
    for controller, dearer in ((weak, False), (strong, True)):
        figures = [scoring.run(draw.content, controller) for draw in nominal]
        spent = np.mean(
            [
                figures_of_draw.effort - draw.reference.effort
                for figures_of_draw, draw in zip(figures, nominal, strict=True)
            ]
        )
        assert (spent > 0.0) == dearer
        scored = score(controller, nominal)
        worst = max(np.log(ratio) for ratio in scored.ratios.values())
        priced = scoring.PRICE * max(0.0, float(spent)) + scoring.UNDAMPED * scored.undamped
        assert scored.value == pytest.approx(worst + priced)


@pytest.mark.usefixtures("each_run_once")
@pytest.mark.parametrize(("worst", "counted"), [(1, 1), (33, 1), (34, 2), (100, 3)])
def test_of_the_worst_draws_of_each_index_the_mean_counts(worst: int, counted: int, nominal: list[Draw]) -> None:
    weak = Controller(name="LLC", parameters={"gain": 1.0})
    indices = [scoring.run(draw.content, weak).indices for draw in nominal]
    each = [
        [
            np.log(indices_of_draw[i] / draw.reference.indices[i])
            for indices_of_draw, draw in zip(indices, nominal, strict=True)
        ]
        for i in INDICES
    ]
    assert len({round(number, 6) for number in each[0]}) == len(nominal)  # so that it matters which are counted
    scored, every = score(weak, nominal, worst), score(weak, nominal)
    more = every.value - max(np.log(ratio) for ratio in every.ratios.values())  # of effort and what is not damped
    assert scored.value - more == pytest.approx(max(np.mean(sorted(row, reverse=True)[:counted]) for row in each))
    assert (scored.ratios, scored.undamped) == (every.ratios, every.undamped)


def test_groups_are_what_the_study_lists(monkeypatch: pytest.MonkeyPatch) -> None:
    """The plain run of training is one by itself."""
    monkeypatch.setattr(scoring, "run", lambda *_: Figures(1.0, {}, 0.0, damped=True))
    groups = Counter(draw.group for draw in draws("smib", None, 1 + 2 * 16, "search_smib_groups"))
    assert groups.pop(()) == 1
    assert groups == dict.fromkeys(product([0.02, 0.5], [6, 1000], [840, 1260, 1620, 2050]), 2)


@pytest.mark.usefixtures("each_run_once")
def test_by_medians_the_largest_of_any_index_in_any_group_counts() -> None:
    groups: list[tuple[int, ...]] = [(), (1,), (2,), (1,), (2,), (1,)]
    against = [draw._replace(group=group) for draw, group in zip(draws("smib", None, 6), groups, strict=True)]
    weak = Controller(name="LLC", parameters={"gain": 50.0})
    table = pd.DataFrame(
        {"group": str(draw.group), "index": name, "log": np.log(indices[name] / draw.reference.indices[name])}
        for draw in against
        for indices in [scoring.run(draw.content, weak).indices]
        for name in INDICES
    )
    medians = table.groupby(["group", "index"])["log"].median()
    scored, every = score(weak, against, medians=True), score(weak, against)
    more = every.value - max(np.log(ratio) for ratio in every.ratios.values())  # of effort and what is not damped
    assert scored.value - more == pytest.approx(medians.max())
    assert medians.max() > table.groupby("index")["log"].mean().max() + 0.01  # so that it matters which counts
    assert medians.max() < table["log"].max() - 0.01
    assert (scored.ratios, scored.undamped) == (every.ratios, every.undamped)


def test_lost_run_counts_more_than_any_other_and_the_earlier_the_more(nominal: list[Draw]) -> None:
    values = [
        score(Controller(name="LLC", parameters={"gain": gain}), draws("two_area", None, 1)).value
        for gain in (-20.0, -50.0)
    ]
    assert LOST < values[0] < values[1] < 2 * LOST


# What is searched


def test_structures_of_a_search_have_all_pairs_schemes_and_devices() -> None:
    all_structures = structures(load_system("two_area"), [], [])
    assert len(all_structures) == len(set(all_structures)) == 2 * (1 + 2 * len(ANTECEDENTS) * len(CONSEQUENTS))
    assert {structure.devices for structure in all_structures} == {("sssc",), ("sssc", "statcom")}
    assert {structure.devices for structure in structures(load_system("smib"), [], [])} == {("sssc",)}


@pytest.mark.parametrize("scheme", ["direct", "indirect"])
def test_networks_of_one_scheme_alone_are_searched_beside_llc_tuned(scheme: Scheme) -> None:
    every = structures(load_system("two_area"), [], [])
    selected = structures(load_system("two_area"), [], [], scheme)
    assert selected == [structure for structure in every if structure.scheme in (None, scheme)]
    assert len(selected) == 2 * (1 + len(ANTECEDENTS) * len(CONSEQUENTS))


@pytest.mark.parametrize(
    ("name", "scheme", "devices"),
    [
        ("LLC-tuned", None, ("sssc", "statcom")),
        ("gaussian+morlet", "direct", ("sssc",)),
        ("b-spline+fourier", "indirect", ("sssc", "statcom")),
    ],
)
def test_chosen_parameters_are_within_their_allowed_ranges(name: str, scheme: Scheme, devices: tuple[str, ...]) -> None:
    choice, random = Choice(Structure(name, scheme, devices), "two_area", CHOICES["free"]), np.random.default_rng(1)
    row, seen = kind(name), set()
    for at in [np.zeros(choice.size), np.ones(choice.size), *random.random((30, choice.size))]:
        proposed = choice.controller(at)
        seen.add(proposed.compensation)
        for key, value in proposed.parameters.items():
            p = row.parameters[key]
            for number in value if isinstance(value, list) else [value]:
                assert number in p.choices if p.choices else p.low <= float(str(number)) <= p.high, key
    assert seen == {"none", "lead", "phasor", *(["prediction"] if scheme == "indirect" else [])}


@pytest.mark.parametrize("devices", [("sssc",), ("sssc", "statcom")])
@pytest.mark.parametrize(
    ("name", "scheme"), [("LLC-tuned", None), ("gaussian+morlet", "direct"), ("b-spline+fourier", "indirect")]
)
def test_parameters_have_the_place_that_they_came_from(name: str, scheme: Scheme, devices: tuple[str, ...]) -> None:
    choice, random = Choice(Structure(name, scheme, devices), "two_area"), np.random.default_rng(2)
    for at in random.random((20, len(choice.space.ranges))):
        values = choice.space.parameters(at, choice.plant, choice.limit)
        again = choice.space.parameters(
            choice.space.place(values, choice.plant, choice.limit), choice.plant, choice.limit
        )
        assert_close(again, values)


@pytest.mark.usefixtures("each_run_once")
@pytest.mark.parametrize("scheme", ["direct", "indirect"])
def test_start_from_tuned_parameters_has_the_tuned_controller_among_its_points(scheme: Scheme) -> None:
    tuned = Controller.model_validate({"name": "ANFBsC", "scheme": scheme})
    same = Structure("b-spline+singleton", scheme, ("sssc",))
    choice, against = Choice(same, "smib"), draws("smib", None, 1)
    best = min(score(choice.controller(at), against).value for at in choice.starts("tuned"))
    assert best <= score(tuned, against).value + 1e-4  # parameters have four digits
    task = SearchTask("smib", None, (), 1, 4, start="tuned")
    assert study.climb(task, Rung(0, against, 1), Entry(same)).scores[0].value <= best


@pytest.mark.parametrize("name", BEST)
def test_start_from_a_run_is_its_controller_guards_included(name: str) -> None:
    case = load_case(name)
    controller = case.run.controllers[0]
    choice = Choice(Structure(controller.name, controller.scheme, tuple(controller.devices)), case.system.name)
    (at,) = choice.starts(name)
    again = choice.controller(at).parameters
    assert_close(again, controller.parameters)


def test_lead_lag_of_both_devices_may_be_started_from() -> None:
    """It takes fewer signals than the networks beside it."""
    every = structures(load_system("two_area"), [], ["sssc", "statcom"])
    assert [structure.name for structure in every if started("lead_lag_two_area", "two_area", structure)] == [
        "LLC-tuned"
    ]


def test_other_first_points_are_about_those_of_the_start(monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[NDArray[np.float64]] = []

    def recorded(_objective: object, population: NDArray[np.float64], *_: object) -> Found:
        seen.append(population)
        return Found(population[0], 0.0, population)

    monkeypatch.setitem(METHODS, "recorded", recorded)
    task = SearchTask("smib", None, (), 1, 4, start="best_smib", deviation=0.01, method="recorded")
    against, network = draws("smib", None, 1), Structure("b-spline+morlet", "direct", ("sssc",))
    lead_lag = Structure(REFERENCE, None, ("sssc",))  # of which that run has none: from the hypercube
    for structure, about in ((network, task), (network, task._replace(deviation=None)), (lead_lag, task)):
        study.climb(about, Rung(0, against, 1), Entry(structure))
    (at,) = Choice(network, "smib").starts("best_smib")
    for population in seen[:2]:
        np.testing.assert_array_equal(population[0], at)
    widths = [population.std(axis=0).mean() for population in seen]
    assert widths == pytest.approx([0.01, 0.29, 0.29], rel=0.1)
    np.testing.assert_allclose(seen[0].mean(axis=0), at, atol=0.005)


# The procedure


def test_best_quarter_goes_on_and_llc_tuned_to_the_end(monkeypatch: pytest.MonkeyPatch) -> None:
    """Scores of each rung from a hash of the structure: who is where follows by sorting."""
    asked: list[tuple[int, int, int]] = []  # rung, draws, generations

    def value(structure: Structure, number: int) -> float:
        return float(np.random.default_rng([number, *map(ord, "".join(map(str, structure)))]).random())

    def climb(_task: SearchTask, rung: Rung, entry: Entry) -> Entry:
        asked.append((rung.number, len(rung.draws), rung.generations))
        rung_score = Score(value(entry.structure, rung.number), {}, 0.0)
        return entry._replace(controller=Controller(), scores=(*entry.scores, rung_score))

    def judge(_task: SearchTask, against: Sequence[int], entry: Entry) -> Entry:
        last = GROWTH ** (maximum - 1)
        assert list(against) == list(range(last, last + GROWTH * last))  # no rung had them
        return entry._replace(scores=(*entry.scores, Score(value(entry.structure, 99), {}, 0.0)))

    monkeypatch.setattr(study, "climb", climb)
    monkeypatch.setattr(study, "judge", judge)
    monkeypatch.setattr(study, "draws", lambda _system, _link, number, *_: list(range(number)))
    every = structures(load_system("smib"), [], [])
    maximum = rungs(len(every))
    entries = search(SearchTask("smib", None, (), 9600, 1), [], 1, quiet)
    assert {entry.structure for entry in entries} == set(every)
    left = [structure for structure in every if not structure.is_reference]
    assert [len(left) // KEPT**number for number in range(maximum)] == [64, 16, 4]
    for number in range(maximum):
        there = {
            entry.structure for entry in entries if len(entry.scores) > number and not entry.structure.is_reference
        }
        assert there == set(left)
        left = sorted(left, key=lambda structure: value(structure, number))[: len(left) // KEPT]
    assert entries[0].scores[-1].value == min(e.scores[-1].value for e in entries if len(e.scores) == maximum + 1)
    (opponent,) = [entry for entry in entries if entry.structure.is_reference]
    assert len(opponent.scores) == maximum + 1
    # An equal fraction of the budget a rung: 3200 runs of 65, 17 and 5 structures on 1, 2 and 4 draws, 16 a generation.
    assert sorted(set(asked)) == [(0, 1, 3), (1, 2, 6), (2, 4, 10)]


def test_search_that_keeps_all_gives_each_structure_the_same_budget(monkeypatch: pytest.MonkeyPatch) -> None:
    asked = Counter[tuple[Any, ...]]()

    def climb(_task: SearchTask, rung: Rung, entry: Entry) -> Entry:
        asked.update([(*entry.structure[:2], rung.number, len(rung.draws), rung.generations)])
        return entry._replace(controller=Controller(), scores=(*entry.scores, Score(0.0, {}, 0.0)))

    monkeypatch.setattr(study, "climb", climb)
    monkeypatch.setattr(study, "judge", lambda _task, _against, e: e._replace(scores=(*e.scores, e.scores[-1])))
    monkeypatch.setattr(study, "draws", lambda _system, _link, number, *_: list(range(number)))
    task = SearchTask("two_area", None, ("sssc",), 57600, 1, cases=2, keep_all=True, compensation="some")
    entries = search(task._replace(profile="deployment"), ["gaussian+sam", "LQG", "ANFTSC"], 1, quiet)
    who = [("LLC-tuned", None), *product(["gaussian+sam", "ANFTSC"], ["direct", "indirect"])]  # LQG has none
    assert Counter((entry.structure.name, entry.structure.scheme) for entry in entries) == Counter(who)
    rungs_of_all = [(0, 2, 120), (1, 4, 60), (2, 8, 30)]  # 3840 runs of each in each rung, 16 a generation
    assert asked == Counter(who_structure + rung for who_structure in who for rung in rungs_of_all)


def test_in_another_profile_signals_are_its_and_the_reference_may_be_no_control() -> None:
    profile_structures = structures(load_system("two_area"), ["LQG"], [], None, "deployment")
    assert [structure.signals for structure in profile_structures] == [
        ["frequency"],
        ["frequency"],
        ["frequency"],
        ["frequency", "power"],
    ]
    against = draws("two_area", None, 2, None, "deployment", "none")
    assert [draw.group for draw in against] == [("fault and trip, west",), ("mechanical power step",)]
    assert {draw.content["profile"] for draw in against} == {"deployment"}
    assert {draw.reference.effort for draw in against} == {0.0}
    weak = Controller(name="LLC", signals=["frequency"], parameters={"gain": 0.0})
    assert score(weak, against).value == pytest.approx(0.0, abs=1e-3)


@pytest.mark.usefixtures("few_points")
def test_tuned_file_of_a_search_is_taken_by_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    out = tmp_path / "tuned.yaml"
    arguments = ["two_area", "Hinf", "--profile", "deployment", "--against", "none", "--devices", "sssc", "--keep-all"]
    monkeypatch.setattr(study, "RUNGS", 1)
    assert main(["search", *arguments, "--budget", "1", "--jobs", "1", "--tuned", str(out)]) == 0
    tuned_file = check(Tuned, files.read_table(out), "test")
    assert (tuned_file.profile, tuned_file.signals, tuned_file.devices) == ("deployment", ["frequency"], ["sssc"])
    assert {row.name for row in tuned_file.controllers} == {"LLC-tuned", "Hinf"}
    mine = {"two_area_deployment_mine": out}
    monkeypatch.setattr(files, "shipped", lambda kind: mine if kind == "controllers" else shipped(kind))
    for row in tuned_file.controllers:
        (controller,) = load_case(None, ["profile=deployment", f"controllers.0.name={row.name}"]).controllers
        assert {name: controller.parameters[name] for name in row.parameters} == row.parameters


def test_same_seed_gives_the_same_in_any_process_and_another_another(monkeypatch: pytest.MonkeyPatch) -> None:
    def short(*asked: Any) -> list[Draw]:
        return [draw._replace(content=draw.content | {"duration": 3.0}) for draw in draws(*asked)]

    def from_copies(function: Callable[[Any], Any], todo: Sequence[Any], *_: Any) -> list[Any]:
        """As processes have them, the last one first."""
        return [make(item) for make, item in pickle.loads(pickle.dumps([(function, item) for item in todo]))[::-1]][
            ::-1
        ]

    monkeypatch.setattr(study, "draws", short)
    task, names = SearchTask("smib", "pdci_100ms", (), 1, 4, scheme="indirect"), ["gaussian+sam"]
    first = search(task, names, 1, quiet)
    other = search(task._replace(seed=5), names, 1, quiet)
    monkeypatch.setattr(study, "run_all", from_copies)
    again = search(task, names, 2, quiet)
    results = [[(e.structure, e.controller, e.scores) for e in entries] for entries in (first, again, other)]
    assert results[0] == results[1] != results[2]
    for entry, two in zip(first, again, strict=True):
        np.testing.assert_array_equal(entry.population, two.population)


@pytest.mark.usefixtures("few_points")
def test_rung_goes_on_from_the_population_of_the_one_before(nominal: list[Draw]) -> None:
    """On the same draws nothing is lost: the best is at least as good."""
    task, entry = SearchTask("smib", None, (), 1, 4), Entry(Structure("LLC-tuned", None, ("sssc",)))
    first = study.climb(task, Rung(0, nominal[:1], 1), entry)
    second = study.climb(task, Rung(1, nominal[:1], 2), first)
    assert second.scores[1].value <= first.scores[0].value
    assert second.scores[1] == score(second.controller or Controller(), nominal[:1])


@pytest.mark.usefixtures("few_points")
def test_search_reads_the_training_scenario_alone_and_writes_a_valid_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    read, plain = list[Path](), files.read_yaml

    def recorded(path: Path) -> object:
        read.append(path)
        return plain(path)

    monkeypatch.setattr(files, "read_yaml", recorded)
    out, other, json_path = tmp_path / "best.yaml", tmp_path / "lead_lag.yaml", tmp_path / "told.json"
    written = ["--out", str(out), "--lead-lag", str(other), "--json", str(json_path)]
    options = ["--link", "pdci_100ms", "--medians", "--method", "cma-es", "--scheme", "indirect", *written]
    assert main(["search", *TINY, *options]) == 0
    assert {path.stem for path in read if path.parent.parent.name == "scenarios"} == {"training"}
    monkeypatch.undo()
    assert f"run: {out}" in capsys.readouterr().out
    ranking = json.loads(json_path.read_text())["ranking"]
    assert [row["rank"] for row in ranking] == [1, 2]
    names = {(row["controller"], row["scheme"]) for row in ranking}
    assert names == {("LLC-tuned", None), ("gaussian+sam", "indirect")}
    assert ranking[0]["scores"][-1] == min(row["scores"][-1] for row in ranking)
    asked = "--link pdci_100ms --method cma-es --scheme indirect --medians --budget 1 --seed 4"
    assert out.read_text().startswith(f"# facts-damping search smib gaussian+sam {asked}\n")
    case = load_case(str(out))
    best = next(row for row in ranking if row["controller"] != REFERENCE)
    assert (case.controllers[0].name, case.run.link) == (best["controller"], "pdci_100ms")
    assert score(case.run.controllers[0], draws("smib", "pdci_100ms", 1)).value == best["scores"][0]
    assert load_case(str(other)).controllers[0].name == REFERENCE
    assert main(["simulate", str(out), "--set", "duration=2"]) == 0


def test_search_command_accepts_every_method() -> None:
    assert [parser().parse_args(["search", "smib", "--method", name]).method for name in METHODS] == list(METHODS)


@pytest.mark.usefixtures("few_points")
def test_without_a_file_the_run_of_the_best_network_is_told(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    json_path = tmp_path / "told.json"
    assert main(["search", *TINY, "--scheme", "direct", "--json", str(json_path)]) == 0
    text = capsys.readouterr().out
    path = tmp_path / "best.yaml"
    path.write_text(text[text.index("# facts-damping search") :])
    best = next(row for row in json.loads(json_path.read_text())["ranking"] if row["controller"] != REFERENCE)
    case = load_case(str(path))
    assert [(controller.name, controller.scheme, controller.parameters) for controller in case.run.controllers] == [
        (best["controller"], best["scheme"], best["parameters"])
    ]


@pytest.mark.parametrize("name", [name for name in shipped("studies") if name.startswith("ensemble_two_area")])
def test_draws_of_another_scenario_are_refused(name: str) -> None:
    scenario = name.removeprefix("ensemble_two_area_")
    if scenario == "training":
        assert scoring.ensemble("two_area", name).points
        return
    with pytest.raises(InputError, match=f"scenario: '{scenario}' given; allowed: training"):
        scoring.ensemble("two_area", name)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["kundur_12_6"], "SYSTEM: 'kundur_12_6' given without --study; allowed: smib, two_area, or a study"),
        (["smib", "PID"], "'PID' given; allowed: LLC"),
        (["smib", "LLC"], "'LLC' given; allowed: one with parameters to tune"),
        (["smib", "--devices", "svc"], "--devices: 'svc' given; allowed: sssc\n"),
        (["smib", "--devices", "sssc,statcom"], "--devices: 'statcom' given; allowed: sssc"),
        (["smib", "--link", "telegraph"], "'telegraph' given; allowed:"),
        (["smib", "--study", "monte_carlo"], "system: 'two_area' given; allowed: 'smib', the SYSTEM"),
        (["two_area", "--study", "monte_carlo"], "scenario: 'small' given; allowed: training of two_area"),
        (
            ["two_area", "--devices", "statcom"],
            "--devices: statcom given for two_area; allowed: sssc, sssc,statcom,",
        ),
        (["two_area", "--devices", "statcom", "--signals", "w99"], "--signals: 'w99' given"),
        (["two_area", "--signals", "w13"], "--signals: given without --devices"),
        (["smib", "--start", "nothing"], "--start: runs: 'nothing' given; allowed: best_smib"),
        (
            ["smib", "--start", "best_two_area"],
            "--start: 'best_two_area' given, a run of two_area; allowed: one of smib",
        ),
        (
            ["two_area", "--devices", "sssc", "--start", "best_two_area"],
            "allowed: one whose controllers command sssc with",
        ),
        (["smib", "--scheme", "indirect", "--start", "best_smib"], "(LLC-tuned), or sssc with speed (indirect)"),
        (["smib", "--cases", "0"], "0 given; allowed: 1 to 1000"),
        (["smib", "--worst", "0"], "0 given; allowed: 1 to 100"),
        (["smib", "--worst", "25", "--medians"], "argument --medians: not allowed with argument --worst"),
        (
            ["smib", "--deviation", "0.1"],
            "--deviation: 0.1 given with --start hypercube; allowed: with tuned, or a run",
        ),
        (["smib", "--profile", "deployment"], "SYSTEM: 'smib' given without --study; allowed: two_area"),
        (["smib", "--tuned", "mine.yaml"], "--tuned mine.yaml: given without --devices"),
        (["smib", "--against", "LQG"], "argument --against: 'LQG' given; allowed: LLC-tuned, none"),
        (["smib", "--compensation", "lead"], "argument --compensation: 'lead' given; allowed: free, none, some"),
        (["smib", "--deviation", "wide"], "wide given; allowed: 0.001 to 0.5"),
        (
            ["smib", "--method", "simplex"],
            "argument --method: 'simplex' given; allowed: differential-evolution, cma-es",
        ),
        (["smib", "--budget", "0"], "0 given; allowed: 1 to 1000000"),
        (["smib", "--out", "/nowhere/best.yaml"], "--out /nowhere/best.yaml: cannot be written"),
    ],
)
def test_bad_input_is_one_line_and_exit_2(arguments: list[str], said: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert_one_line(2, ["search", *arguments], said, capsys)


# What is shipped


@cache
def fresh_draws(task: SearchTask, structures: int) -> list[Draw]:
    """Draws that no rung of a search of so many structures has used; of many every ninth."""
    first = task.cases * GROWTH ** (rungs(structures) - 1)
    if first < MANY:
        return draws(task.system, task.link, first + GROWTH * first, task.study)[first:]
    plan = scoring.ensemble(task.system, task.study)
    points = plan.points[first - 1 : first + GROWTH * first - 1 : 9]  # before them there is the plain run of training
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(scoring, "ensemble", lambda *_: plan._replace(points=points))
        return draws(task.system, task.link, 1 + len(points), task.study)[1:]


@pytest.mark.parametrize("name", BEST)
def test_shipped_runs_reach_on_fresh_draws_what_they_say(name: str) -> None:
    text = shipped("runs")[name].read_text()
    case = load_case(name)
    said = re.search(r"no search had seen: score (-?[\d.]+);", text)
    assert said is not None
    asked = parser().parse_args(text.splitlines()[0].removeprefix("# facts-damping ").split())
    assert (asked.system, asked.link or "ideal") == (case.system.name, case.run.link)
    devices = asked.devices.split(",") if asked.devices else []
    task = SearchTask(
        **{
            **{key: value for key, value in vars(asked).items() if key in SearchTask._fields},
            "devices": devices,
            "signals": (),
        }
    )
    assert f"# {task.command(asked.controllers)}" == text.splitlines()[0]
    searched = structures(load_system(asked.system), asked.controllers, devices, asked.scheme)
    fresh = fresh_draws(SearchTask(asked.system, asked.link, (), 0, 0, asked.cases, asked.study), len(searched))
    scored = score(case.run.controllers[0], fresh, asked.worst, medians=asked.medians)
    assert scored.value == pytest.approx(float(said[1]), abs=0.02)
