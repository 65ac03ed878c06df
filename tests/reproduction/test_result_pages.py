"""Numbers in docs/results.md and the pages that it names are those of the tables beside them."""

from __future__ import annotations

import re
import shutil
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
import yaml

from facts_damping.analysis.summary import summarise
from facts_damping.case.loading import load_case
from facts_damping.simulation import loop
from facts_damping.small_signal import modal_tables
from facts_damping_reproduction import result_figures
from facts_damping_reproduction.adaptation.experiment import plan
from facts_damping_reproduction.inverters import comparison
from facts_damping_reproduction.pdci import pages
from facts_damping_studies.score.cases.sets import read_set

if TYPE_CHECKING:
    from collections.abc import Callable

DOCS = Path(__file__).parents[2] / "docs"
PAGES = ("results", "pdci", "inverters_results", "delay_results", "supervision_results", "reproduction")


def text(page: str) -> str:
    return " ".join((DOCS / f"{page}.md").read_text(encoding="utf-8").split())


def rows(table: str) -> list[dict[str, str]]:
    return result_figures.rows(DOCS / "images" / table)


@pytest.mark.parametrize("page", PAGES)
def test_fractions_are_those_of_their_counts(page: str) -> None:
    for part, whole, percent in re.findall(r"\b(\d+) of (\d+)(?: cases)? \(([\d.]+) %", text(page)):
        digits = len(percent.partition(".")[2])
        assert f"{100 * int(part) / int(whole):.{digits}f}" == percent, (part, whole)


@pytest.mark.parametrize("page", PAGES)
def test_tables_that_a_page_links_exist_and_have_rows(page: str) -> None:
    linked = re.findall(r"\]\((images/[^)]+)\)", text(page))
    assert linked
    for name in linked:
        assert (DOCS / name).stat().st_size > 100, name


def test_thesis_s_statements_hold_as_often_as_the_table_says() -> None:
    page = text("reproduction")
    for row in rows("reproduction/agreement.csv"):
        count, said = f"{row['here']} of {row['of']}", row["statement"]
        shown = count if said != "the same controller first in an order" else f"of {row['of']} orders"
        assert shown in page, said
    assert "first in 13." in page


def test_rates_of_supervision_are_those_of_the_campaigns() -> None:
    page = text("supervision_results")
    for campaign in ("do_no_harm", "wrong_control"):
        for row in rows(f"{campaign}/table_outcomes.csv")[1:]:
            number, percent = row["with supervision, number"], float(row["with supervision, percent"])
            assert f"{number} of {row['cases']}" in page or f"{number} ({percent:.2f} %)" in page, row
            assert re.search(rf"\b{row['without supervision, number']}\b", page), row
    assert of_wrong_signs("A wrong sign in the controller is found", "wrong_sign") in page
    assert of_wrong_signs("behind the supervisor", "wrong_sign_behind") in page
    for fault, name in (("wrong_sign", "in the controller"), ("wrong_sign_behind", "behind the supervisor")):
        row = next(row for row in rows("wrong_control/table_faults.csv") if row["fault"] == fault)
        cells = [row["armed"], f"{row['tripped']} tripped", row["median, s"], row["99 %, s"]]
        assert f"| wrong sign {name} | {' | '.join(cells)} |" in page
    total = rows("healthy/table_healthy.csv")[-1]
    for name in ("fell back or tripped", "costly"):
        number, percent = total[f"{name}, number"], float(total[f"{name}, percent"])
        assert re.search(rf"\b{number} .{{0,30}}\({percent:.2f} %\)", page), name
    for campaign, who in (("do_no_harm", "25 controllers"), ("healthy", "lead-lags and LQG")):
        for row in rows(f"{campaign}/table_cost.csv"):
            assert " | ".join([f"| {row['the controller']}, {who}", *list(row.values())[1:]]) in page


