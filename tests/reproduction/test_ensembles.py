from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from scipy import stats

from facts_damping.neurofuzzy.table import VARIANTS
from facts_damping_reproduction import ensembles
from facts_damping_reproduction.agreement import ComparedRun, name
from facts_damping_reproduction.printed import DIRECT, LLC, SCENARIOS, ControllerId, cells
from facts_damping_reproduction.ranking import rho
from facts_damping_reproduction.runs import BASELINES, FIGURES

NETWORKS = [ControllerId("MISO", network, "direct") for network in VARIANTS]
EVERYBODY = [*BASELINES, *NETWORKS]


def rows(system: str, scenario: str, draws: int, seed: int) -> list[dict[str, Any]]:
    """Made-up rows of an ensemble; a run now and then is unstable, another fails."""
    random = np.random.default_rng(seed)
    drawn = []
    for draw in range(draws):
        for who in EVERYBODY:
            bad = random.random() < 0.03
            row = {"system": system, "scenario": scenario, "who": name(who), "draw": draw}
            row |= {"stable": not bad, "error": "why" if random.random() < 0.01 else None}
            drawn.append({**row, **{quantity: None if bad else float(random.lognormal()) for quantity in FIGURES}})
    return drawn


@pytest.mark.parametrize("n", [6, 25, 100])
def test_interval_of_a_median_is_that_of_order_statistics(n: int) -> None:
    random = np.random.default_rng(n)
    for _ in range(20):
        x = random.standard_cauchy(n)
        interval = stats.quantile_test(x, p=0.5).confidence_interval(0.95)
        assert ensembles.median(x) == pytest.approx((np.median(x), interval.low, interval.high))


def test_interval_of_a_median_covers_it() -> None:
    random = np.random.default_rng(1)
    intervals = [ensembles.median(random.exponential(size=100)) for _ in range(4000)]
    covered = np.mean([interval.low <= np.log(2.0) <= interval.high for interval in intervals])
    assert 0.95 <= covered <= 0.975  # discrete: never less than asked for


def test_too_few_values_have_no_interval() -> None:
    assert ensembles.median(np.array([3.0, 1.0, 2.0])) == (2.0, -np.inf, np.inf)


def test_improvement_draw_by_draw() -> None:
    inf = np.inf
    percent = ensembles.improvements(np.array([2.0, 2.0, inf, inf, 4.0]), np.array([1.0, 3.0, 1.0, inf, inf]))
    assert list(percent) == [50.0, -50.0, 100.0, 0.0, -inf]


def test_spreads_are_what_numpy_says_of_the_draws() -> None:
    drawn = rows("smib", "light", 40, 2)
    spreads = {(spread.who, spread.quantity): spread for spread in ensembles.spreads(drawn, "ideal")}
    assert len(spreads) == len(EVERYBODY) * len(FIGURES)
    for who in EVERYBODY:
        draws_of_who = [row for row in drawn if row["who"] == name(who)]
        llc = [row for row in drawn if row["who"] == name(LLC)]
        good = np.array([row["ISE"] if row["stable"] and not row["error"] else np.inf for row in draws_of_who])
        reference = np.array([row["ISE"] if row["stable"] and not row["error"] else np.inf for row in llc])
        index_spread = spreads[name(who), "ISE"]
        assert index_spread.unstable == np.isinf(good).sum()
        assert index_spread.figure.median == np.median(good)
        both = np.isfinite(good) & np.isfinite(reference)
        over = np.where(np.isinf(reference), np.where(np.isinf(good), 0.0, 100.0), -np.inf)
        over[both] = 100.0 * (reference[both] - good[both]) / reference[both]
        assert index_spread.over_llc.median == pytest.approx(np.median(over))
    assert sum(spreads[name(who), "IAE"].best for who in EVERYBODY) == pytest.approx(1.0)


def test_cells_by_medians() -> None:
    tables = [cell for cell in cells(("4.1",)) if cell.scenario == "light"]
    ensemble = {("smib", "light"): rows("smib", "light", 31, 3)}
    for c in ensembles.compare(tables, ensemble):
        own_rows, over = (
            [row for row in ensemble["smib", "light"] if row["who"] == name(who)]
            for who in (c.cell.who, c.cell.against or LLC)
        )
        pairs = [
            100.0 * (b[c.cell.quantity] - a[c.cell.quantity]) / b[c.cell.quantity]
            for a, b in zip(own_rows, over, strict=True)
            if a["stable"] and b["stable"] and not a["error"] and not b["error"]
        ]
        assert min(pairs) <= (c.ours or 0.0) <= max(pairs)
        assert c.difference == pytest.approx((c.ours or 0.0) - c.cell.corrected)


def figures(order: Callable[[str, int], float]) -> dict[ComparedRun, dict[str, float] | None]:
    """Figures of networks by a function of scenario and place."""
    return {
        ComparedRun("smib", scenario, who): dict.fromkeys(FIGURES, float(order(scenario, i)))
        for scenario in SCENARIOS["smib"].values()
        for i, who in enumerate(NETWORKS)
    }


def test_ranking_that_one_scenario_decides_is_said_to_be_so() -> None:
    same = figures(lambda _, i: i)
    assert {(decision.first, decision.deciding) for decision in ensembles.decided(same)} == {(name(DIRECT), ())}
    # The second is a place behind in three scenarios; in the light one the first is last.
    turned = figures(lambda scenario, i: 20 if scenario == "light" and i == 0 else i)
    assert {(decision.first, decision.deciding) for decision in ensembles.decided(turned)} == {
        (name(NETWORKS[1]), ("light",))
    }


def test_firm_and_loose_orders() -> None:
    plain, random = figures(lambda _, i: i + 1.0), np.random.default_rng(4)
    firm, loose = [], []
    for _ in range(60):
        for i, who in enumerate(NETWORKS):
            row = {"system": "smib", "scenario": "light", "who": name(who), "stable": True, "error": None}
            firm.append({**row, **dict.fromkeys(FIGURES, i + 1.0)})
            loose.append({**row, **dict.fromkeys(FIGURES, float(random.random()))})
    for order in ensembles.firmness(plain, {("smib", "light"): firm}):
        assert (order.first_in_draws, order.rho, order.rho_in_draws) == pytest.approx((1.0, 1.0, 1.0))
        assert order.first == order.first_of_medians == name(DIRECT)
    for order in ensembles.firmness(plain, {("smib", "light"): loose}):
        assert order.first_in_draws < 0.4
        assert abs(order.rho_in_draws) < 0.2


def test_rank_correlation_is_scipys() -> None:
    random = np.random.default_rng(5)
    for _ in range(20):
        a, b = random.integers(0, 6, 11).astype(float), random.integers(0, 6, 11).astype(float)
        assert rho(a, b) == pytest.approx(stats.spearmanr(a, b).statistic)
    assert rho(np.ones(4), np.arange(4.0)) is None
