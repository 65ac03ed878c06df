"""Effects, draw by draw: ratios, intervals that cover, what is lost and kept."""

from __future__ import annotations

import numpy as np
import pytest
from facts_damping_reproduction.paired import MINIMUM, Effect, agree, by_draw, effect


def rows(values: list[float | None], event: str = "a") -> list[dict[str, object]]:
    """A row a draw; None: synchronism is lost."""
    return [{"seed": i, "event": event, "ITAE": value, "stable": value is not None} for i, value in enumerate(values)]


def found(own: list[dict[str, object]], reference: list[dict[str, object]]) -> Effect:
    pairs = [by_draw(one, ["event", "seed"]) for one in (own, reference)]
    return effect(pairs[0], pairs[1], lambda row: row["event"])


def test_a_ratio_is_the_geometric_mean_over_the_draws_that_both_survive() -> None:
    one = found(rows([1.0, 2.0, 8.0, 4.0, None, 1.0]), rows([2.0, 2.0, 2.0, 2.0, 1.0, None]))
    assert (one.draws, one.pairs, one.lost, one.kept) == (6, 4, 1, 1)
    assert one.ratio == pytest.approx((0.5 * 1.0 * 4.0 * 2.0) ** 0.25)


def test_groups_count_alike_whatever_their_draws() -> None:
    own = rows([0.5] * 8, "a") + rows([2.0, 2.0], "b")
    one = found(own, rows([1.0] * 8, "a") + rows([1.0, 1.0], "b"))
    assert one.ratio == pytest.approx(1.0)


def test_too_few_pairs_have_no_interval() -> None:
    one = found(rows([1.0] * (MINIMUM - 1)), rows([2.0] * (MINIMUM - 1)))
    assert (one.ratio, one.low, one.high, one.better) == (None, None, None, None)


def test_what_pairs_share_cancels() -> None:
    """Draws differ by a factor of 1000, the two by 10 %: the interval knows."""
    random = np.random.default_rng(1)
    size = 10.0 ** random.uniform(0.0, 3.0, 30)
    own = size * 0.9 * np.exp(0.02 * random.standard_normal(30))
    one = found(rows(own.tolist()), rows(size.tolist()))
    assert one.low is not None
    assert one.high is not None
    assert 0.88 < one.low < 0.9 < one.high < 0.92
    assert one.better is True


def test_intervals_cover_and_effects_of_other_draws_agree() -> None:
    random, covered, same = np.random.default_rng(2), 0, 0
    for _ in range(200):
        pairs = [found(rows(np.exp(0.3 * random.standard_normal(24)).tolist()), rows([1.0] * 24)) for _ in range(2)]
        covered += pairs[0].low < 1.0 < pairs[0].high  # type: ignore[operator]
        same += bool(agree(*pairs))
    assert 0.87 < covered / 200 < 0.99
    assert 0.87 < same / 200 < 0.99
    assert agree(pairs[0], Effect(1, 0, 0, 0, None, None, None)) is None