def test_delay_limits_are_those_of_the_studies() -> None:
    page = text("delay_results")
    for row in rows("deployment_margin/margins.csv"):
        if row["beyond"] != "low" and row["high_s"]:
            assert f"{row['margin_s']} [{row['low_s']}, {row['high_s']}]" in page
    margins = {tuple(row[k] for k in ("controller", "scheme", "scenario", "criterion")): row["margin_s"]
             for row in rows("delay_margin/margins.csv")}  # fmt: skip
    for name, scheme in (("LLC", ""), ("LLC-tuned", ""), ("ANFFsC", "indirect"), ("HBsWC", "direct")):
        pairs = [
            " / ".join(
                f"{float(margins[name, scheme, scenario, criterion]):.3f}" for criterion in ("not_damped", "unstable")
            )
            for scenario in ("small", "large", "multiple")
        ]
        assert f"| {' | '.join(pairs)} |" in page, name


def numbers(table: str) -> list[dict[str, Any]]:
    """A table with numbers, and none where a cell is empty."""
    return [{name: yaml.safe_load(value or "null") for name, value in row.items()} for row in rows(table)]


def test_page_on_the_pacific_dc_intertie_follows_from_its_tables() -> None:
    built = pages.page({name: numbers(f"pdci/{name}.csv") for name in (*pages.STUDIES, "tuned")})
    linked = re.sub(r"\]\(([a-z]+\.(?:png|csv))\)", r"](images/pdci/\1)", built)
    assert (DOCS / "pdci.md").read_text(encoding="utf-8") == linked


def change(
    arm: str, against: str, kinds: str, form: str = "+.0f", table: str = "deployment/what_holds.csv"
) -> tuple[str, str, str]:
    """A change of the index in per cent, with its interval."""
    wanted = {"arm": arm, "against": against, "event" if "event" in table else "kinds": kinds}
    row = next(line for line in rows(table) if wanted.items() <= line.items())
    ratio, low, high = (f"{100 * (float(row[name]) - 1):{form}}" for name in ("ratio", "low", "high"))
    return ratio, low, high


def reduction(*arms: str) -> str:
    """The range of the reductions of the index over the kinds of cases, `91 to 94 %`."""
    kinds = ("nominal", "drift", "wrong model")
    reductions = sorted(-int(change(arm, "no control", kind)[0]) for arm in arms for kind in kinds)
    return f"{reductions[0]} to {reductions[-1]} %"


def limit(study: str, **asked: str) -> list[float]:
    """The limits of a study in the rows that have these values."""
    table = rows(f"{study}/margins.csv")
    return [float(row["margin_s"]) for row in table if all(row[name] == value for name, value in asked.items())]


def rate(campaign: str, row: int, side: str, table: str = "outcomes") -> str:
    """A rate in per cent; rows of outcomes: 1, synchronism lost; 2, harm."""
    return rows(f"{campaign}/table_{table}.csv")[row][f"{side}, percent"]


def learning() -> tuple[str, str, str]:
    """The neuro-fuzzy controller that learns, against the best that is fixed, where the grid has moved."""
    return change("neuro-fuzzy", "LQG", "drift, wrong model")


def deployed(controller: str) -> str:
    """The additional delay that a controller keeps damped in the recommended run."""
    return f"{limit('deployment_margin', controller=controller, criterion='damping')[0]:.2f} s"


def interval(controller: str) -> str:
    """The same with its interval."""
    table = rows("deployment_margin/margins.csv")
    row = next(row for row in table if row["controller"] == controller and row["criterion"] == "damping")
    return f"{deployed(controller)} [{row['low_s']}, {row['high_s']}]"


def lost_runs(arm: str) -> str:
    """In how many runs of the experiment an arm loses synchronism."""
    (count,) = re.findall(rf"^\| {arm} \|.*\| (\d+ of \d+) \|", (DOCS / "what_holds.md").read_text(), re.MULTILINE)[:1]
    return str(count)


def least_damped() -> float:
    """The lowest damping ratio of two_area, as deployed, without control."""
    case = load_case("two_area_deployment", ["controllers=[]", "supervision=null", "arm_at=null"])
    return min(mode.damping_ratio for mode in modal_tables.analyse(case.system, case.run.devices).modes if mode.swings)


def of_what_holds() -> list[str]:
    repeated = len(
        re.findall(r"\bseed \d\b", (DOCS / "what_holds.md").read_text(encoding="utf-8").split("decide so")[0])
    )
    ratio, low, high = learning()
    percent, less, more = change("neuro-fuzzy", "neuro-fuzzy, not learning", "drift, wrong model")
    llc = reduction("LLC")
    return [
        f"In {repeated * plan()['evaluation']['cases']} unseen cases",
        f"an LQG reduces the ITAE by {reduction('LQG')}, a tuned lead-lag by {reduction('LLC-tuned')}",
        f"the lead-lag of the thesis, by {llc}",
        f"is {ratio.lstrip('+')} % [{low}, {high}] above that of an LQG",
        f"is {percent.lstrip('-')} % [{less}, {more}] below that",
    ]


def of_the_score() -> list[str]:
    first, second = [row for row in rows("score/ranking.csv") if row["group"] == "1"]
    words = {"Hinf": "an H-infinity controller", "LQG": "an LQG"}
    percents = [f"{words[row['controller']]} ({-float(row['percent']):.0f} %)" for row in (first, second)]
    return [f"In {len(read_set('two_area_2.0').cases)} harder cases", f"{' and '.join(percents)} are best"]


def of_delays() -> list[str]:
    exact = [
        value
        for name in ("LLC", "LLC-tuned")
        for value in limit("delay_margin", controller=name, criterion="not_damped")
    ]
    ideal, m_class = (
        1e3 * limit("measurement_margin", controller="LLC", criterion="not_damped", **{"class": name})[0]
        for name in ("ideal", "M")
    )
    return [
        f"above 3 % with up to {deployed('LLC-tuned')} of additional delay, `LLC` with {deployed('LLC')}",
        f"(without control the least is {100 * least_damped():.1f} %)",
        f"no swing grows with either up to {min(exact):.2f} to {max(exact):.2f} s",
        f"reduces its delay limit of {ideal:.0f} ms by {round(ideal - m_class, -1):.0f} ms",
    ]


def of_wrong_signs(place: str, fault: str) -> str:
    """How soon a wrong sign is found, in how many of the cases."""
    row = next(row for row in rows("wrong_control/table_faults.csv") if row["fault"] == fault)
    return f"{place} in {row['median, s']} s ({row['tripped']} of {row['armed']}"


def of_supervision() -> list[str]:
    harm = [[f"{float(rate(name, row, f'{side} supervision')):.2f}" for side in ("with", "without")]
            for name in ("do_no_harm", "wrong_control") for row in (1, 2)]  # fmt: skip
    costs = [rows(f"{name}/table_cost.csv")[0] for name in ("healthy", "do_no_harm")]
    ends = sorted(f"{100 * (float(row['99 %']) - 1):.0f}" for row in costs)
    return [
        f"lose it in {harm[0][0]} % ({harm[0][1]} % without supervision)",
        f"more than 5 % too large in {harm[1][0]} % ({harm[1][1]} %)",
        f"these are {harm[2][0]} % ({harm[2][1]} %) and {harm[3][0]} % ({harm[3][1]} %)",
        *(
            f"{float(rate(name, -1, 'fell back or tripped', 'healthy')):.2f} %{more}, "
            f"{float(rate(name, -1, 'costly', 'healthy')):.2f} % at a cost"
            for name, more in (("healthy", " of the cases without a fault"), ("do_no_harm", ""))
        ),
        f"about {round(100 * (float(costs[0]['ITAE beside no supervision, median']) - 1))} % higher in the median",
        f"{ends[0]} to {ends[1]} % at the 99th percentile",
        f"among {len(rows('do_no_harm/table_controllers.csv'))} controllers",
    ]


def of_the_thesis() -> list[str]:
    counts = {row["statement"]: (row["here"], row["of"]) for row in rows("reproduction/agreement.csv")}
    here, of = counts["better than LLC"]
    better, cases = map(int, counts["better than LLC-tuned, medians over random cases"])
    assert round(3 * (1 - better / cases)) == 1  # "in a third of the cases"
    return [
        f"{here} of {of} have the same sign",
        *re.findall(r"rank correlation .{0,40}is (0\.\d\d)", text("reproduction"))[:1],
    ]


def of_validation() -> list[str]:
    comparisons = [row for row in result_figures.rows(DOCS / "validation.csv") if row["passed"] != "open"]
    assert all(row["passed"] == "pass" for row in comparisons)
    times = sorted(float(row["times ours"]) for row in rows("programs.csv")[1:])
    return [f"All {len(comparisons)} comparisons", f"take {times[0]:.1f} to {times[-1]:.0f} times as long"]


def traces_of_psse() -> str:
    """How many columns of traces agree within 1 % of the swing; the others within 10 %."""
    rows_of_traces = [
        row
        for row in result_figures.rows(DOCS / "validation.csv")
        if row["table"] == "Runs of files of PSS/E" and row["passed"] != "open"
    ]
    assert max(float(row["difference"]) for row in rows_of_traces) <= 0.1
    agreeing = sum(row["tolerance"] == "1.0e-02" and not row["cause"] for row in rows_of_traces)
    columns = f"of {len(rows_of_traces)} columns of PSS/E's traces (one of PowerWorld's)"
    return f"{columns} {agreeing} agree within 1 % of the swing"


def of_pdci() -> list[str]:
    pdci = pages.values(*(numbers(f"pdci/{name}.csv") for name in ("linear", "events", "failures")))
    assert pdci["supervised"] == "wrong sign in the controller, wrong sign behind the supervisor"
    damping = (
        f"{pdci['gain']} MW/mHz over 100 ms of delay raise the damping ratio of north-south B from {pdci['b_free']}"
    )
    return [f"{damping} to {pdci['b_law']}", f"up to {pdci['limit']} no slow mode loses damping"]


def of_inverters() -> list[str]:
    modes, arms = numbers("inverters/modes.csv"), numbers("inverters/comparison.csv")
    half = [row for row in modes if row["share"] == 0.5 and row["stabilisers"] == "one an area"]
    ratios = {(row["kind"], row["place"]): f"{100 * row['interarea']:.1f} %" for row in half}
    less = {row["arm"]: f"{100 * (1 - row['ratio']):.0f} %" for row in arms if row["against"] == "no control"}
    unstable = {row["arm"] for row in arms if row["growth"] > 0.0}
    assert unstable == {"SSSC"}
    both, sending = ({kind: ratios[kind, place] for kind in ("following", "droops", "virtual machine")}
                     for place in ("both areas", "sending area"))  # fmt: skip
    many = len(comparison.cases())
    return [
        f"has a damping ratio of {both['following']}, in the sending area alone of {sending['following']}",
        f"{both['droops']} with droops and {both['virtual machine']} as virtual machines",
        f"In {many} unseen cases power oscillation damping by active power reduces the ITAE by {less['POD-P']}",
        f"by reactive power by {less['POD-Q']}, an SSSC by {less['SSSC']}",
        f"virtual machines without control by {less['virtual machines']}",
    ]


SAID = (of_what_holds, of_the_score, of_pdci, of_inverters, of_delays, of_supervision, of_the_thesis, of_validation)
# Conditions, not results: faults that cases have; tolerances of rows of validation.csv.
GIVEN = (r"up to 400 ms more", r"bursts of 1 s", r"within 1e-5 to 1e-4 1/s")


@pytest.mark.parametrize("statements", SAID, ids=lambda statement: statement.__name__)
def test_statements_of_the_summary_are_those_of_the_tables(statements: Callable[[], list[str]]) -> None:
    page = text("results")
    for statement in statements():
        assert statement in page, statement


def test_numbers_of_the_results_summary_are_in_checked_statements() -> None:
    answers = "\n".join(
        re.findall(r"^\| [^|]+\? \| ([^|]+) \|", (DOCS / "results.md").read_text(encoding="utf-8"), re.MULTILINE)
    )
    for known in [*(re.escape(statement) for statements in SAID for statement in statements()), *GIVEN]:
        answers = re.sub(known, "", answers)
    assert not re.findall(r".{0,30}\d.{0,30}", answers)


def test_findings_of_readme_are_those_of_the_tables() -> None:
    readme = " ".join(
        (DOCS.parent / "README.md")
        .read_text(encoding="utf-8")
        .split("## What was found")[1]
        .split("## Limits")[0]
        .split()
    )
    ratio, low, high = (value.lstrip("+") for value in learning())
    drawn = change("neuro-fuzzy", "LQG", "kinds drawn, too", ".0f", table="deployment/by_event.csv")
    trips, costly = (float(rate("healthy", -1, name, "healthy")) for name in ("fell back or tripped", "costly"))
    lost, alone = (float(rate("wrong_control", 1, f"{side} supervision")) for side in ("with", "without"))
    cases = rows("wrong_control/table_outcomes.csv")[1]["cases"]
    (seeds,) = {row["seeds"] for row in rows("deployment_margin/margins.csv")}
    known = [
        *of_what_holds()[:1],
        f"reduces the ITAE of the response by {reduction('LQG', 'LLC-tuned')}",
        f"in {lost_runs('LLC-tuned')} runs of either",
        f"is {ratio} % [{low}, {high}] worse than LQG",
        f"with the kinds drawn, too, {drawn[0]} % [{drawn[1]}, {drawn[2]}] (one seed",
        f"damping ratio of 3 % with up to {interval('LLC-tuned')} of additional delay",
        f"the thesis's with {interval('LLC')}",
        f"(medians of {seeds} seeds; the intact grid has {100 * least_damped():.1f} % without control)",
        f"trips {trips:.1f} % of {rows('healthy/table_outcomes.csv')[0]['cases']} healthy runs of lead-lags and LQG",
        f"{costly:.1f} % at a cost",
        f"Of {cases} cases with wrong control",
        of_wrong_signs("A wrong sign in the controller is found", "wrong_sign"),
        of_wrong_signs("behind the supervisor", "wrong_sign_behind"),
        f"{lost:.1f} % lose it instead of {alone:.1f} %",
        f"{traces_of_psse()}, the others within 10 % with",
    ]
    assert lost_runs("LLC-tuned") == lost_runs("LQG")
    for statement in known:
        assert statement in readme, statement
        readme = readme.replace(statement, "")
    assert re.findall(r"\d[\w.-]*", readme) == ["1e-4", "1", "16", "68"]  # validation: ANDES, the largest grid


def test_first_figures_of_readme_are_those_of_twenty_seeds() -> None:
    def itae(seed: int, *fields: str) -> float:
        summary = summarise(loop.run(load_case("two_area_deployment", [f"seed={seed}", *fields])), method=None)
        return float((summary.indices or {})["ITAE"])

    seeds, readme = range(1, 21), " ".join((DOCS.parent / "README.md").read_text(encoding="utf-8").split())
    free = np.array([itae(seed, "controllers=[]", "supervision=null", "arm_at=null") for seed in seeds])
    for sets, said in (
        ([], "by {} % (median of 20 runs with other noise, {} to {} %)"),
        (["link.up.1.delay=253 ms"], "250 ms more delay, by {} % ({} to {} %)"),
    ):
        less = 100.0 * (1.0 - np.array([itae(seed, *sets) for seed in seeds]) / free)
        assert said.format(*(f"{figure:.0f}" for figure in (np.median(less), less.min(), less.max()))) in readme


@pytest.mark.parametrize("row", rows("reference_llc.csv")[1::5], ids=lambda row: f"{row['system']} {row['scenario']}")
def test_reference_results_are_those_of_runs(row: dict[str, str]) -> None:
    sets = [f"system={row['system']}", f"scenario={row['scenario']}"]
    sets += ["controllers=[]"] if row["controller"] == "none" else [f"link.up.0.delay={row['delay_s']}"]
    indices = summarise(loop.run(load_case(None, sets))).indices or {}
    for name in ("ITAE", "IAE", "ITSE", "ISE"):
        if row[name]:
            assert indices[name] == pytest.approx(float(row[name]), rel=1e-3), name


def test_figures_are_drawn_from_the_tables(tmp_path: Path) -> None:
    for table in (DOCS / "images").glob("*/*.csv"):
        (tmp_path / table.parent.name).mkdir(exist_ok=True)
        shutil.copy(table, tmp_path / table.parent.name)
    result_figures.main(tmp_path)
    drawn = {path.name for path in (tmp_path / "results").iterdir()}
    assert drawn == {path.name for path in (DOCS / "images" / "results").iterdir()}
